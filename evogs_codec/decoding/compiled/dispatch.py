"""The compiled way to apply the packets of a tile: all of them in a few calls, or not at all.

`headers` and `channels` need numba, which is an extra, and take time to load. They do what
`unpack`, `frames` and `tile_state` do, without knowing faults: where they give up, those find out
why.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from evogs_codec.common.buffers import Scratch
from evogs_codec.errors import StreamError
from evogs_codec.format.crc import crc32
from evogs_codec.format.frames import decompress_all
from evogs_codec.format.packet_header import N_SIDES
from evogs_codec.model.components import PICKS, component_channels
from evogs_codec.model.splats import I64

if TYPE_CHECKING:
    from evogs_codec.decoding.tile_state import TileState
    from evogs_codec.format.directory import Directory

__all__ = ["apply_compiled", "kernels_for", "loaded_kernels"]

MIN_COMPILED = 1_000  # slots below which either takes a few ms
# Loading it takes 0.5 s. With 8 MB of packets a process that decodes one stream saves as much; a
# slot counts as 4 bytes, since 2 million slots may come in very few.
BYTES_WORTH_LOADING = 8_000  # bytes, for each of MIN_COMPILED
# Slots after which a process may well decode more. A process that has loaded numba for something
# else, as the renderer, takes 0.1 s.
SLOTS_OF_MANY, SLOTS_OF_MANY_WITH_NUMBA = 50_000, 5_000
SLOT_BYTES = 4  # bytes
KERNELS = "evogs_codec.decoding.compiled.channels"
MAX_PLANES = 16 << 20  # bytes of planes that are decompressed at a time, if packets allow
# Of core, each SH band and picks.
N_CHANNELS = np.array([*(component_channels(k) for k in range(PICKS)), 1])


_n_decoded = 0  # slots of the streams before that were large enough


def kernels_for(n_slots: int, n_bytes: int) -> ModuleType | None:
    """The compiled loops where they are installed and worth loading; None for numpy.

    Args:
        n_slots: that will be made.
        n_bytes: of the packets that make them.
    """
    global _n_decoded
    if n_slots < MIN_COMPILED:
        return None
    often = SLOTS_OF_MANY_WITH_NUMBA if "numba" in sys.modules else SLOTS_OF_MANY
    is_first, _n_decoded = _n_decoded < often, _n_decoded + n_slots
    is_small = n_bytes + SLOT_BYTES * n_slots < BYTES_WORTH_LOADING * MIN_COMPILED
    if is_first and is_small and loaded_kernels(n_slots) is None:
        return None
    try:
        from evogs_codec.decoding.compiled import channels
    except ImportError:  # numba is an extra
        return None
    return channels


def loaded_kernels(n_slots: int) -> ModuleType | None:
    """The compiled loops, for so many slots, if something loaded them; None for numpy."""
    return sys.modules.get(KERNELS) if n_slots >= MIN_COMPILED else None


def apply_compiled(
    channels: ModuleType, state: TileState, data: memoryview, packets: I64, scratch: Scratch
) -> bool:
    """Apply packets of a tile, in file order from its first on, to an empty state.

    Returns:
        False if a packet is not plainly legal; the state must not be used any more.
    """
    directory = state.directory
    rows, offsets = directory.packets[packets], directory.offsets[packets]
    sizes = rows["size"].astype(np.int64)
    if len(packets) and int((offsets + sizes).max()) > len(data):
        return False
    data, offsets = _frozen_packets(data, offsets, sizes)
    for at, size, crc in zip(offsets.tolist(), sizes.tolist(), rows["crc"].tolist(), strict=True):
        if crc32(data[at : at + size]) != crc:
            return False
    components, steps = rows["component"].astype(np.int64), directory.steps[packets]
    core = rows[components == 0]  # that of step s is row s
    names = ("n_adds", "n_splits", "n_refines", "n_drops")
    core_counts = np.stack([core[name].astype(np.int64) for name in names], 1)
    counts, levels = core_counts[steps], core["level"].astype(np.int64)[steps]
    _, n_splits, n_refines, n_drops = core_counts.sum(0).tolist()
    sizes_of_plans = len(state.x), len(core), (n_splits, n_refines), n_drops
    plans = channels.Plans.empty(scratch, *sizes_of_plans)
    tables = _tables(channels, directory, state.tile)
    entries = directory.entries_required[packets].astype(np.int64)
    for part in _parts(components, counts):
        headers = _headers(
            channels, data, offsets[part], sizes[part], components[part], counts[part]
        )
        if headers is None:
            return False
        codes, starts, flags, planes = headers
        args = components[part], steps[part], levels[part], counts[part], codes, starts, flags
        found = channels.Headers(*args, planes, entries[part])
        slots = state.x, state.live, state.born_from, state.picks
        if not channels.apply_packets(found, tables, plans, *slots):
            return False
    applied = {c: int(np.count_nonzero(components == c)) for c in directory.components.of_tiles}
    state.set_applied(applied, plans.places[1:, 0].tolist())
    return True


def _frozen_packets(data: memoryview, offsets: I64, sizes: I64) -> tuple[memoryview, I64]:
    """The bytes with the packets, which do not change any more, and where each begins in them."""
    if isinstance(data.obj, bytes):
        return data, offsets
    ends = zip(offsets.tolist(), (offsets + sizes).tolist(), strict=True)
    joined = b"".join(data[begin:end] for begin, end in ends)
    return memoryview(joined), np.cumsum(sizes) - sizes


def _parts(components: I64, counts: I64) -> list[slice]:
    """Packets in parts whose planes need no more than MAX_PLANES, but for single packets."""
    values = N_CHANNELS[components] * counts[:, :3].sum(1)
    values += (components == 0) * N_SIDES * counts.sum(1)
    ends = np.cumsum(3 * values)  # a value has at most 3 bytes
    parts, begin = [], 0
    while begin < len(ends):
        room = (ends[begin - 1] if begin else 0) + MAX_PLANES
        end = max(begin + 1, int(np.searchsorted(ends, room, side="right")))
        parts.append(slice(begin, end))
        begin = end
    return parts


def _headers(
    channels: ModuleType,
    data: memoryview,
    offsets: I64,
    sizes: I64,
    components: I64,
    counts: I64,
) -> tuple[npt.NDArray[np.uint8], I64, I64, npt.NDArray[np.uint8]] | None:
    """(codes, starts, flags, planes) of packets, or None."""
    raw = np.frombuffer(data, np.uint8)
    shape = (len(offsets), channels.MAX_LISTS)
    codes, starts = np.empty(shape, np.uint8), np.empty(shape, np.int64)
    flags = np.empty(len(offsets), np.int64)
    n_frames = raw[offsets[sizes > 1] + 1].astype(np.int64)
    if (5 * n_frames > sizes[sizes > 1]).any():
        return None
    places = np.empty((int(n_frames.sum()), 3), np.int64)
    if not channels.read_headers(
        raw, offsets, sizes, components, counts, codes, starts, flags, places
    ):
        return None
    try:
        planes = decompress_all(data, places)
    except StreamError:
        return None
    return codes, starts, flags, planes


def _tables(channels: ModuleType, directory: Directory, tile: int) -> object:
    row = directory.tiles[tile]
    box = np.stack([row["box_min"], row["box_max"]], 1).astype(np.int64)
    return channels.Tables(directory.quantiser_units, *directory.alpha_entries, box)
