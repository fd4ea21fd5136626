"""A sketch of a tree: some of its families, by which bytes and PSNR of a whole stream are guessed.

A family is a splat that an add made, with all that come from it. Those of a sketch are spread over
the scene, and quantised as they are in the whole. A guess is some per cent or half a dB off, nearly
the same at all prices of a bit: who has made one stream knows how far.

Letters: n slots, K classes (spec 3.2), N leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from evogs_codec.common.morton import morton_order
from evogs_codec.encoding.arrange import Renumbered
from evogs_codec.encoding.layer_parts import first_ancestors
from evogs_codec.encoding.layers import Layered
from evogs_codec.encoding.palette_worth import stored_bits
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.replayed import leaves_of
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.format.planes import entropy, zigzag
from evogs_codec.model.channels import channel_class
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32
from evogs_codec.model.tree import EvolutionTree, Kind

__all__ = ["Sketch", "entropy_bytes", "families", "part_of"]

FAMILIES_OF_CHUNK = 16  # neighbouring families that are in a sketch together
SHARE, MIN_LEAVES, MAX_LEAVES = 1 / 6, 6_000, 16_000  # leaves of a sketch, about
# Bytes of a stream are so many times those that the entropy of each list of integers takes, and so
# many for each list, about.
TIMES_ENTROPY, LIST_BYTES = 1.14, 12
MAX_PSNR = 150.0  # dB


@dataclass(frozen=True, eq=False)
class Sketch:
    """Some families of a tree that is prepared, by views.

    Attributes:
        prepared: of these.
        share: of the leaves of the tree that they have.
        n_lists: of integers that a stream of the whole tree has.
    """

    prepared: Prepared
    share: float
    n_lists: int

    @staticmethod
    def of(whole: Prepared) -> Sketch:
        """Of a prepared tree."""
        importance = whole.importance
        assert importance is not None, "a sketch is by views"
        n_leaves = whole.task.tree.n_leaves
        share = min(max(SHARE * n_leaves, MIN_LEAVES), MAX_LEAVES) / max(n_leaves, 1)
        tiles: list[EvolutionTree] = []
        weights: list[tuple[StepWeights | None, ...]] = []
        leaves: list[F32] = []
        chosen = families(whole.tiles, share)
        of_tiles = zip(whole.tiles, chosen, importance.weights, importance.leaves, strict=True)
        for tile, is_in, own, worth in of_tiles:
            if is_in.any():
                _, live = tile.lineage()
                part = part_of(tile, is_in)
                tiles.append(part)
                weights.append(tuple(_weights_of(tile, own, is_in, part)))
                leaves.append(worth[:, is_in[live]])
        prepared = copy(whole)
        prepared.tiles, prepared.gains = tiles, None
        prepared.importance = replace(importance, weights=tuple(weights), leaves=tuple(leaves))
        if whole.layered is not None:
            layering = whole.layered.layering
            prepared.layered = Layered.of(tiles, whole.n_levels, prepared.importance, layering)
        parts = whole.layered.tiles if whole.layered else whole.tiles
        n_lists = sum(len(step.psi) for tile in parts for step in tile.steps)
        return Sketch(prepared, sum(tile.n_leaves for tile in tiles) / max(n_leaves, 1), n_lists)

    def log_bytes(self, price: float) -> float:
        """Logarithm of the bytes of the stream of the whole tree at a price of a bit, about."""
        found = entropy_bytes(self.prepared.coded(price)) / self.share
        tree, importance = self.prepared.task.tree, self.prepared.importance
        if tree.palette is not None and importance is not None:
            found += stored_bits(tree, importance, price) / 8
        return math.log(TIMES_ENTROPY * found + LIST_BYTES * self.n_lists + 1)

    def psnr(self, price: float) -> float:
        """PSNR of the leaves of that stream over the views, dB, about."""
        prepared = self.prepared
        assert prepared.importance is not None, "a sketch is by views"
        found = leaves_of(prepared.coded(price), prepared.task.tree.shown_degree).channels()
        kinds = [channel_class(c) for c in range(len(found))]
        error, n = 0.0, 0
        for tile, weights in zip(prepared.tiles, prepared.importance.at(price).leaves, strict=True):
            right = tile.leaves().channels()
            off = found[:, n : n + right.shape[1]] - right
            error += float((weights[kinds] * np.square(off)).sum(dtype=np.float64))
            n += right.shape[1]
        return min(-10 * math.log10(max(error / self.share, 1e-300)), MAX_PSNR)


def entropy_bytes(tree: CodedTree) -> float:
    """Bytes of an order-0 code of the lists of integers of the steps, without picks.

    Lists are coded byte by byte, the lowest of each integer first.
    """
    bits = 0.0
    for step in (step for tile in tree.tiles for step in tile.steps):
        for rows in (step.psi, step.adds, step.alpha):
            for row in rows if rows.size else ():
                rest = zigzag(row.astype(np.int64)).astype(np.int64)
                while rest.any():
                    bits += entropy(rest & 255)
                    rest = rest >> 8
    return bits / 8


def families(tiles: Sequence[EvolutionTree], share: float) -> list[npt.NDArray[np.bool_]]:
    """Per tile (n,), which slots are in a sketch that has this share of all families, and some."""
    chunks, n = [], 0
    for tile in tiles:
        born_from, _ = tile.lineage()
        chunk = np.zeros(len(born_from), np.int64)
        adds = [step.adds[0:3] for step in tile.steps if step.n_adds]
        if adds:
            roots = np.flatnonzero(born_from < 0)[morton_order(np.concatenate(adds, axis=1))]
            chunk[roots] = n + np.arange(len(roots)) // FAMILIES_OF_CHUNK
            n = int(chunk[roots[-1]]) + 1
        chunks.append(chunk[first_ancestors(born_from)])
    numbers = np.arange(n)
    is_in = np.floor((numbers + 1) * share) > np.floor(numbers * share)
    is_in[:1] |= not is_in.any()
    return [is_in[chunk] for chunk in chunks]


def part_of(tile: EvolutionTree, is_in: npt.NDArray[np.bool_]) -> EvolutionTree:
    """The tree of these slots (n,), whole families of a tile."""
    found, n = Renumbered(len(is_in)), 0
    for step in tile.steps:
        first_add = n + step.alpha.shape[1]
        adds = np.flatnonzero(is_in[first_add : n + step.n_new])
        found.add(step, n, np.flatnonzero(is_in[step.slots]), adds)
        n += step.n_new
    return replace(tile, steps=tuple(found.steps), quanta=())


def _weights_of(
    tile: EvolutionTree,
    weights: Sequence[StepWeights | None],
    is_in: npt.NDArray[np.bool_],
    part: EvolutionTree,
) -> Iterator[StepWeights | None]:
    """Those of the steps of `part`, which is `part_of` the tile."""
    (born_from, _), steps, n = part.lineage(), iter(part.steps), 0
    for step, own in zip(tile.steps, weights, strict=True):
        rows, new = is_in[step.slots], is_in[n : n + step.n_new]
        n += step.n_new
        if not rows.any() and not new.any():
            continue
        slots = next(steps).slots
        if own is None:
            yield None
            continue
        has_psi = step.kinds != Kind.DROP
        yield replace(
            own,
            targets=own.targets[:, rows[has_psi]],
            new=own.new[:, new],
            siblings=own.siblings and Siblings.of(slots, born_from),
        )
