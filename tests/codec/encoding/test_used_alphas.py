"""Alpha tables have the entries that splits need, and no others."""

import numpy as np
import pytest
from hypothesis import given

from evogs_codec import PRESETS, EvolutionTree, decode, encode, lift, read_directory
from evogs_codec.editing.omissions import UNUSED, omissions
from evogs_codec.encoding.alpha_tables import with_used_entries
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.write import write
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render.demo_scene import make_scene
from tests.support.coded_strategies import coded_trees


def moving(step, group):
    """Splits with a psi of a group that is not 0."""
    is_split = step.kinds[step.kinds != Kind.DROP] == Kind.SPLIT
    return step.psi[GROUP_CHANNELS[group]][:, is_split].any(axis=0)


def alphas(tree):
    """What each split of each step has, per group, where that changes something."""
    return [
        [
            tree.alpha_table(step.level, g).values[row][moving(step, g)].tolist()
            for g, row in enumerate(step.alpha)
        ]
        for tile in tree.tiles
        for step in tile.steps
    ]


@given(coded_trees())
def test_alphas_stay_and_every_entry_is_one_of_a_split_that_needs_it(tree):
    found = with_used_entries(tree)
    assert alphas(found) == alphas(tree)
    for (level, group), table in found.alpha.items():
        named = set()
        for step in (s for tile in found.tiles for s in tile.steps if s.level == level):
            named |= set(step.alpha[group][moving(step, group)].tolist())
        assert named == set(range(len(table.entries)))
        assert table.values.tolist() != [1.0]


def test_a_split_that_needs_no_alpha_has_the_most_frequent_one_of_its_step():
    n, psi = 8, np.zeros((14, 8), np.float32)
    psi[10] = [0, 1, 1, 1, 0, 1, 0, 1]
    alpha = np.ones((5, n))
    alpha[3] = [0.25, 0.5, 0.5, 0.75, 0.75, 0.5, 0.25, 0.5]
    roots = Step.of_adds(0, np.random.default_rng(2).normal(size=(14, n)).astype(np.float32))
    tree = EvolutionTree(0, (roots, Step.of_splits(1, np.arange(n), psi, alpha)))
    coded = with_used_entries(quantise([tree], 2, PRESETS["near-lossless"]))
    table = coded.alpha_table(1, 3)
    assert sorted(table.values) == [0.5, 0.75]
    found = table.values[coded.tiles[0].steps[1].alpha[3]].tolist()
    assert found == [0.5, 0.5, 0.5, 0.75, 0.5, 0.5, 0.5, 0.5]


@pytest.mark.thorough
@given(coded_trees())
def test_what_a_decoder_has_stays(tree):
    before, after = decode(write(tree)), decode(write(with_used_entries(tree)))
    for one, other in zip(before.tiles, after.tiles, strict=True):
        assert np.array_equal(one.x, other.x)


def tree_with_alphas(rng, n=300):
    """Splits with so many alphas that a table is fitted to them; few of its entries are cheap."""
    roots = Step.of_adds(0, rng.normal(size=(14, n)).astype(np.float32))
    psi = rng.normal(scale=0.02, size=(14, n)).astype(np.float32)
    return EvolutionTree(0, (roots, Step.of_splits(1, np.arange(n), psi, rng.random((5, n)))))


@pytest.mark.parametrize("preset", ["scene", "trained", "paper"])
def test_streams_have_no_entry_that_no_split_names(preset):
    for tree in (lift(make_scene(200), 3), tree_with_alphas(np.random.default_rng(1))):
        data = memoryview(encode(tree, PRESETS[preset]))
        found = omissions(read_directory(data), data)
        assert not [row for row in found if row.reason.endswith(UNUSED)]


def test_without_them_a_stream_is_smaller(monkeypatch):
    tree, settings = tree_with_alphas(np.random.default_rng(1)), PRESETS["trained"]
    small = encode(tree, settings)
    monkeypatch.setattr("evogs_codec.encoding.encode.with_used_entries", lambda coded: coded)
    large = encode(tree, settings)
    assert len(small) < len(large)
    one, other = (decode(data).leaves().channels() for data in (small, large))
    assert np.array_equal(one, other)
