"""Where the bytes of a stream are: per level, component and group (`evogs info`)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from evogs_codec.decoding.palette_state import read_entries_header, read_picks_header
from evogs_codec.decoding.replay import packet_body
from evogs_codec.format.directory import UNKNOWN_ERROR, Directory
from evogs_codec.format.packet_header import Counts, PacketHeader, read_packet_header
from evogs_codec.format.planes import entropies
from evogs_codec.format.unpack import read_planes
from evogs_codec.model.channels import CLASS_NAMES, GROUPS, channel_class
from evogs_codec.model.components import PALETTE, PICKS, component_slice
from evogs_codec.model.splats import I64

__all__ = ["ALPHA_NAMES", "GroupBytes", "LevelStats", "bytes_by_group", "levels"]

ALPHA_NAMES = tuple(f"alpha of {name}" for name in GROUPS)
PARTS = ("directory", "packet headers", "slots", "kinds", *ALPHA_NAMES, *CLASS_NAMES, "picks")


@dataclass(frozen=True)
class LevelStats:
    """A level: splats drawn at it, records and bytes it takes beyond the level below.

    `adds` says what it adds: detail, if the splats are others than those of the level below;
    precision, if it only refines them; nothing, if it has no records.
    """

    level: int
    adds: Literal["detail", "precision", "nothing"]
    n_leaves: int
    n_steps: int
    n_adds: int
    n_splits: int
    n_refines: int
    n_drops: int
    n_bytes: int
    error: float  # root-mean-square distance from the last positions, scene units; nan: unknown


def levels(directory: Directory) -> list[LevelStats]:
    """Figures per level, from the directory alone."""
    rows, label = directory.packets, directory.labels
    core = np.flatnonzero(rows["component"] == 0)
    counts = {name: _sums(label[core], rows[name][core], directory.n_levels) for name in _COUNTS}
    live = np.cumsum(counts["n_adds"] + counts["n_splits"] - counts["n_drops"])
    detail, refines = counts["n_adds"] + counts["n_splits"] + counts["n_drops"], counts["n_refines"]
    n_steps = np.bincount(label[core], minlength=directory.n_levels)
    n_bytes = _sums(label, rows["size"], directory.n_levels)
    return [
        LevelStats(
            level=level,
            adds="detail" if detail[level] else "precision" if refines[level] else "nothing",
            n_leaves=int(live[level]),
            n_steps=int(n_steps[level]),
            n_bytes=int(n_bytes[level]),
            error=error,
            **{name: int(sums[level]) for name, sums in counts.items()},
        )
        for level, error in enumerate(_errors(directory, core))
    ]


_COUNTS = ("n_adds", "n_splits", "n_refines", "n_drops")


def _sums(label: I64, column: npt.NDArray[np.integer], n_levels: int) -> I64:
    """(n_levels,) sums of a column by label; they are below 2**53."""
    return np.bincount(label, column.astype(np.float64), n_levels).astype(np.int64)


def _errors(directory: Directory, core: I64) -> Iterator[float]:
    """Per level, of the last core packet of each tile: root mean square over tiles by leaves.

    `core` are the rows of core packets.
    """
    tile, label = directory.packets["tile"][core], directory.labels[core]
    hints = directory.packets["error"][core].astype(np.float64)
    hints[hints == UNKNOWN_ERROR] = np.nan
    order = np.argsort(label, kind="stable")
    ends = np.searchsorted(label[order], np.arange(directory.n_levels), side="right")
    weights = directory.tile_slots.astype(np.float64)
    errors, has_step = np.zeros(len(weights)), np.zeros(len(weights), bool)
    grid = 2.0 ** -directory.grid_exponents[0]
    begin = 0
    for end in ends.tolist():
        new = order[begin:end]
        errors[tile[new]], has_step[tile[new]] = hints[new], True  # of a tile, the last remains
        total = float(weights[has_step].sum())
        squares = float((weights * np.square(errors))[has_step].sum())
        # Without splats 0, or unknown.
        yield float(np.sqrt(squares / total)) * grid if total else squares
        begin = end


@dataclass(frozen=True)
class GroupBytes:
    """Bytes stored for one kind of number, and the order-0 entropy of its planes in bytes."""

    n_bytes: float
    entropy: float


def bytes_by_group(directory: Directory, data: memoryview) -> dict[str, GroupBytes]:
    """Bytes per class of channel, and of slots, kinds, alpha, picks, headers and directory.

    All are named, in this order; those that the stream stores nothing of have 0 bytes. A frame with
    planes of several classes is shared out by the order-0 entropy of its planes.

    Raises:
        StreamError: a packet is not legal.
    """
    stored: dict[str, float] = defaultdict(float)
    ideal: dict[str, float] = defaultdict(float)
    stored["directory"] = directory.data_offset
    core_counts: dict[tuple[int, int], Counts] = {}
    for packet, row in enumerate(directory.packets):
        component, size = int(row["component"]), int(row["size"])
        key = int(row["tile"]), int(directory.steps[packet])
        if component == 0:
            core_counts[key] = directory.counts(packet)
        if not size:
            continue
        offset = int(directory.offsets[packet])
        body = packet_body(directory, data, packet)
        if component == PALETTE:
            n = directory.components.n_above
            head = read_entries_header(body, int(row["n_adds"]), n, offset)
            names = _named(head, _class_names(directory.components.channels(PALETTE)))
        elif component == PICKS:
            head = read_picks_header(body, core_counts[key], offset)
            names = _named(head, ["picks"])
        else:
            head = read_packet_header(body, component, core_counts[key], offset)
            names = _plane_names(head, component)
        planes = read_planes(body, head, offset)
        bits = [n_bits / 8 for n_bits in entropies(planes, head.plane_sizes)]
        stored["packet headers"] += head.size
        at = 0
        for n_planes, n_bytes in head.frames:
            part = range(at, at + n_planes)
            total = sum(bits[k] for k in part)
            for k in part:
                share = bits[k] / total if total else 1.0 / n_planes
                stored[names[k]] += n_bytes * share
                ideal[names[k]] += bits[k]
            at += n_planes
    return {name: GroupBytes(stored[name], ideal[name]) for name in PARTS}


def _plane_names(head: PacketHeader, component: int) -> list[str]:
    """What each plane of a packet holds."""
    channels = _class_names(component_slice(component))
    sides = ["slots", "kinds", *ALPHA_NAMES] if component == 0 else []
    return _named(head, sides + channels + channels)


def _class_names(channels: slice) -> list[str]:
    """The class of each of these channels."""
    return [CLASS_NAMES[channel_class(k)] for k in range(channels.start, channels.stop)]


def _named(head: PacketHeader, names: list[str]) -> list[str]:
    """The name of each plane, from the name of each list."""
    return [
        name
        for name, coding in zip(names, head.codings, strict=True)
        for _ in range(coding.n_planes)
    ]
