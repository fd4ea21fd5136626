"""Partition: splats into tiles of about the same number, out of core and whatever their order.

A k-d tree (`tile_tree`) over a sample of the positions says which tile each is in. What is in the
sample is decided by a hash of the position, so that tiles are the same in whatever order splats
come.

Letters: n points, T tiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evogs_codec.common.progress import Progress
from evogs_codec.errors import InputError
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.distinct import Distinct
from evogs_codec.jobs.tile_tree import Tree
from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS
from evogs_codec.model.splats import F32, F64, I64

__all__ = [
    "PER_TILE",
    "SPLATS_OF_STAND_IN",
    "Partition",
    "drawn_of",
    "panes_of",
    "partition",
    "rows_of",
    "stand_ins_of",
    "vectors_of",
]

PER_TILE = 1 << 17  # splats: a job takes some 300 MiB
N_SAMPLED = 1 << 19  # positions
SPLATS_OF_STAND_IN = 16  # splats of a tile for which one stands in the views of its neighbours
MAX_STEPS = 1 << 26  # across a tile at most: Delta of adds has up to 2**28 grid units (R-7.3-1)
STEP_OF_SIZE = 0.1  # of the size of the smallest splats is a step of positions
# A tile is halved for its width only while it has this part of `per_tile` splats, one in so many.
MIN_OF_HALVED = 48
MAX_LOG_SIZE = 700.0  # of a size: its exponential is a number
MAX_CROWDED = 4  # times the splats that a tile was to have: more are refused
# Of the logarithms of the sizes of splats: lowest, highest, width of a bin.
SIZE_BINS = (-40.0, 40.0, 0.25)


@dataclass(eq=False)
class Partition:
    """Tiles on disk.

    Attributes:
        folder: of a file of rows (n, D) float32 for each tile, positions from its origin.
        tree: which tile a position is in.
        sh_degree: of the splats.
        counts: (T,) splats of each tile.
        largest: (5,) largest magnitude of a number per group; of positions, from the origin of
            their tile.
        sizes: (T, bins) how many splats are of a size.
        n_vectors: that splats share as their SH above band 0 (`vectors_of`); 0 if they do not, or
            if it was not looked for.
    """

    folder: Path
    tree: Tree
    sh_degree: int
    counts: I64
    largest: F64
    sizes: I64
    n_vectors: int = 0

    def size(self, tile: int) -> float:
        """The median size of the splats of a tile, scene units: the mean of their log-scales."""
        half = np.searchsorted(np.cumsum(self.sizes[tile]), (self.counts[tile] + 1) // 2)
        return float(np.exp(SIZE_BINS[0] + SIZE_BINS[2] * (half + 0.5)))


@dataclass
class _Tally:
    """What is counted while rows are written."""

    n_tiles: int
    counts: I64 = field(init=False)
    largest: F64 = field(init=False)
    sizes: I64 = field(init=False)

    def __post_init__(self) -> None:
        self.counts = np.zeros(self.n_tiles, np.int64)
        self.largest = np.zeros(N_GROUPS)
        n_bins = int((SIZE_BINS[1] - SIZE_BINS[0]) / SIZE_BINS[2])
        self.sizes = np.zeros((self.n_tiles, n_bins), np.int64)

    def take(self, tiles: I64, rows: F32) -> None:
        self.counts += np.bincount(tiles, minlength=self.n_tiles)
        for group, part in enumerate(GROUP_CHANNELS):
            most = np.abs(rows[:, part]).max(initial=0)
            self.largest[group] = max(self.largest[group], float(most))
        low, high, width = SIZE_BINS  # sizes of any kind are in them
        means = np.clip(rows[:, 7:10].mean(axis=1), low, high)
        bins = ((means - low) / width).astype(np.int64)
        bins = np.clip(bins, 0, self.sizes.shape[1] - 1)
        np.add.at(self.sizes, (tiles, bins), 1)


def partition(
    files: SplatFiles,
    folder: Path,
    report: Progress,
    per_tile: int = PER_TILE,
    distinct: Distinct | None = None,
) -> Partition:
    """The splats of files, in two passes, as rows of tiles in a folder.

    Args:
        files: of the splats.
        folder: where the rows are written.
        report: called with a stage and the part of it that is done.
        per_tile: splats of a tile, about.
        distinct: is shown all splats, where SH that they share are wanted.

    Raises:
        InputError: there are no splats, or too many are in one place.
        OSError: the disk is full.
    """
    n = files.n_declared
    sample, sizes = _sample(files, n, report)
    n_tiles = max(1, -(-n // per_tile))
    least = len(sample) * per_tile // (MIN_OF_HALVED * max(n, 1))
    tree = Tree.of(sample, n_tiles, sizes, least=least)
    reach = _reach(tree, sample, sizes)
    # All tiles share a step: none has to be narrower than one that is not halved any more.
    reach = max(reach, _width(Tree.of(sample, n_tiles, sizes, reach, least), sample))
    tree = Tree.of(sample, n_tiles, sizes, reach, least)
    tally = _Tally(tree.n_tiles)
    done = 0
    for tile in range(tree.n_tiles):
        for path in (rows_of(folder, tile), stand_ins_of(folder, tile)):
            path.write_bytes(b"")
    for block in files.blocks():
        tiles = tree.tile_of(block.means)
        rows = block.rows(tree.origins[tiles])
        tally.take(tiles, rows)
        if distinct is not None:
            distinct.take(block.splats)
        order = np.argsort(tiles, kind="stable")
        ends = np.cumsum(np.bincount(tiles, minlength=tree.n_tiles))
        for tile in np.unique(tiles).tolist():
            start = 0 if tile == 0 else int(ends[tile - 1])
            own = order[start : ends[tile]]
            _append(rows_of(folder, tile), rows[own])
            stands_in = _hash(block.means[own]) % np.uint64(SPLATS_OF_STAND_IN) == 0
            _append(stand_ins_of(folder, tile), rows[own[stands_in]])
        done += len(tiles)
        report("partition", 0.5 + 0.5 * done / max(n, 1))
    if not done:
        raise InputError("a scene without splats has no tiles")
    crowded = int(np.argmax(tally.counts))
    if tally.counts[crowded] > MAX_CROWDED * per_tile:
        raise InputError(
            f"{tally.counts[crowded]:,} splats are in one place, near"
            f" {tree.origins[crowded].round(3).tolist()}: more than a tile can have"
        )
    vectors = None if distinct is None else distinct.found()
    if vectors is not None:
        vectors.write(vectors_of(folder))
    n_vectors = 0 if vectors is None else len(vectors.keys)
    return Partition(
        folder, tree, files.sh_degree, tally.counts, tally.largest, tally.sizes, n_vectors
    )


def rows_of(folder: Path, tile: int) -> Path:
    """The file of the rows of a tile."""
    return folder / f"{tile:06d}.rows"


def stand_ins_of(folder: Path, tile: int) -> Path:
    """The file of the rows of those splats of a tile that stand for `SPLATS_OF_STAND_IN` each."""
    return folder / f"{tile:06d}.stand-ins"


def drawn_of(folder: Path, tile: int) -> Path:
    """The file of what pictures tell of a tile that was surveyed."""
    return folder / f"{tile:06d}.drawn"


def panes_of(folder: Path, tile: int) -> Path:
    """The file of what a tile shows in the views of its neighbourhood."""
    return folder / f"{tile:06d}.panes"


def vectors_of(folder: Path) -> Path:
    """The file of the SH that splats share, where they do."""
    return folder / "vectors.npz"


def _append(path: Path, rows: F32) -> None:
    try:
        with path.open("ab") as file:
            file.write(rows.astype("<f4").tobytes())
    except OSError as error:  # a full disk is that of the scratch folder, not of an input
        raise OSError(error.errno, error.strerror, str(path)) from error


def _sample(files: SplatFiles, n: int, report: Progress) -> tuple[F64, F32]:
    """(S, 3) positions, those whose hash says so, and (S,) mean log-scales of these splats."""
    every = max(1, n // N_SAMPLED)
    means, sizes, done = [np.empty((0, 3))], [np.empty(0, np.float32)], 0
    for block in files.blocks():
        some = _hash(block.means) % np.uint64(every) == 0
        means.append(block.means[some])
        sizes.append(block.splats.log_scales[some].mean(axis=1))
        done += len(some)
        report("partition", 0.5 * min(1.0, done / max(n, 1)))
    return np.concatenate(means), np.concatenate(sizes)


def _reach(tree: Tree, sample: F64, sizes: F32) -> float:
    """How wide a tile may be, so that a step of its positions is small beside every splat.

    The positions of a tile are whole multiples of a step that all tiles share.
    """
    tiles = tree.tile_of(sample)
    medians = [np.median(sizes[tiles == tile]) for tile in np.unique(tiles)]
    smallest = min(map(float, medians), default=0.0)
    return MAX_STEPS * STEP_OF_SIZE * math.exp(min(smallest, MAX_LOG_SIZE))


def _width(tree: Tree, sample: F64) -> float:
    """Of the widest tile, by a sample (n, 3)."""
    tiles = tree.tile_of(sample)
    order = np.argsort(tiles, kind="stable")
    parts = np.split(sample[order], np.flatnonzero(np.diff(tiles[order])) + 1)
    return max((float(np.ptp(part, axis=0).max()) for part in parts if len(part)), default=0.0)


def _hash(means: F64) -> npt.NDArray[np.uint64]:
    """(n,) of positions (n, 3): the finaliser of splitmix64 over the bits of each axis."""
    found = np.zeros(len(means), np.uint64)
    for axis in range(3):
        x = found ^ (means[:, axis] + 0.0).view(np.uint64)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
        found = x ^ (x >> np.uint64(31))
    return found
