"""Scenes as PlayCanvas streams them: each level on its own, cut by KD into SOG sets.

`lod-meta.json` says which splats of which set are in which box. No level is built on another one:
what is shown of a box is the finest level whose set is there.

The levels are those of our tree with half the splats each, where splat-transform decimates, and
`sog_set` writes the sets: this is a model of a stream, of real bytes.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from evogs_codec import SplatParams, lift
from evogs_codec.common.morton import morton_order
from evogs_codec.io.finite import finite_opacities
from evogs_codec.io.interchange import sog
from evogs_codec.model.splats import F64, I64
from tools.bench.sog_set import write_set

__all__ = ["N_LEVELS", "SogStream", "stream_levels"]

N_LEVELS = 7


@dataclass(frozen=True, eq=False)
class _Set:
    """What one file of `lod-meta.json` names: splats of a level in neighbouring boxes.

    Attributes:
        level: 0 is the coarsest.
        cells: (n,) the box of each splat; they rise.
        splats: n, as they are decoded.
        data: the bytes of its files.
    """

    level: int
    cells: I64
    splats: SplatParams
    data: bytes


@dataclass(frozen=True, eq=False)
class SogStream:
    """A streamed SOG.

    Attributes:
        manifest: `lod-meta.json`.
        sets: by level, the coarsest first.
        boxes: (c, 2, 3) least and greatest positions of the splats in each box.
    """

    manifest: bytes
    sets: tuple[_Set, ...]
    boxes: F64

    @staticmethod
    def of(levels: Sequence[SplatParams], most: int, folder: Path) -> SogStream:
        """The stream of levels.

        Args:
            levels: the coarsest first.
            most: splats of a set, about.
            folder: for its files.
        """
        cells = _cells(levels, most)
        n_cells = int(cells[-1].max()) + 1
        sets = []
        for level, (splats, of_level) in enumerate(zip(levels, cells, strict=True)):
            together = _together(of_level, n_cells, most)
            for k in range(n_cells // together):
                rows = np.flatnonzero(of_level // together == k)
                if len(rows):
                    path = folder / f"{level}_{k}"
                    sets.append(_written(level, splats.take(rows), of_level[rows], path))
        boxes = np.array([_box(levels, cells, cell) for cell in range(n_cells)])
        return SogStream(_manifest(sets, boxes, levels), tuple(sets), boxes)

    @cached_property
    def cells_of(self) -> tuple[I64, ...]:
        """The boxes that have splats of each set."""
        return tuple(np.unique(one.cells) for one in self.sets)

    @property
    def n_levels(self) -> int:
        """Levels."""
        return max(one.level for one in self.sets) + 1

    def shown(self, there: Collection[int]) -> SplatParams:
        """What is drawn when these sets are there, of which the coarsest level is a part."""
        finest = self.levels_of(there)
        parts = [
            (one, np.equal(finest[one.cells], one.level))
            for one in map(self.sets.__getitem__, there)
        ]
        return _joined([one.splats.take(rows) for one, rows in parts])

    def levels_of(self, there: Collection[int]) -> I64:
        """(c,) the level that is shown of each box; -1 for none."""
        finest = np.full(len(self.boxes), -1)
        for i in there:
            cells = self.cells_of[i]
            finest[cells] = np.maximum(finest[cells], self.sets[i].level)
        return finest


def stream_levels(splats: SplatParams) -> list[SplatParams]:
    """Seven levels, each with about half the splats of the next one; the last is the scene."""
    tree = lift(splats, N_LEVELS)
    return [*(tree.leaves(level) for level in range(N_LEVELS - 1)), splats]


def _cells(levels: Sequence[SplatParams], most: int) -> list[I64]:
    """The box of each splat of each level: halves of the last level, until they are small.

    The halves of box c are boxes 2 c and 2 c + 1 of the next round.
    """
    cells = [np.zeros(len(level), np.int64) for level in levels]
    while np.bincount(cells[-1]).max() > most:
        axes, planes = [], []
        for cell in range(int(cells[-1].max()) + 1):
            points = levels[-1].means[cells[-1] == cell]
            axes.append(int(np.argmax(np.ptp(np.percentile(points, (5, 95), axis=0), axis=0))))
            planes.append(float(np.median(points[:, axes[-1]])))
        for k, level in enumerate(levels):
            along = level.means[np.arange(len(level)), np.array(axes)[cells[k]]]
            cells[k] = 2 * cells[k] + (along > np.array(planes)[cells[k]])
    return cells


def _together(cells: I64, n_cells: int, most: int) -> int:
    """How many neighbouring boxes share a set."""
    together = n_cells
    while together > 1 and np.bincount(cells // together).max() > most:
        together //= 2
    return together


def _written(level: int, splats: SplatParams, cells: I64, folder: Path) -> _Set:
    curve = morton_order(splats.means.T)
    order = curve[np.argsort(cells[curve], kind="stable")]
    write_set(splats.take(order), folder)
    decoded, _ = finite_opacities(sog.read(folder)[0])
    data = b"".join(path.read_bytes() for path in sorted(folder.iterdir()))
    return _Set(level, cells[order], decoded, data)


def _box(levels: Sequence[SplatParams], cells: Sequence[I64], cell: int) -> F64:
    means = [level.means[own == cell] for level, own in zip(levels, cells, strict=True)]
    points = np.concatenate(means).astype(np.float64)
    return np.array([points.min(axis=0), points.max(axis=0)])


def _manifest(sets: Sequence[_Set], boxes: F64, levels: Sequence[SplatParams]) -> bytes:
    """`lod-meta.json`, which counts levels from the finest one."""

    def leaf(cell: int) -> dict[str, object]:
        lods = {}
        for number, one in enumerate(sets):
            start, end = (int(n) for n in np.searchsorted(one.cells, (cell, cell + 1)))
            if end > start:
                lod = {"file": number, "offset": start, "count": end - start}
                lods[str(len(levels) - 1 - one.level)] = lod
        return {"bound": _bound(boxes[cell : cell + 1]), "lods": lods}

    def node(first: int, end: int) -> dict[str, object]:
        if end - first == 1:
            return leaf(first)
        middle = (first + end) // 2
        halves = [node(first, middle), node(middle, end)]
        return {"bound": _bound(boxes[first:end]), "children": halves}

    meta = {
        "version": 1,
        "count": sum(len(level) for level in levels),
        "counts": [len(level) for level in reversed(levels)],
        "lodLevels": len(levels),
        "filenames": [f"{number}/meta.json" for number in range(len(sets))],
        "tree": node(0, len(boxes)),
    }
    return json.dumps(meta, separators=(",", ":")).encode()


def _bound(boxes: F64) -> dict[str, list[float]]:
    least, most = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    return {"min": [round(x, 5) for x in least], "max": [round(x, 5) for x in most]}


def _joined(parts: Sequence[SplatParams]) -> SplatParams:
    channels = np.concatenate([part.channels() for part in parts], axis=1)
    return SplatParams.from_channels(channels)
