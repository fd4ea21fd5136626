"""Scenes that are wide for the steps asked for: roots are coarser, and splits mend that."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import AccuracyWarning, decode, encode
from evogs_codec.encoding.settings import Settings, StepTable
from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Step

EXTENT, STEP = 100.0, 1e-5  # a root 24 bits do not hold: 1e7 steps from the middle
N = 40


def roots() -> np.ndarray:
    x = np.zeros((n_channels(0), N), np.float32)
    x[0:3] = np.random.default_rng(3).uniform(-EXTENT, EXTENT, (3, N))
    x[0:3, :2] = [[-EXTENT, EXTENT]] * 3
    x[3] = 1
    return x


def split(slots) -> Step:
    psi = np.zeros((n_channels(0), len(slots)))
    psi[0:3] = np.random.default_rng(4).uniform(-0.01, 0.01, (3, len(slots)))
    return Step.of_splits(1, slots, psi, np.ones((5, len(slots))))


def wide_settings(n_levels: int) -> Settings:
    rows = np.full((1 + n_levels, 5), 1e-3)
    rows[:, 0] = STEP
    return replace(Settings.of_quanta(StepTable.of(rows).rows), closed_loop=True)


def furthest_off(tree: EvolutionTree, data: bytes) -> float:
    """Of a leaf along an axis; leaves have another order in the stream."""
    right = tree.leaves().means.astype(np.float64)
    off = np.abs(decode(data).leaves().means[:, None] - right).max(2)
    assert sorted(off.argmin(1)) == list(range(len(right)))
    return float(off.min(1).max())


def test_children_of_coarse_roots_are_as_near_as_was_asked():
    tree = EvolutionTree(0, (Step.of_adds(0, roots()), split(np.arange(N))))
    data = encode(tree, wide_settings(2))
    directory = decode(data).directory
    unit = 2.0 ** -directory.grid_exponents[0]
    adds, *_, of_splits = (row[0].step * unit for row in directory.quantisers)
    assert unit <= STEP / 8
    assert EXTENT / adds < 1 << 23
    assert of_splits == pytest.approx(STEP, rel=0.05)
    rounding = float(np.spacing(np.float32(EXTENT)))
    assert furthest_off(tree, data) <= STEP + rounding


def test_leaves_that_stay_coarse_are_warned_of():
    tree = EvolutionTree(0, (Step.of_adds(0, roots()), split(np.arange(N - 1))))
    with pytest.warns(AccuracyWarning, match=r"position: .* step is 1\.\d+e-05, not 1e-05"):
        data = encode(tree, wide_settings(2))
    assert furthest_off(tree, data) <= 2 * EXTENT / (1 << 23)
