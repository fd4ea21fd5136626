"""Near-lossless streams against an exact evaluation of the tree; the closed loop along chains."""

from dataclasses import replace
from fractions import Fraction
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.settings import PRESETS, FixedSteps, Settings
from evogs_codec.encoding.write import write
from evogs_codec.format.directory import read_directory
from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Kind, Step
from tests.support.exact import GROUP_OF, exact_states, largest_errors
from tests.support.examples import examples
from tests.support.strategies import trees

NEAR_LOSSLESS = replace(PRESETS["near-lossless"], zstd_level=1)


def errors_by_level(
    tiles: list[EvolutionTree], settings: Settings, every: int = 1
) -> list[list[Fraction]]:
    """[level][channel] largest error, in grid units, after every few levels of each tile."""
    n_levels = max([tile.n_levels for tile in tiles] + [1])
    data = write(quantise(tiles, n_levels, settings), zstd_level=1)
    directory = read_directory(data)
    out = []
    states = [exact_states(tile) for tile in tiles]
    for level in range(n_levels):
        is_measured = level % every == 0 or level == n_levels - 1
        decoded = decode(data, Cut.of_level(directory, level)) if is_measured else None
        for number, tile in enumerate(tiles):
            n_steps = sum(step.level == level for step in tile.steps)
            for _ in range(n_steps):
                x, live = next(states[number])
            if n_steps and decoded is not None:
                channels = decoded.tiles[number].channels().tolist()
                origin = tuple(directory.tiles["origin"][number].tolist())
                out.append(largest_errors(x, live, channels, origin, directory.grid_exponents))
    return out


def a_level_per_step(tree: EvolutionTree) -> EvolutionTree:
    """The same tree; every step can be asked for by its level."""
    steps = tuple(replace(step, level=k) for k, step in enumerate(tree.steps))
    return EvolutionTree(tree.sh_degree, steps)


def chain(degree, n, kind, *, psi, alpha, level=None):
    """One root, then n generations of a record in slot 0, with `psi(k)` and `alpha(k)`."""
    d = n_channels(degree)
    steps = [Step.of_adds(0, np.linspace(-1, 1, d, dtype=np.float32)[:, None])]
    steps += [
        Step(
            k if level is None else level,
            np.zeros(1, np.int32),
            np.array([kind], np.uint8),
            np.full((d, 1), psi(k), np.float32),
            np.full((5, int(kind == Kind.SPLIT)), alpha(k), np.float32),
            np.zeros((d, 0), np.float32),
        )
        for k in range(1, n + 1)
    ]
    return EvolutionTree(degree, tuple(steps))


# --- near-lossless ----------------------------------------------------------------------------


@examples(25)
@given(trees(largest=300))
def test_every_number_is_within_a_grid_unit_after_every_step(tree):
    arranged = a_level_per_step(arrange(tree, 1)[0])
    for errors in errors_by_level([arranged], NEAR_LOSSLESS):
        assert max(errors) <= 1


@pytest.mark.thorough
@examples(15)
@given(trees(largest=300), st.integers(1, 3))
def test_every_number_is_within_a_grid_unit_after_every_level_of_every_tile(tree, n_tiles):
    for errors in errors_by_level(arrange(tree, n_tiles), NEAR_LOSSLESS):
        assert max(errors) <= 1


ALPHAS = {
    "symmetric": lambda k: 1.0,
    "zero": lambda k: 0.0,
    "both children shrink": lambda k: -1.0,
    "ten": lambda k: 10.0,
    "minus a thousand": lambda k: -1000.0,
    "no fraction of 2**12": lambda k: 1 / 3,
    "another in each generation": lambda k: np.sin(k) * 10,
}


@pytest.mark.thorough
@pytest.mark.parametrize("alpha", ALPHAS.values(), ids=ALPHAS.keys())
@pytest.mark.parametrize("kind", [Kind.REFINE, Kind.SPLIT])
@pytest.mark.parametrize("level", [None, 1], ids=["a level each", "one level"])
def test_a_chain_of_64_generations_stays_within_a_grid_unit(kind, alpha, level):
    n = 64 if level else 63  # a stream has 64 levels at most
    tree = chain(0, n, kind, psi=lambda k: 0.3 * np.cos(k), alpha=alpha, level=level)
    for errors in errors_by_level([tree], NEAR_LOSSLESS, every=9):
        assert max(errors) <= 1


@pytest.mark.parametrize(
    "size", [1e-30, *(pytest.param(size, marks=pytest.mark.thorough) for size in (1e-6, 1.0, 1e4))]
)
def test_large_and_tiny_changes_stay_within_a_grid_unit(size):
    tree = chain(0, 20, Kind.SPLIT, psi=lambda k: size * np.sin(k), alpha=np.cos)
    for errors in errors_by_level([tree], NEAR_LOSSLESS):
        assert max(errors) <= 1


def expect_finest_grid(tree):
    coded = quantise([arrange(tree, 1)[0]], max(tree.n_levels, 1), NEAR_LOSSLESS)
    assert {q.step for row in coded.quantisers for q in row} == {1}
    largest = [0.0] * 5
    for state in tree.states():
        for channel, values in enumerate(state.values):
            group = GROUP_OF[channel]
            largest[group] = max([largest[group], *np.abs(values).tolist()])
    for group in range(1, 5):  # positions are counted from the origin of their tile
        units = largest[group] * 2.0 ** coded.grid_exponents[group]
        assert units > (1 << 20) or coded.grid_exponents[group] == 40


@examples(15)
@given(trees(largest=300))
def test_the_grid_is_as_fine_as_24_bits_allow(tree):
    expect_finest_grid(tree)


@pytest.mark.parametrize("alpha", [6.447021484375, 1000.5, 7.9997], ids=str)
def test_one_large_alpha_of_many_digits_makes_no_grid_coarser(alpha):
    """Its products with psi are beyond 2**30: the second child gets another, and a refine."""
    tree = chain(0, 3, Kind.SPLIT, psi=lambda k: 5.0, alpha=lambda k: alpha)
    expect_finest_grid(tree)
    for errors in errors_by_level([tree], NEAR_LOSSLESS):
        assert max(errors) <= 1


# --- the closed loop --------------------------------------------------------------------------

TRAINED = replace(PRESETS["trained"], zstd_level=1)
STEPS = cast(FixedSteps, TRAINED.accuracy)


def errors_in_steps(tree: EvolutionTree, settings: Settings) -> list[float]:
    """By step of the input the largest error of a live splat, in quantiser steps of psi."""
    coded = quantise([tree], tree.n_levels, settings)
    data = write(coded, zstd_level=1)
    out = []
    for k, (x, live) in enumerate(exact_states(tree)):
        if k % 8 and k < len(tree.steps) - 1:
            continue
        decoded = decode(data, Cut(np.array([[k + 1] * (tree.sh_degree + 1)])))
        channels = decoded.tiles[0].channels().tolist()
        errors = largest_errors(x, live, channels, coded.tiles[0].origin, coded.grid_exponents)
        quantisers = coded.quantisers[1 + tree.steps[k].level]
        out.append(max(float(e) / quantisers[GROUP_OF[c]].step for c, e in enumerate(errors)))
    return out


@pytest.mark.parametrize("kind", [Kind.REFINE, Kind.SPLIT])
def test_errors_do_not_grow_along_a_chain_where_psi_can_correct_them(kind):
    # Rounding each psi alone loses the same again and again. With alpha = -1 both children of a
    # split are P + psi, so that psi can correct the error of P in both.
    tree = chain(0, 64, kind, psi=lambda k: 0.0002, alpha=lambda k: -1.0, level=1)
    assert max(errors_in_steps(tree, TRAINED)) <= 0.501
    assert errors_in_steps(tree, replace(TRAINED, closed_loop=False))[-1] > 10


def test_a_refine_corrects_whatever_64_generations_of_splits_left():
    tree = chain(0, 64, Kind.SPLIT, psi=lambda k: 0.0002, alpha=lambda k: 1.0, level=1)
    d, n = n_channels(0), 65
    correction = Step(
        1,
        np.arange(n, dtype=np.int32),
        np.zeros(n, np.uint8),
        np.zeros((d, n), np.float32),
        np.zeros((5, 0), np.float32),
        np.zeros((d, 0), np.float32),
    )
    errors = errors_in_steps(EvolutionTree(0, (*tree.steps, correction)), TRAINED)
    assert max(errors[:-1]) > 10  # C1 + C2 = 2 P: no psi corrects the error of P in both
    assert errors[-1] <= 0.501


@pytest.mark.parametrize(
    "alpha",
    [*(pytest.param(alpha, marks=pytest.mark.thorough) for alpha in (0.33, 1.0, 2.4, 10.0)), 0.4],
)
def test_errors_grow_no_faster_than_by_half_a_step_a_split_along_a_chain(alpha):
    # No psi serves both children; what is left over must not be multiplied from split to split.
    # An alpha up to half an entry of the table off costs C2 this once, in steps of positions.
    off = 0.3 * 2.0 ** -(TRAINED.alpha_bits + 1) / STEPS.steps[0]
    tree = chain(0, 64, Kind.SPLIT, psi=lambda k: 0.3 * np.cos(k), alpha=lambda k: alpha, level=1)
    errors = errors_in_steps(tree, TRAINED)
    for generation, error in zip(range(0, 65, 8), errors, strict=True):
        assert error <= off + 1 + 0.5 * generation
