"""Mixed trees: parents are refined before they are split, and numbers pay for their bits."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from evogs_codec import decode, encode
from evogs_codec.model.tree import Kind
from reference_trainer.config import PRESETS, Integers, Rates
from reference_trainer.methods.base import Done, Plan, Setting
from reference_trainer.methods.evogs import Evogs
from reference_trainer.models import adam
from reference_trainer.models.adam import (
    FREE_STEPS,
    GROUPS,
    RateTable,
    Variable,
    _shrink,
    step_together,
)
from reference_trainer.models.backends import backend_for
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.densify import ScreenGradients
from reference_trainer.models.kernels import shrink
from reference_trainer.run import run
from tests.trainer import tiny

CPU = torch.device("cpu")

QUANTA = np.array([0.1, 0.02], np.float32)


def trained(method="evogs-mixed", *, iterations=(40, 40), **integers):
    """With rates that move numbers in so few iterations."""
    config = tiny.config(
        method=method,
        iterations=iterations,
        integers=Integers(0.3, **integers),
        rates=PRESETS["quick"].rates,
    )
    return run(config, tiny.pyramid(), backend_for("cpu"))


@pytest.fixture
def soon(monkeypatch):
    """Bits cost something from the start of these short runs."""
    monkeypatch.setattr(adam, "FREE_STEPS", 3)


def pulled(x, v, price, *, rate=0.01, t=5):
    out = np.array(x, np.float32)
    rates = np.full(out.shape[1], rate, np.float32)
    v = np.broadcast_to(np.array(v, np.float32), out.shape).copy()
    shrink(out, v, rates, QUANTA, price, 0.999, 1e-15, t)
    return out


def test_a_pull_is_the_slope_of_the_bits_as_adam_would_step():
    x, t = np.array([[0.5, -0.3]], np.float32), 7
    v = np.float32(0.04)
    found = pulled(x, v, 0.01, t=t)
    root = np.sqrt(0.04 / (1 - 0.999**t))
    slope = 0.01 / np.log(2) / (np.abs(x) + QUANTA)
    right = np.sign(x) * (np.abs(x) - 0.01 * slope / root)
    np.testing.assert_allclose(found, right, rtol=1e-5)


def test_nothing_is_pulled_past_zero_and_what_no_view_shows_goes_at_once():
    x = np.array([[0.5, -0.3], [1e-6, -1e-6]], np.float32)
    assert (pulled(x, [[1.0], [1.0]], 1e3) == 0).all()
    assert (pulled(x, 0.0, 1e-9) == 0).all()
    np.testing.assert_array_equal(pulled(x, 1.0, 0.0), x)


def test_torch_pulls_as_compiled_loops_do():
    rng = np.random.default_rng(0)
    value = rng.normal(0, 0.1, (50, 2)).astype(np.float32)
    v = rng.uniform(0, 0.1, (50, 2)).astype(np.float32)
    rates = np.array([0.01, 0.02], np.float32)
    compiled = value.copy()
    shrink(compiled, v, rates, QUANTA, 0.005, 0.999, 1e-15, 3)
    x, root = torch.from_numpy(value.copy()), torch.sqrt(torch.from_numpy(v) / (1 - 0.999**3))
    row, quanta = torch.from_numpy(rates / rates.max()), torch.from_numpy(QUANTA)
    _shrink([x], [root + 1e-15], [row], [quanta], [0.005 * float(rates.max())])
    assert (compiled == 0).any()
    np.testing.assert_allclose(x.numpy(), compiled, rtol=1e-5, atol=1e-8)


def test_torch_steps_as_compiled_loops_do():
    """Six variables at once, that began at different steps, one of them with a rate of 0."""
    rng = np.random.default_rng(1)
    widths = {"position": (3,), "rotation": (4,), "scale": (3,), "sh": (4, 3), "alpha": (5,)}
    shapes = {group: (50, *widths.get(group, ())) for group in (*GROUPS, "alpha")}
    values = {
        group: rng.normal(0, 0.1, shape).astype(np.float32) for group, shape in shapes.items()
    }
    rates = replace(Rates(), alpha=0.0)

    def begun():
        found = []
        for i, (group, value) in enumerate(values.items()):
            variable = Variable.of(torch.from_numpy(value.copy()), group)
            variable.t = 20 * i
            variable.quanta = np.full(int(np.prod(value.shape[1:])), 0.01 * (i + 1), np.float32)
            variable.n_still = int(group == "rotation")
            found.append(variable)
        return found

    def one_by_one(variables, table):
        for variable in variables:
            variable.step(table)

    stepped = []
    for step in (one_by_one, step_together):
        draw, variables = np.random.default_rng(2), begun()
        for i in range(FREE_STEPS + 5):
            for variable in variables:
                gradient = draw.normal(0, 0.1, variable.value.shape) * (i != 3)
                variable.value.grad = torch.from_numpy(gradient.astype(np.float32))
            step(variables, RateTable(rates, 2.0, i / 200, 0.01))
        assert all(variable.value.grad is None for variable in variables)
        stepped.append(variables)
    for one, other in zip(*stepped, strict=True):
        moved = one.value.detach().numpy() != values[one.group]
        assert moved.any() == (one.group != "alpha")
        torch.testing.assert_close(other.value, one.value, rtol=1e-4, atol=1e-5)


def test_a_variable_without_quanta_costs_nothing_nor_does_a_new_one():
    def stepped(quanta, price, t=FREE_STEPS):
        variable = Variable.of(torch.ones(4, 2), "scale")
        variable.quanta, variable.t = quanta, t
        variable.value.grad = torch.full((4, 2), 0.1)
        variable.step(RateTable(Rates(), 1.0, 0.0, price))
        return variable.value.detach().numpy()

    np.testing.assert_array_equal(stepped(None, 1.0), stepped(QUANTA, 0.0))
    assert (stepped(QUANTA, 0.01) < stepped(None, 0.01)).all()
    np.testing.assert_array_equal(*(stepped(q, 0.01, FREE_STEPS - 1) for q in (QUANTA, None)))


def test_every_leaf_of_the_level_before_is_refined_before_it_is_split():
    tree = tiny.trained(method="evogs-mixed")
    steps = [step for step in tree.steps if step.level == 1]
    drops, first, *others = steps if (steps[0].kinds == Kind.DROP).all() else (None, *steps)
    assert (first.kinds == Kind.REFINE).all()
    dropped = 0 if drops is None else len(drops.slots)
    assert len(first.slots) + dropped == len(tree.leaves(0))
    splits = np.concatenate([step.slots[step.kinds == Kind.SPLIT] for step in others])
    assert np.isin(first.slots, splits).any()
    assert first.psi.any()


@pytest.mark.parametrize("all_alphas", [False, True])
def test_only_sizes_and_opacities_have_a_factor_of_their_own_unless_all_have(all_alphas):
    growth = replace(tiny.config().frontier, all_alphas=all_alphas)
    tree = tiny.trained(method="evogs-mixed", frontier=growth)
    alpha = np.concatenate([step.alpha for step in tree.steps], axis=1)
    assert (alpha[[0, 1, 4]] != 1).any(axis=1).all() == all_alphas
    assert (alpha[[0, 1, 4]] == 1).all() != all_alphas
    assert (alpha[2:4] != -1).any(axis=1).all()


def test_thrift_makes_zeros_and_smaller_streams(soon):
    iterations = (40, 120)
    trees = [
        trained(iterations=iterations, distortion=0.01, thrift=thrift) for thrift in (0.0, 100.0)
    ]
    sizes = [len(encode(tree)) for tree in trees]
    zeros = [
        np.mean(np.concatenate([step.psi.ravel() for step in tree.steps if step.level]) == 0)
        for tree in trees
    ]
    assert sizes[1] < 0.9 * sizes[0]
    assert zeros[1] > zeros[0] + 0.3


def test_refines_that_change_nothing_are_not_kept(soon):
    config = tiny.config(
        method="evogs-mixed",
        integers=Integers(0.3, distortion=2.0, thrift=100.0),
        rates=PRESETS["quick"].rates,
    )
    floats = run(replace(config, integers=Integers()), tiny.pyramid(), backend_for("cpu"))
    tree = run(config, tiny.pyramid(), backend_for("cpu"))
    counts = []
    for found in (floats, tree):
        steps = [step for step in found.steps if step.level]
        kinds = np.concatenate([step.kinds for step in steps])
        counts.append(np.count_nonzero(kinds == Kind.REFINE))
    for step in (step for step in tree.steps if step.level):
        kinds = step.kinds[step.kinds != Kind.DROP]
        assert step.psi[:, kinds == Kind.REFINE].any(axis=0).all()
    assert counts[1] < counts[0]
    assert len(decode(encode(tree)).leaves()) == tree.n_leaves


def test_other_trees_know_no_thrift(soon):
    one, other = (trained("evogs", thrift=thrift) for thrift in (0.0, 10.0))
    for a, b in zip(one.steps, other.steps, strict=True):
        np.testing.assert_array_equal(a.psi, b.psi)


@pytest.mark.parametrize("option", ["D", "M"])
def test_only_what_a_mixed_tree_refines_and_splits_has_quanta(option):
    tree = trained()
    config, data = tiny.config(integers=Integers(0.3)), tiny.pyramid()[1]
    path = CameraPath.of([view.camera for view in data.train])
    setting = Setting(config, Plan(1, 1, 40, 70), data, path, backend_for("cpu").device)
    done = Done(1, tree.steps[:1], quanta=tree.quanta[:2])
    model = Evogs(option).begin(setting, done)
    for iteration in range(1, 41):
        gradients = ScreenGradients(model.n_splats, CPU)
        gradients.total += 1.0
        gradients.count += 1
        model.densify(iteration, 40, gradients, 70)
    groups = {v.group: v.quanta for v in model.variables()}
    assert groups["alpha"] is None
    assert (groups["sh"] is not None) == (option == "M")


@pytest.mark.parametrize("thrift", [-1, 101, float("nan")])
def test_thrift_has_bounds(thrift):
    with pytest.raises(ValueError, match="thrift is"):
        replace(Integers(), thrift=thrift)
