"""Where the bytes of a stream are: per level, component and group (`evogs info`)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from evogs_codec.coded import channel_class, component_slice
from evogs_codec.directory import UNKNOWN_ERROR, Directory
from evogs_codec.packet_header import (
    N_CORE,
    PALETTE,
    PICKS,
    Counts,
    PacketHeader,
    read_packet_header,
)
from evogs_codec.packets import read_planes
from evogs_codec.palette import read_entries_header, read_picks_header
from evogs_codec.planes import entropy
from evogs_codec.splats import n_channels
from evogs_codec.tree import N_GROUPS

__all__ = ["LevelStats", "bytes_by_group", "levels"]

CLASS_NAMES = ("position", "rotation", "scale", "opacity", "sh 0", "sh 1", "sh 2", "sh 3")


@dataclass(frozen=True)
class LevelStats:
    """A level: splats drawn at it, records and bytes it takes beyond the level below."""

    level: int
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
    rows, out, live = directory.packets, [], 0
    core = rows["component"] == 0
    label = directory.labels
    for level in range(directory.n_levels):
        part = rows[(label == level) & core]
        n = {k: int(part[k].astype(np.int64).sum()) for k in _COUNTS}
        live += n["n_adds"] + n["n_splits"] - n["n_drops"]
        out.append(
            LevelStats(
                level=level,
                n_leaves=live,
                n_steps=len(part),
                n_bytes=int(rows["size"][label == level].astype(np.int64).sum()),
                error=_error(directory, label <= level),
                **n,
            )
        )
    return out


_COUNTS = ("n_adds", "n_splits", "n_refines", "n_drops")


def _error(directory: Directory, selected: np.ndarray) -> float:
    """Of the last core packet of each tile, root mean square over tiles by leaves."""
    rows = directory.packets
    squares, weights = 0.0, 0
    for tile in range(len(directory.tiles)):
        own = (rows["tile"] == tile) & (rows["component"] == 0)
        last = np.flatnonzero(own & selected)
        if not len(last):
            continue
        error = int(rows["error"][last[-1]])
        if error == UNKNOWN_ERROR:
            return float("nan")
        counts = rows[own]
        n = int(counts["n_adds"].astype(np.int64).sum() + counts["n_splits"].astype(np.int64).sum())
        squares, weights = squares + n * float(error) ** 2, weights + n
    grid = 2.0 ** -directory.grid_exponents[0]
    return float(np.sqrt(squares / weights)) * grid if weights else 0.0


@dataclass(frozen=True)
class GroupBytes:
    """Bytes stored for one kind of number, and the order-0 entropy of its planes in bytes."""

    n_bytes: float
    entropy: float


def bytes_by_group(directory: Directory, data: memoryview) -> dict[str, GroupBytes]:
    """Bytes per class of channel, and of slots, kinds, alpha, picks, headers and directory.

    A frame with planes of several classes is shared out by the order-0 entropy of its planes.

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
        body = data[offset : offset + size]
        if directory.has_palette and component == PALETTE:
            n = n_channels(directory.sh_degree) - N_CORE
            head = read_entries_header(body, int(row["n_adds"]), n, offset)
            names = _named(head, _class_names(slice(N_CORE, N_CORE + n)))
        elif directory.has_palette and component == PICKS:
            head = read_picks_header(body, core_counts[key], offset)
            names = _named(head, ["picks"])
        else:
            head = read_packet_header(body, component, core_counts[key], offset)
            names = _plane_names(head, component)
        planes = read_planes(body, head, offset)
        ends = np.cumsum(head.plane_sizes)
        bits = [entropy(plane) / 8 for plane in np.split(planes, ends[:-1])]
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
    order = ("directory", "packet headers", "slots", "kinds", "alpha", *CLASS_NAMES, "picks")
    return {name: GroupBytes(stored[name], ideal[name]) for name in order if stored[name]}


def _plane_names(head: PacketHeader, component: int) -> list[str]:
    """What each plane of a packet holds."""
    channels = _class_names(component_slice(component))
    sides = ["slots", "kinds", *["alpha"] * N_GROUPS] if component == 0 else []
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
