"""A tree encoded, decoded and compared with its exact evaluation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, Settings, decode
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.grids import AccuracyWarning
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.write import write
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import Kind
from tools.bench.extremes import exact, promise

__all__ = ["Measured", "measure"]

SAME_STEP = 1.1  # a step that is coarser than asked by more is warned of


@dataclass(frozen=True)
class Measured:
    """What came of a tree.

    Attributes:
        part: largest error divided by its bound; infinite where a step is coarser than asked and
            nobody was warned.
        group: where that is.
        errors: largest error of each group, scene units.
        warned: what the encoder said.
        coded: the integers.
    """

    part: float
    group: str
    errors: dict[str, float]
    warned: tuple[str, ...]
    coded: CodedTree


def measure(tree: EvolutionTree, settings: Settings, *, n_tiles: int = 1) -> Measured:
    """Errors of the last state of `tree`, each against what is promised for it."""
    tiles = arrange(tree, n_tiles)
    n_levels = max(tree.n_levels, 1)
    settings = replace(settings, zstd_level=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        coded = quantise(tiles, n_levels, settings)
    stream = write(coded, zstd_level=1)
    decoded = decode(stream, verify=True)
    parts, sizes = np.zeros(len(GROUPS)), np.zeros(len(GROUPS))
    units = 2.0 ** -np.array(coded.grid_exponents)
    for number, (own, tile) in enumerate(zip(tiles, coded.tiles, strict=True)):
        got = decoded.tiles[number].channels()
        found = exact.errors(exact.slots_of_tree(own), got, tile.origin, coded.grid_exponents)
        live = decoded.tiles[number].live[: found.shape[1]]
        bound: F64 = (
            promise.near_lossless(own)
            if settings.is_near_lossless
            else promise.closed_loop(own, coded, tile)
        )
        for g, channels in enumerate(GROUP_CHANNELS):
            parts[g] = max(parts[g], (found / bound)[channels][:, live].max(initial=0))
            sizes[g] = max(sizes[g], found[channels][:, live].max(initial=0) * units[g])
    asked = settings.accuracy.wanted_steps(Ranges.of(tiles, n_levels), n_levels)
    spans: F64 = units * [[q.step for q in row[: len(GROUPS)]] for row in coded.quantisers]
    is_coarse = np.any(
        [_is_coarse(tile, spans, asked[:, : len(GROUPS)], units) for tile in coded.tiles], axis=0
    )
    warned = tuple(str(w.message) for w in caught if w.category is AccuracyWarning)
    for g, name in enumerate(GROUPS):
        is_said = any(text.startswith(name) for text in warned)
        if not settings.is_near_lossless and is_coarse[g] and not is_said:
            parts[g] = np.inf
    worst = int(np.argmax(parts))
    return Measured(
        part=float(parts[worst]),
        group=GROUPS[worst],
        errors=dict(zip(GROUPS, sizes.tolist(), strict=True)),
        warned=warned,
        coded=coded,
    )


def _is_coarse(tile: CodedTile, got: F64, asked: F64, units: F64) -> npt.NDArray[np.bool_]:
    """(5,) whether a leaf has a number of a step that is coarser than asked, slot by slot.

    A refine has the steps of its own row alone, a split also those of its parent.
    """
    rounding = np.where(asked < units, 0.0, units / 2)
    over = (got > SAME_STEP * asked) & (got > asked + rounding)
    slots: list[npt.NDArray[np.bool_] | None] = []
    for step in tile.steps:
        children = []
        for slot, kind in zip(step.slots.tolist(), step.kinds.tolist(), strict=True):
            before, row = slots[slot], over[1 + step.level]
            assert before is not None, "a dropped slot changes no more"
            slots[slot] = None if kind == Kind.DROP else row
            if kind == Kind.SPLIT:
                slots[slot] = before | row
                children.append(before | row)
        slots += [*children, *([over[0]] * step.adds.shape[1])]
    found = np.zeros(len(GROUPS), bool)
    for one in slots:
        found |= False if one is None else one
    return found
