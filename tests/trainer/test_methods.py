"""Every method trains, gives a legal tree, and what a decoder makes of it is what was trained."""

import numpy as np
import pytest

from evogs_codec.io.tree_npz import read_tree, write_tree
from evogs_codec.model.tree import Kind
from reference_trainer.config import METHODS
from reference_trainer.evaluate import evaluate, storage
from tests.trainer import tiny


def trained(method):
    return tiny.trained(method=method)


@pytest.mark.parametrize("method", METHODS)
def test_a_method_gives_a_tree_that_renders_at_every_level(method, tmp_path):
    tree = trained(method)
    rows = evaluate(tree, method, tiny.pyramid(), tmp_path)
    assert [row["level"] for row in rows] == [0, 1]
    assert all(row["psnr"] > 12 and 0 < row["splats"] <= 70 for row in rows)
    assert (tmp_path / "L1.png").exists()
    write_tree(tmp_path / "a.tree.npz", tree)
    again = read_tree(tmp_path / "a.tree.npz")
    for level in range(tree.n_levels):
        np.testing.assert_array_equal(again.leaves(level).means, tree.leaves(level).means)


def test_a_layer_of_lapis_changes_nothing_below_but_opacity():
    tree = trained("lapis")
    before, after = tree.leaves(0), tree.leaves(1)
    n = len(before)
    for name in ("means", "quats", "log_scales", "sh"):
        np.testing.assert_array_equal(getattr(after, name)[:n], getattr(before, name))
    assert (after.opacity_logits[:n] != before.opacity_logits).any()


def test_a_layer_of_l3gs_changes_nothing_below():
    tree = trained("l3gs")
    before, after = tree.leaves(0).channels(), tree.leaves(1).channels()
    np.testing.assert_array_equal(after[:, : before.shape[1]], before)


def test_alpha_of_the_symmetric_tree_is_one_and_of_the_other_is_learned():
    def alphas(method):
        return np.concatenate([step.alpha for step in trained(method).steps], axis=1)

    assert (alphas("evogs-sym") == 1).all()
    assert np.ptp(alphas("evogs"), axis=1).min() > 0


def test_storage_counts_what_the_paper_counts():
    d = 11 + 12
    tree = trained("evogs")
    splits = sum(int((s.kinds == Kind.SPLIT).sum()) for s in tree.steps)
    refines = sum(int((s.kinds == Kind.REFINE).sum()) for s in tree.steps)
    roots = tree.steps[0].n_adds
    assert storage(tree, "evogs", 0) == 4 * d * roots
    assert storage(tree, "evogs", 1) == 4 * (d * (roots + refines) + (d + 5) * splits)
    mono = trained("mono")
    assert storage(mono, "mono", 1) == 4 * d * len(mono.leaves(1))
    lapis = trained("lapis")
    n = len(lapis.leaves(0))
    assert storage(lapis, "lapis", 1) == 4 * (d * len(lapis.leaves(1)) + n)
