"""Lifting: the leaves are the input, the levels above cover the scene."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import scipy

from evogs_codec.common.morton import morton_order
from evogs_codec.lifting import lift as lift_module
from evogs_codec.lifting import pairing
from evogs_codec.lifting.concat import joined
from evogs_codec.lifting.lift import default_levels, lift, lift_with_order
from evogs_codec.lifting.orientations import MAX_G, largest_w, turned
from evogs_codec.lifting.parents import ALPHAS_OPACITY, ALPHAS_SCALE, OFF_LINE
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step
from evogs_codec.render.demo_scene import make_scene
from tests.support.lifted_scenes import assert_leaves_are, covariances, surface, with_channels


def masses(splats: SplatParams) -> F64:
    """(N,) opacity times cross-section."""
    variances = np.exp(2 * splats.log_scales.astype(np.float64))
    a, b, c = variances.T
    opacity = 1 / (1 + np.exp(-splats.opacity_logits.astype(np.float64)))
    out: F64 = opacity * np.sqrt(a * b + a * c + b * c)
    return out


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_leaves_are_the_input_as_gaussians(sh_degree):
    assert_leaves_are(surface(2000, sh_degree))


@pytest.mark.parametrize("n", [0, 1, 2, 3, 17])
@pytest.mark.parametrize("n_levels", [1, 2, 5])
def test_few_splats_are_lifted(n, n_levels):
    assert_leaves_are(surface(n), n_levels)


def test_streams_of_few_splats_have_fewer_levels():
    n_splats = [0, 1, 2000, 3999, 4000, 7999, 8000, 16_000, 19_999, 20_000, 10**9]
    assert [default_levels(n) for n in n_splats] == [1, 1, 1, 1, 2, 2, 3, 4, 4, 5, 5]


@pytest.mark.parametrize("wrong", [{"n_levels": 0}, {"n_neighbours": 0}])
def test_a_tree_needs_a_level_and_a_neighbour(wrong):
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} is 0, expected at least 1"):
        lift(make_scene(20), **wrong)


def test_one_level_is_a_tree_of_adds():
    tree = lift(surface(100), 1)
    assert len(tree.steps) == 1
    assert tree.steps[0].n_adds == 100


def test_each_level_has_half_the_splats_of_the_next():
    tree = lift(surface(20_000), 5)
    counts = [len(tree.leaves(level)) for level in range(5)]
    assert counts[4] == 20_000
    for coarse, fine in pairwise(counts):
        assert 0.5 <= coarse / fine <= 0.515


def test_scattered_splats_are_paired_although_their_parents_are_too_large():
    splats = surface(1000)
    tiny = SplatParams(
        splats.means, splats.quats, splats.log_scales - 10, splats.opacity_logits, splats.sh
    )
    assert len(lift(tiny, 2).leaves(0)) <= 600


def splits(tree: EvolutionTree) -> list[Step]:
    """The steps that split; those that correct come after them, in the same level."""
    return [step for step in tree.steps[1:] if (step.kinds == Kind.SPLIT).all()]


def test_levels_are_splits_with_alphas_of_the_tables():
    steps = splits(lift(surface(3000), 4))
    assert [step.level for step in steps] == [1, 2, 3]
    for step in steps:
        assert not step.n_adds
        assert (step.alpha[[0, 4]] == 1).all()
        assert (step.alpha[1] == 0).all()
        assert set(step.alpha[2]) <= {*ALPHAS_SCALE, OFF_LINE}
        assert set(step.alpha[3]) <= set(ALPHAS_OPACITY)


def test_steps_that_do_not_split_refine_both_children_of_corrected_splats_in_the_same_level():
    tree = lift(faint_but_large(), 4)
    corrections = [k for k, step in enumerate(tree.steps) if (step.kinds == Kind.REFINE).any()]
    assert corrections
    for k in corrections:
        step, split = tree.steps[k], tree.steps[k - 1]
        assert (step.kinds == Kind.REFINE).all()
        assert step.level == split.level
        assert not step.n_adds
        assert not step.psi[3].any()
        n_slots = sum(s.n_new for s in tree.steps[: k - 1])
        rows = np.flatnonzero(split.alpha[2] == OFF_LINE)
        np.testing.assert_array_equal(step.slots, [*split.slots[rows], *(n_slots + rows)])


def test_a_corrected_parent_has_the_moments_of_its_leaves():
    splats = faint_but_large()
    lifted = lift_with_order(splats, 2)
    split = lifted.tree.steps[1]
    rows = np.flatnonzero(split.alpha[2] == OFF_LINE)
    slots = split.slots[rows]
    parents = covariances(lifted.tree.leaves(0).take(slots))
    pairs = [lifted.leaf_of[slots], lifted.leaf_of[lifted.tree.steps[0].n_adds + rows]]
    first, second = (splats.take(leaves) for leaves in pairs)
    share = (masses(first) / (masses(first) + masses(second)))[:, None, None]
    d = (first.means - second.means).astype(np.float64)
    wanted = share * covariances(first) + (1 - share) * covariances(second)
    wanted += share * (1 - share) * d[:, :, None] * d[:, None]
    np.testing.assert_allclose(parents, wanted, atol=2e-4 * wanted.max())


def test_a_scene_of_likes_corrects_nothing():
    assert len(lift(surface(3000), 4).steps) == 4


def faint_but_large() -> SplatParams:
    """A surface, one part in twenty of it a thousand times as large, as a sky is."""
    splats = surface(3000)
    scale = np.where(np.arange(3000) % 20, 1.0, 1000.0)[:, None]
    return with_channels(
        splats, means=splats.means * scale, log_scales=splats.log_scales + np.log(scale)
    )


def test_w_is_one_and_g_bounded_so_that_rotations_cost_three_channels():
    tree = lift(surface(3000), 4)
    assert (tree.steps[0].adds[3] == 1).all()
    assert all((step.psi[3] == 0).all() for step in tree.steps[1:])
    assert np.linalg.norm(tree.leaves().quats[:, 1:], axis=1).max() < MAX_G + 1e-5


def test_siblings_are_written_more_alike_than_each_with_its_largest_w():
    splats = surface(3000)
    lifted = lift_with_order(splats, 2)
    psi = lifted.tree.steps[1].psi[4:7]
    # Slots of the children: C1 has the parent's, C2 the next free one.
    c1 = lifted.leaf_of[lifted.tree.steps[1].slots]
    c2 = lifted.leaf_of[lifted.tree.steps[0].n_adds :]
    quats = splats.quats.T.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=0)
    _, g, _ = turned(quats, splats.log_scales.T.astype(np.float64), largest_w(quats))
    assert np.abs(psi).mean() < 0.9 * np.abs(g[:, c1] - g[:, c2]).mean()


def test_coarse_levels_cover_the_scene():
    splats = surface(8000)
    tree = lift(splats, 5)
    for level in range(5):
        leaves = tree.leaves(level)
        np.testing.assert_allclose(leaves.means.min(0), splats.means.min(0), atol=0.15)
        np.testing.assert_allclose(leaves.means.max(0), splats.means.max(0), atol=0.15)
        # Nearly every input splat lies within three standard deviations of some splat.
        inverse = np.linalg.inv(covariances(leaves) + np.eye(3) * 0.02**2)
        d = splats.means[::40, None].astype(np.float64) - leaves.means[None]
        distance = np.einsum("abi,bij,abj->ab", d, inverse, d, optimize=True)
        assert (distance.min(axis=1) < 9).mean() >= 0.96, level


def test_a_parent_is_at_least_as_large_as_its_larger_child():
    tree = lift(surface(3000), 2)
    step = tree.steps[1]
    c2 = tree.steps[0].adds[7:10, step.slots] - step.alpha[2] * step.psi[7:10]
    parent = tree.steps[0].adds[7:10, step.slots]
    # C2 is the larger child; along the line the parent is it or lies beyond it.
    assert (parent.sum(axis=0) >= c2.sum(axis=0) - 1e-4).all()


def test_a_generation_keeps_most_of_the_mass():
    """Not all of it: children that are alike have no larger parent on their line (`merging`).

    The bound guards against a relapse, it is no goal: this scene keeps 0.66 to 0.83.
    """
    tree = lift(surface(8000), 5)
    mass = [masses(tree.leaves(level)).sum() for level in range(5)]
    for coarse, fine in pairwise(mass):
        assert 0.6 < coarse / fine < 1.05


def test_two_lifts_of_one_scene_are_the_same():
    first, second = lift_with_order(surface(3000)), lift_with_order(surface(3000))
    np.testing.assert_array_equal(first.leaf_of, second.leaf_of)
    for a, b in zip(first.tree.steps, second.tree.steps, strict=True):
        np.testing.assert_array_equal(a.slots, b.slots)
        np.testing.assert_array_equal(a.psi, b.psi)
        np.testing.assert_array_equal(a.alpha, b.alpha)
        np.testing.assert_array_equal(a.adds, b.adds)


def test_roots_are_in_morton_order():
    roots = lift(surface(3000), 4).leaves(0).means.astype(np.float64)
    np.testing.assert_array_equal(morton_order(roots.T), np.arange(len(roots)))


def test_a_large_scene_is_lifted_in_parts(monkeypatch):
    splats = surface(1000)
    whole = lift(splats, 4)
    monkeypatch.setattr(lift_module, "MAX_PART", 300)
    seen: list[tuple[str, float]] = []
    lifted = lift_with_order(splats, 4, progress=lambda *step: seen.append(step))
    assert seen == [("lift", part) for part in (0.25, 0.5, 0.75, 1.0)]
    assert sorted(lifted.leaf_of) == list(range(1000))
    leaves = lifted.tree.leaves()
    np.testing.assert_allclose(leaves.means, splats.means[lifted.leaf_of], atol=1e-5)
    np.testing.assert_allclose(
        covariances(leaves), covariances(splats)[lifted.leaf_of], rtol=1e-3, atol=1e-9
    )
    for level in range(4):
        n = len(lifted.tree.leaves(level))
        assert abs(n / len(whole.leaves(level)) - 1) < 0.05


def test_no_threads_of_scipy_outlive_an_interrupt(monkeypatch):
    """They would write on, into arrays that are free by then."""
    tree, queries = scipy.spatial.cKDTree, []

    class Tree:
        def __init__(self, points):
            self._tree = tree(points)

        def query(self, points, k, workers=1):
            queries.append((len(points), workers))
            return self._tree.query(points, k, workers=workers)

    scene = make_scene(9000)
    expected = lift(scene, 3)
    monkeypatch.setattr(scipy.spatial, "cKDTree", Tree)
    found = lift(scene, 3)
    assert {workers for _, workers in queries} == {1}
    np.testing.assert_array_equal(found.leaves(0).channels(), expected.leaves(0).channels())


def test_joined_trees_have_the_leaves_of_each_at_every_level():
    trees = [
        *(lift(surface(n, seed=n), n_levels) for n, n_levels in ((40, 3), (90, 4), (7, 2))),
        EvolutionTree(1, ()),
    ]
    drops = Step(
        3,
        np.array([2, 5], np.int32),
        np.array([Kind.DROP, Kind.REFINE], np.uint8),
        np.ones((23, 1), np.float32),
        np.empty((5, 0), np.float32),
        np.full((23, 2), 3, np.float32),
    )
    trees[0] = EvolutionTree(1, (*trees[0].steps, drops))
    tree, slots = joined(trees)
    for level in range(4):
        values, live = slots_at(tree, level)
        for own, places in zip(trees, slots, strict=True):
            own_values, own_live = slots_at(own, level)
            there = places[: len(own_live)]
            np.testing.assert_array_equal(values[:, there], own_values)
            np.testing.assert_array_equal(live[there], own_live)


def slots_at(tree, level):
    """Numbers (D, n) and liveness of the slots after the last step of a level."""
    values, live = np.zeros((23, 0)), np.zeros(0, bool)
    for step, state in zip(tree.steps, tree.states(), strict=True):
        if step.level <= level:
            values, live = state.values.copy(), state.live.copy()
    return values, live


def test_progress_rises_to_one():
    shares: list[float] = []
    lift(surface(500), 4, progress=lambda _, part: shares.append(part))
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_adds_and_splits_are_as_many_as_leaves_so_levels_are_free_of_extra_records():
    tree = lift(surface(3000), 5)
    made = sum(step.n_adds + int((step.kinds == Kind.SPLIT).sum()) for step in tree.steps)
    assert made == tree.n_leaves == 3000


def test_candidate_pairs_are_those_of_the_nearest_whatever_the_order_of_points():
    points = np.random.default_rng(0).normal(size=(300, 3))
    apart = np.square(points[:, None] - points).sum(axis=2)
    nearest = np.argsort(apart, axis=1)[:, : pairing.N_NEIGHBOURS + 1]
    expected = {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}
    found = list(zip(*(ends.tolist() for ends in pairing._edges(points)), strict=True))
    assert len(found) == len(set(found))
    assert set(found) == {(i, j) for i, j in expected if i != j}
