"""Scenes that are wide for the steps asked for: roots are coarser, and refines correct that."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import AccuracyWarning, decode, encode
from evogs_codec.encoding.grids import Grid, TooFineError, with_a_coarser_row
from evogs_codec.encoding.settings import Settings, StepTable
from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Kind, Step

EXTENT, STEP = 100.0, 1e-6  # roots at 1e8 steps from the middle, for which 24 bits do not do
N, D = 40, n_channels(0)
SLOTS = np.arange(N)


def roots(extent=EXTENT) -> Step:
    """Two far away, the others near the middle, where binary32 is far finer than a step."""
    x = np.zeros((D, N), np.float32)
    x[0:3] = np.random.default_rng(3).uniform(-0.01, 0.01, (3, N))
    x[0:3, :2] = [[-extent, extent]] * 3
    x[3] = 1
    return Step.of_adds(0, x)


def psi(part=slice(0, 3)) -> np.ndarray:
    found = np.zeros((D, N))
    found[part] = np.random.default_rng(4).uniform(-0.01, 0.01, found[part].shape)
    return found


def wide_settings(n_levels: int = 2) -> Settings:
    rows = np.full((1 + n_levels, 5), 1e-3)
    rows[:, 0] = STEP
    return replace(Settings.of_quanta(StepTable.of(rows).rows), closed_loop=True)


def encoded(*steps: Step) -> tuple[bytes, float]:
    """A stream, and the most that a leaf near the middle is off along an axis, in steps."""
    tree = EvolutionTree(0, steps)
    data = encode(tree, wide_settings())
    right = tree.leaves().means.astype(np.float64)
    off = np.abs(decode(data).leaves().means[:, None] - right).max(2)
    near = np.abs(right).max(1) < 1
    assert near.sum() >= len(right) - 4
    return data, float(off.min(0)[near].max()) / STEP


def test_refines_correct_what_coarse_roots_are_off():
    data, off = encoded(roots(), Step.of_refines(1, SLOTS, psi()))
    directory = decode(data).directory
    unit = 2.0 ** -directory.grid_exponents[0]
    adds, *_, of_refines = (row[0].step * unit for row in directory.quantisers)
    assert unit <= STEP
    assert 10 * STEP < adds < 40 * STEP
    assert of_refines == pytest.approx(STEP, rel=0.1)
    assert off <= 0.51


@pytest.mark.parametrize(
    "step",
    [
        Step.of_splits(1, SLOTS, psi(), np.ones((5, N))),
        Step.of_refines(1, SLOTS, psi(slice(3, 7))),
        Step.of_refines(1, SLOTS[1:], psi()[:, 1:]),
    ],
    ids=["splits", "refines of rotations", "refines of all but one"],
)
def test_leaves_that_keep_what_their_roots_are_off_are_warned_of(step):
    with pytest.warns(AccuracyWarning, match=r"position: .* step is 1\.53e-05, not 1e-06"):
        _, off = encoded(roots(), step)
    assert off <= 8


def test_a_warning_names_no_group_that_is_as_asked():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        encoded(roots(), Step.of_splits(1, SLOTS, psi(), np.ones((5, N))))
    assert [str(one.message).split(":")[0] for one in caught] == ["position"]


def test_only_the_classes_that_need_it_are_coarser():
    steps = np.full((3, 8), 1e-3)
    settings = replace(Settings.of_quanta(StepTable.of(steps).rows), closed_loop=True)
    grid = Grid.of(3, (14,) * 5, steps, settings)
    found = with_a_coarser_row(steps, grid, TooFineError(4, 0, {4: 8.0}))
    assert found[0, 4] == pytest.approx(8e-3, rel=0.05)
    found[0, 4] = 1e-3
    assert (found == steps).all()


def test_scenes_of_which_no_splat_is_left_are_not_coarse():
    kinds = np.full(N, Kind.DROP, np.uint8)
    empty = np.empty((D, 0), np.float32)
    drop = Step(1, SLOTS.astype(np.int32), kinds, empty, np.empty((5, 0), np.float32), empty)
    tree = EvolutionTree(0, (roots(1e7), drop))
    assert decode(encode(tree, wide_settings())).n_leaves == 0
