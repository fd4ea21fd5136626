"""`EvolutionTree`: its rules, and its leaves against a dictionary of fractions."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given

from evogs_codec.model.channels import GROUP_CHANNELS, n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step
from tests.support.examples import examples
from tests.support.strategies import splats, trees

D = n_channels(0)


def adds(level, *values):
    return Step.of_adds(level, np.array([values] * D, np.float32).reshape(D, len(values)))


def step(level, slots, kinds, psi=(), alpha=(), new=()):
    """A step whose every channel has the same numbers, one per record that has them."""
    return Step(
        level,
        np.array(slots, np.int32),
        np.array(kinds, np.uint8),
        np.array([psi] * D, np.float32).reshape(D, len(psi)),
        np.array([alpha] * 5, np.float32).reshape(5, len(alpha)),
        np.array([new] * D, np.float32).reshape(D, len(new)),
    )


def values(tree, level=None):
    """One number per leaf, for trees of this file, whose channels are all alike."""
    return tree.leaves(level).opacity_logits.tolist()


def oracle(tree, level):
    """Leaves of `level` replayed record by record: {slot: [D fractions]}, live slots only."""
    slots: dict[int, list[Fraction]] = {}
    n = 0
    d = n_channels(tree.sh_degree)
    groups = [g for c in range(d) for g, s in enumerate(GROUP_CHANNELS) if c in range(d)[s]]
    for one in tree.steps:
        if one.level > level:
            break
        new, psi, alpha = [], iter(one.psi.T), iter(one.alpha.T)
        for slot, kind in zip(one.slots.tolist(), one.kinds.tolist(), strict=True):
            parent = slots.pop(slot)
            if kind == Kind.DROP:
                continue
            delta = [Fraction(float(x)) for x in next(psi)]
            slots[slot] = [p + x for p, x in zip(parent, delta, strict=True)]
            if kind == Kind.SPLIT:
                a = [Fraction(float(x)) for x in next(alpha)]
                terms = zip(parent, delta, groups, strict=True)
                new.append([p - a[g] * x for p, x, g in terms])
        new += [[Fraction(float(x)) for x in add] for add in one.adds.T]
        slots |= {n + i: splat for i, splat in enumerate(new)}
        n += len(new)
    return slots


@given(trees(largest=1e6))
@examples(60)
def test_leaves_of_every_level_agree_with_a_dictionary_of_fractions(tree):
    for level in range(tree.n_levels):
        expected = oracle(tree, level)
        leaves = tree.leaves(level).channels().T
        assert len(leaves) == len(expected)
        for leaf, (_, exact) in zip(leaves, sorted(expected.items()), strict=True):
            # float64 of numbers up to 1e10 (1e6 times an alpha of 1000), then float32.
            exact_floats = np.array([float(x) for x in exact])
            np.testing.assert_allclose(leaf, exact_floats, rtol=1e-6, atol=1e-3)


@given(trees())
@examples(60)
def test_levels_are_the_leaves_of_each_level(tree):
    found = list(tree.levels())
    assert len(found) == tree.n_levels
    for level, shown in enumerate(found):
        assert np.array_equal(shown.channels(), tree.leaves(level).channels())
    for first in range(tree.n_levels):
        later = list(tree.levels(first))
        assert len(later) == tree.n_levels - first
        for shown, same in zip(later, found[first:], strict=True):
            assert np.array_equal(shown.channels(), same.channels())


@given(trees())
@examples(40)
def test_some_channels_of_the_slots_are_those_of_all(tree):
    for channels in (slice(None), slice(11), slice(14, None), slice(5, 9)):
        for some, state in zip(tree.states(channels), tree.states(), strict=True):
            assert np.array_equal(some.values, state.values[channels])
            assert np.array_equal(some.live, state.live)


@given(trees())
@examples(60)
def test_counts_agree_with_the_leaves_of_the_last_level(tree):
    assert tree.n_leaves == len(tree.leaves())
    assert len(list(tree.states())) == len(tree.steps)


@given(splats())
@examples(30)
def test_a_tree_of_splats_has_those_splats_as_leaves(scene):
    tree = EvolutionTree.of_splats(scene)
    assert tree.n_levels == 1
    np.testing.assert_array_equal(tree.leaves().channels(), scene.channels())


def test_a_split_keeps_its_slot_for_c1_and_gives_the_next_free_one_to_c2():
    tree = EvolutionTree(0, (adds(0, 1, 2), step(1, [0], [Kind.SPLIT], [10], [0.5], [7])))
    assert values(tree) == [11, 2, -4, 7]
    assert values(tree, 0) == [1, 2]


def test_c2s_come_in_slot_order_and_before_adds():
    split = step(1, [0, 1], [Kind.SPLIT] * 2, [1, 2], [1, 1], [100])
    assert values(EvolutionTree(0, (adds(0, 10, 20), split))) == [11, 22, 9, 18, 100]


def test_alpha_applies_per_group():
    split = step(1, [0], [Kind.SPLIT], [1], [0])
    split = replace(split, alpha=np.array([[1], [2], [3], [4], [5]], np.float32))
    leaf = EvolutionTree(0, (adds(0, 0), split)).leaves().channels()[:, 1]
    assert leaf.tolist() == [-1] * 3 + [-2] * 4 + [-3] * 3 + [-4] + [-5] * 3


def test_generations_of_one_level_apply_one_after_the_other():
    generations = [step(1, [0], [Kind.REFINE], [1]) for _ in range(4)]
    tree = EvolutionTree(0, (adds(0, 0), *generations))
    assert tree.n_levels == 2
    assert values(tree, 1) == [4]


def test_a_level_without_records_shows_the_level_before_it():
    tree = EvolutionTree(0, (adds(0, 1), step(3, [0], [Kind.REFINE], [1])))
    assert tree.n_levels == 4
    assert [values(tree, level) for level in range(4)] == [[1], [1], [1], [2]]


def test_a_chain_of_64_generations_of_splits_evaluates():
    chain = [step(1 + k, [k], [Kind.SPLIT], [1], [1]) for k in range(64)]
    tree = EvolutionTree(0, (adds(0, 0), *chain))
    assert values(tree)[-1] == -64
    assert tree.n_leaves == 65


def test_everything_can_be_dropped_and_adds_can_follow():
    tree = EvolutionTree(0, (adds(0, 1, 2), step(1, [0, 1], [Kind.DROP] * 2), adds(2, 5)))
    assert values(tree, 1) == []
    assert values(tree, 2) == [5]


def test_one_root_and_no_step_at_all_are_trees():
    assert values(EvolutionTree(0, (adds(0, 3),))) == [3]
    empty = EvolutionTree(0, ())
    assert (empty.n_levels, empty.n_leaves) == (0, 0)
    with pytest.raises(ValueError, match=r"level -1 is not one of"):
        empty.leaves()


ROOTS = adds(0, 1, 2, 3)
REFINE = step(1, [0, 1], [Kind.REFINE] * 2, [1, 1])
BROKEN = {
    "levels fall": ((ROOTS, adds(2), adds(1)), r"step 2: level 1 after level 2"),
    "a negative level": ((adds(-1),), r"step 0: level -1"),
    "records in step 0": ((REFINE,), r"step 0: only adds"),
    "slots not sorted": ((ROOTS, replace(REFINE, slots=np.array([1, 0], np.int32))), "increasing"),
    "a slot twice": ((ROOTS, replace(REFINE, slots=np.array([1, 1], np.int32))), "increasing"),
    "a slot too high": ((ROOTS, replace(REFINE, slots=np.array([1, 3], np.int32))), r"in 0\.\.2"),
    "a slot below zero": ((ROOTS, replace(REFINE, slots=np.array([-1, 1], np.int32))), r"0\.\.2"),
    "a dropped slot": ((ROOTS, step(1, [0], [Kind.DROP]), REFINE), r"step 2: slot 0 was dropped"),
    "a slot of its own step": ((ROOTS, step(1, [0, 3], [1, 0], [1, 1], [1])), r"in 0\.\.2"),
    "an add among the kinds": ((ROOTS, step(1, [0], [Kind.ADD], [1])), r"kinds must be"),
    "a kind too few": ((ROOTS, replace(REFINE, kinds=np.zeros(1, np.uint8))), r"kinds must be 2"),
    "psi for a drop": ((ROOTS, step(1, [0], [Kind.DROP], [1])), r"psi has shape \(14, 1\)"),
    "alpha for a refine": ((ROOTS, step(1, [0], [Kind.REFINE], [1], [1])), r"alpha has shape"),
    "too few channels": ((ROOTS, replace(REFINE, psi=REFINE.psi[:-1])), r"psi has shape"),
    "adds of another degree": (
        (replace(ROOTS, adds=np.zeros((D + 9, 1), np.float32)),),
        r"adds has",
    ),
    "NaN in psi": ((ROOTS, step(1, [0], [Kind.REFINE], [np.nan])), r"psi has a value"),
    "infinite alpha": ((ROOTS, step(1, [0], [Kind.SPLIT], [1], [np.inf])), r"alpha has a value"),
    "infinite add": ((adds(0, np.inf),), r"adds has a value"),
}


@pytest.mark.parametrize(("steps", "message"), BROKEN.values(), ids=BROKEN.keys())
def test_a_tree_that_breaks_a_rule_is_refused_with_step_and_rule(steps, message):
    with pytest.raises(ValueError, match=message):
        EvolutionTree(0, steps)


def test_the_arrays_of_splats_are_read_only():
    scene = SplatParams.from_channels(np.zeros((D, 2), np.float32))
    with pytest.raises(ValueError, match="read-only"):
        scene.means[0, 0] = 1
