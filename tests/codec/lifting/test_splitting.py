"""Splits of pairs whose parent is on no line: room first, then what the children are."""

from __future__ import annotations

import numpy as np
import pytest

from evogs_codec.lifting.parents import OFF_LINE
from evogs_codec.lifting.splitting import split_steps
from evogs_codec.model.tree import EvolutionTree, Kind, Step
from evogs_codec.render import orbit, psnr, render


def pair(alpha_scale):
    """A parent (59, 1) and two children unlike each other, on no line with it, and alpha."""
    parent, c1, c2 = np.zeros((3, 59, 1))
    for x in (parent, c1, c2):
        x[3] = 1
        x[7:10] = -1.0
        x[10] = 3.0
    c1[[0, 7]], c2[[0, 4, 7]] = [[0.6], [-2.0]], [[-0.4], [0.3], [-0.5]]
    c1[11:14], c2[11:14] = 1.0, -1.0
    alpha = np.ones((5, 1))
    alpha[2:4] = alpha_scale
    return parent, c1, c2, alpha


@pytest.mark.parametrize(("alpha_scale", "refined"), [(OFF_LINE, [0, 1]), (0.5, [1])])
def test_children_on_no_line_are_what_they_are_after_two_steps(alpha_scale, refined):
    parent, c1, c2, alpha = pair(alpha_scale)
    split, refine = split_steps(1, np.array([0]), 1, parent, c1, c2, alpha)
    assert (split.kinds == Kind.SPLIT).all()
    np.testing.assert_array_equal(refine.slots, refined)
    tree = EvolutionTree(3, (Step.of_adds(0, parent.astype(np.float32)), split, refine))
    np.testing.assert_allclose(tree.leaves().channels(), np.hstack([c1, c2]), atol=1e-6)


@pytest.mark.parametrize("logit", [-7.0, 0.0, 3.0, 20.0])
def test_before_they_are_refined_pictures_are_those_of_the_parent(logit):
    parent, c1, c2, alpha = pair(OFF_LINE)
    parent[10] = logit
    split, refine = split_steps(1, np.array([0]), 1, parent, c1, c2, alpha)
    adds = Step.of_adds(0, parent.astype(np.float32))
    camera = orbit(1, (0.0, 0.0, 0.0), radius=4.0, width=64, height=64, fov_x=0.7)[0]
    before, between, after = (
        render(EvolutionTree(3, steps).leaves(), camera, (1.0, 1.0, 1.0))
        for steps in ((adds,), (adds, split), (adds, split, refine))
    )
    assert psnr(between, before) > 60
    assert psnr(after, before) < 25


def test_children_on_a_line_need_no_refine():
    parent, c1, _, alpha = pair(0.5)
    c2 = parent - 0.5 * (c1 - parent)
    (split,) = split_steps(1, np.array([0]), 1, parent, c1, c2, 0 * alpha + 0.5)
    np.testing.assert_allclose(split.psi, c1 - parent, rtol=1e-6)
