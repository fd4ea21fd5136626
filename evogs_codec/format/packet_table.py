"""The packet table and its checks (spec 5.6, 8.2).

It has no step numbers: they follow from the order of the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from evogs_codec._generated.limits import LIMITS
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import layout
from evogs_codec.format.chunks import read_rows
from evogs_codec.format.packet_header import MAX_RECORDS_PER_BYTE
from evogs_codec.model.components import CORE, PALETTE, Components
from evogs_codec.model.splats import I64

__all__ = ["labels_of", "read_packet_table", "state_sizes"]


def read_packet_table(
    body: memoryview,
    offset: int,
    header: layout.Fields,
    components: Components,
    limits: Mapping[str, int] | None,
) -> tuple[npt.NDArray[np.void], I64]:
    """Rows of the packet table and their steps; the first faulty row decides (spec 6.1)."""
    rows = read_rows(layout.PACKET_ENTRY, body, offset, header["n_packets"])
    table = _PacketTable(rows, header, components)
    worst: tuple[int, int, Fault, str] | None = None
    for order, (fault, bad, detail) in enumerate(table.checks(limits)):
        if bad.any():
            row = int(np.argmax(bad))
            if worst is None or (row, order) < worst[:2]:
                worst = (row, order, fault, detail)
    if worst is not None:
        raise StreamError(worst[2], f"packet {worst[0]}: {worst[3]}", offset)
    return rows, table.step


def labels_of(rows: npt.NDArray[np.void], steps: I64) -> I64:
    """(n,) level of the core row of the same tile and step, of rows that have one."""
    return _of_core(rows, steps, rows["level"].astype(np.int64))


def state_sizes(rows: npt.NDArray[np.void], steps: I64, components: Components) -> I64:
    """(n,) bytes of the state of the component of each packet after its step (spec 5.7, 7.7)."""
    is_palette = rows["component"] == PALETTE
    new = rows["n_adds"].astype(np.int64) + rows["n_splits"]
    n_after = _running(np.where(is_palette, -1, rows["tile"].astype(np.int64)), new) + new
    per_slot: I64 = components.state_bytes[rows["component"]]
    return 4 + per_slot * np.where(is_palette, n_after, _of_core(rows, steps, n_after))


def _of_core(rows: npt.NDArray[np.void], steps: I64, values: I64) -> I64:
    """(n,) the value of the core row of the same tile and step, of rows that have one."""
    core = np.flatnonzero(rows["component"] == 0)
    core = core[np.argsort(rows["tile"][core], kind="stable")]
    if not len(core):
        return np.zeros(len(rows), np.int64)
    first = np.searchsorted(rows["tile"][core], rows["tile"])
    found: I64 = values[core[np.minimum(first + steps, len(core) - 1)]]
    return found


class _PacketTable:
    """Columns of the packet table and the checks of spec 5.6.

    A column that needs earlier rows is right up to and including the first faulty row, which is all
    that is asked of it.
    """

    def __init__(
        self, rows: npt.NDArray[np.void], header: layout.Fields, components: Components
    ) -> None:
        self.rows = rows
        self.header = header
        self.is_known = np.isin(rows["component"], components.numbers)
        self.is_core = rows["component"] == CORE
        self.is_palette = rows["component"] == PALETTE
        self.has_counts = self.is_core | self.is_palette  # and a level of their own
        self.tile = rows["tile"].astype(np.int64)
        chain = self.tile * 256 + rows["component"]
        self.step = _running(chain, np.ones(len(rows), np.int64))
        self.counts = {
            name: rows[name].astype(np.int64)
            for name in ("n_adds", "n_splits", "n_refines", "n_drops")
        }

    def checks(
        self, limits: Mapping[str, int] | None
    ) -> Iterator[tuple[Fault, npt.NDArray[np.bool_], str]]:
        """(fault, bad rows, detail), in the order of the ids within a row."""
        rows, header, core, tile = self.rows, self.header, self.is_core, self.tile
        palette, own = self.is_palette, self.has_counts
        adds, splits = self.counts["n_adds"], self.counts["n_splits"]
        size, level = rows["size"].astype(np.int64), rows["level"].astype(np.int64)
        n_records = splits + self.counts["n_refines"] + self.counts["n_drops"]
        some = (n_records + adds) > 0
        yield Fault.E_RESERVED, rows["reserved"] != 0, "a reserved byte is set"
        unknown = (tile >= header["n_tiles"]) | ~self.is_known
        yield Fault.E_CHAIN, unknown, "no such tile or component"
        early = ~own & (self.step >= _running(tile, core.astype(np.int64)))
        yield Fault.E_CHAIN, early, "the packet is before the core packet it requires"
        owner = np.where(palette, -1, tile)
        previous = _previous(owner, own, level)
        falls = own & ((level >= header["n_levels"]) | (level < previous))
        yield Fault.E_CHAIN, falls, "the level is too large or falls"
        beside = ~own & ((level > 0) | (adds > 0)) | ~core & (n_records > 0)
        yield Fault.E_COUNT, beside, "level or counts beside core"
        wrong = own & (some != (size > 0))
        yield Fault.E_COUNT, wrong, "size and counts contradict each other"
        live = _running(tile, np.where(core, adds - self.counts["n_drops"] + splits, 0))
        yield Fault.E_COUNT, n_records > live, "more records than live splats"
        many = adds + n_records > MAX_RECORDS_PER_BYTE * size
        yield Fault.E_AMPLIFICATION, many, "too many records for its size"
        yield Fault.E_CRC, (size == 0) & (rows["crc"] != 0), "the CRC-32 of no bytes is 0"
        if palette.any():
            yield Fault.E_CHAIN, palette & (tile > 0), "a packet of the palette has another tile"
        new = adds + splits
        columns = {
            "tile_steps": self.step + 1,
            "tile_slots": _running(owner, new) + new,
            "slots": np.cumsum(new),
        }
        for name, column in columns.items():
            limit = LIMITS[name][header["tier"] - 1]
            yield Fault.E_TIER, column > limit, f"{name} exceeds the limit of the tier"
            lower = limit if limits is None else limits.get(name, limit)
            yield Fault.E_LIMIT, column > lower, f"{name} exceeds the limit {lower}"


def _running(key: I64, values: I64) -> I64:
    """Sum of `values` over the earlier rows with the same key."""
    order = np.argsort(key, kind="stable")
    sums = np.cumsum(values[order]) - values[order]
    sorted_key = key[order]
    first = np.ones(len(key), bool)
    first[1:] = sorted_key[1:] != sorted_key[:-1]
    base = sums[first][np.cumsum(first) - 1] if len(key) else sums
    out = np.empty_like(sums)
    out[order] = sums - base
    return out


def _previous(key: I64, selected: npt.NDArray[np.bool_], level: I64) -> I64:
    """Level of the selected row before with the same key; 0 for the first."""
    rows = np.flatnonzero(selected)
    order = rows[np.argsort(key[rows], kind="stable")]
    out = np.zeros(len(key), np.int64)
    same = key[order][1:] == key[order][:-1]
    out[order[1:][same]] = level[order[:-1][same]]
    return out
