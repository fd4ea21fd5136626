"""What a stream may cost the reference decoder, worked out from its counts (spec 8.3)."""

from __future__ import annotations

import gc
import os
import tracemalloc
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.model.components import CORE, PALETTE, PICKS

if TYPE_CHECKING:
    from evogs_codec import Directory

__all__ = ["bound", "peak"]

# Bytes. Objects of Python's: measured 15 kB for an empty stream; 22 kB, 0.6 kB a packet, 5 kB a
# tile, 0.6 kB a level for random ones, by least squares. About twice that is allowed.
ALWAYS, PER_PACKET, PER_TILE, PER_LEVEL = 64 << 10, 1 << 10, 10 << 10, 1 << 10
ARRAYS = 6  # "a few" of 4 bytes per record, of the packet that is applied
KEPT = 7  # per record: slots, kinds and alpha that SH bands still need
KEPT_OF_SIBLINGS = 4  # per refine: the record of the slot that its slot was born from
TIMES = 3
WAITING = 3  # times the file: pieces that wait, with room to grow, and packets
UNREAD = 16  # per byte of a file whose directory is at fault: rows of tables, as far as read
GROWN = 3  # times the state where it grows as packets come: it doubles, and the old one is copied


def bound(data: bytes, *, grows: bool = False, dump: int = 0) -> int:
    """Bytes of memory that decoding `data` may take at once, besides `data` itself.

    Args:
        data: the file.
        grows: the state grows as packets come (spec 6.4).
        dump: bytes of the dump that is made at the end, when packets take nothing any more.
    """
    from evogs_codec import StreamError, read_directory

    try:
        directory = read_directory(data)
    except StreamError:
        return ALWAYS + UNREAD * len(data)
    state = _state(directory) * (GROWN if grows else 1)
    packets = _packets(directory, 1 if grows else os.cpu_count() or 1)
    return _tables(directory, len(data)) + state + max(packets, 2 * dump)


def _tables(directory: Directory, size: int) -> int:
    """Header, chunks, and bytes that wait for others: as they came, and packet by packet."""
    n_packets, n_tiles = len(directory.packets), len(directory.tiles)
    counted = PER_PACKET * n_packets + PER_TILE * n_tiles + PER_LEVEL * directory.n_levels
    return ALWAYS + counted + WAITING * size


def _state(directory: Directory) -> int:
    """Integers, liveness and `born_from` of all slots; what is kept for SH bands.

    Entries of a palette count as slots.
    """
    rows = directory.packets
    n_slots = int(rows["n_adds"].sum(dtype=np.int64) + rows["n_splits"].sum(dtype=np.int64))
    n_channels = 11 + 3 * (directory.sh_degree + 1) ** 2
    n_refines = int(rows["n_refines"].sum(dtype=np.int64))
    kept = KEPT * int(_records(directory).sum()) + KEPT_OF_SIBLINGS * n_refines
    return (4 * n_channels + 5) * n_slots + kept


def _packets(directory: Directory, at_once: int) -> int:
    """Planes of a packet, at most 3 bytes a value, and arrays of its records, of `at_once` tiles.

    They are decoded at once in threads: the largest packet of each counts, of the largest tiles.
    """
    component, n_above = directory.packets["component"], directory.components.n_above
    of_bands = 3 * (2 * component.astype(np.int64) + 1)
    kinds = [component == CORE, component == PICKS, component == PALETTE]
    n_values = np.select(kinds, [14 + 7, 1, n_above], of_bands)
    # A row of an SH band has no counts: those of the core packets bound them.
    most = np.zeros(max(len(directory.tiles), 1), np.int64)
    np.maximum.at(most, directory.packets["tile"].astype(np.int64), _records(directory))
    largest = int(np.sort(most)[-at_once:].sum())
    return largest * (3 * int(n_values.max(initial=0)) + 4 * ARRAYS)


def _records(directory: Directory) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    names = ("n_adds", "n_splits", "n_refines", "n_drops")
    counts = [directory.packets[name].astype(np.int64) for name in names]
    total: np.ndarray[tuple[int], np.dtype[np.int64]] = np.sum(counts, axis=0)
    return total


def peak(call: Callable[[], object], allowed: int) -> int:
    """Bytes of memory that a call takes at once; made before, or it counts what it imports.

    Over `allowed` the call is made again, a few times: garbage that was not collected yet and
    caches that fill do not repeat.
    """
    least = 0
    for _ in range(TIMES):
        tracemalloc.start()
        try:
            call()
            _, found = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        least = min(found, least or found)
        if least <= allowed:
            break
        gc.collect()
    return least
