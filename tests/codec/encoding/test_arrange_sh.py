"""Records of a tree in integers that leave SH as they are form steps of their own."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import EvolutionTree, decode, encode
from evogs_codec.encoding.arrange import arrange
from evogs_codec.model.channels import N_CORE, n_channels
from evogs_codec.model.tree import Step

QUANTUM = 2.0**-6
DEGREE = 2


def tree_of(n, part, *, rounded=True, seed=0):
    """Roots (n,), all of them refined; `part` of the refines leave SH above band 0."""
    rng = np.random.default_rng(seed)
    d = n_channels(DEGREE)
    adds, psi = (np.rint(rng.normal(0, 8, (d, n))) for _ in range(2))
    adds[3] = 64  # no rotation is 0
    psi[N_CORE:] = np.rint(rng.laplace(0, 0.8, (d - N_CORE, n)))
    psi[N_CORE:, rng.permutation(n)[: round(part * n)]] = 0
    steps = (
        Step.of_adds(0, (QUANTUM * adds).astype(np.float32)),
        Step.of_refines(1, np.arange(n), (QUANTUM * psi).astype(np.float32)),
    )
    quanta = ((QUANTUM,) * (5 + DEGREE),) * 3 if rounded else ()
    return EvolutionTree(DEGREE, steps, quanta)


def refines(tree):
    (tile,) = arrange(tree, 1)
    return [step for step in tile.steps if len(step.slots)]


@pytest.mark.parametrize("part", [0.3, 0.7])
def test_records_that_leave_sh_come_after_those_that_change_them(part):
    idle = [~step.psi[N_CORE:].any(axis=0) for step in refines(tree_of(4000, part))]
    assert all(x.all() or not x.any() for x in idle)
    assert [bool(x[0]) for x in idle] == sorted(bool(x[0]) for x in idle)
    assert {bool(x[0]) for x in idle} == {False, True}


@pytest.mark.parametrize(
    "tree",
    [tree_of(4000, 0.05), tree_of(700, 0.5), tree_of(4000, 1.0), tree_of(4000, 0.5, rounded=False)],
)
def test_nothing_is_set_apart_that_saves_little_or_is_not_rounded(tree):
    found, right = (refines(x) for x in (tree, replace(tree, quanta=())))
    for one, other in zip(found, right, strict=True):
        np.testing.assert_array_equal(one.slots, other.slots)
        np.testing.assert_array_equal(one.psi, other.psi)


def test_it_makes_streams_smaller_and_keeps_the_splats(monkeypatch):
    tree = tree_of(6000, 0.5)
    data = encode(tree)
    monkeypatch.setattr("evogs_codec.encoding.arrange._by_sh", lambda step, rows, n: [(rows, n)])
    assert len(data) < 0.99 * len(encode(tree))
    found, right = (leaves.channels() for leaves in (decode(data).leaves(), tree.leaves()))
    found, right = (x[:, np.lexsort(x[:14])] for x in (found, right))
    np.testing.assert_array_equal(found, right)
