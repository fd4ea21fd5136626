"""Alpha tables have the entries that splits name, and no others."""


import numpy as np
import pytest
from hypothesis import given

from evogs_codec import PRESETS, EvolutionTree, decode, encode, lift, read_directory
from evogs_codec.editing.omissions import UNUSED, omissions
from evogs_codec.encoding import quantise as quantising
from evogs_codec.encoding.alpha_tables import only_used
from evogs_codec.encoding.write import write
from evogs_codec.model.tree import Step
from evogs_codec.render.demo_scene import make_scene
from tests.support.coded_strategies import coded_trees


def alphas(tree):
    """What each split of each step has, per group."""
    return [
        [tree.alpha_table(step.level, g).values[row].tolist() for g, row in enumerate(step.alpha)]
        for tile in tree.tiles
        for step in tile.steps
    ]


def counts(tree, place):
    level, group = place
    rows = [s.alpha[group] for tile in tree.tiles for s in tile.steps if s.level == level]
    return np.bincount(np.concatenate(rows), minlength=len(tree.alpha[place].entries)).tolist()


@given(coded_trees())
def test_alphas_stay_and_every_entry_is_named_the_frequent_ones_first(tree):
    found = only_used(tree)
    assert alphas(found) == alphas(tree)
    for place, table in found.alpha.items():
        named = counts(found, place)
        assert len(named) == len(table.entries)
        assert 0 not in named
        assert named == sorted(named, reverse=True)
        assert table.values.tolist() != [1.0]


@given(coded_trees())
def test_what_a_decoder_has_stays(tree):
    before, after = decode(write(tree)), decode(write(only_used(tree)))
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
    monkeypatch.setattr(quantising, "only_used", lambda coded: coded)
    large = encode(tree, settings)
    assert len(small) < len(large)
    one, other = (decode(data).leaves().channels() for data in (small, large))
    assert np.array_equal(one, other)
