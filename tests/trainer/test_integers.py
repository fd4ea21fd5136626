"""Trees in the integers of the codec: what they are, what training gains, what a stream has."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from evogs_codec import PRESETS as CODEC_PRESETS
from evogs_codec import Cut, EvolutionTree, InputError, decode, encode, read_directory
from evogs_codec.io.tree_npz import read_tree, write_tree
from evogs_codec.model.channels import GROUP_CHANNELS, channel_class, n_channels
from evogs_codec.model.tree import Kind
from evogs_codec.render import psnr, render
from reference_trainer.config import PRESETS, Integers
from reference_trainer.methods import quantised
from reference_trainer.methods.base import Done, Plan, Setting
from reference_trainer.methods.evogs import Evogs
from reference_trainer.models.backends import backend_for
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.densify import ScreenGradients
from reference_trainer.run import run
from reference_trainer.train import Stage, Training, train
from tests.trainer import tiny
from tests.trainer.plain_torch import evolve_plain

CPU = torch.device("cpu")

METHODS = ("evogs", "evogs-mixed", "evogs-sym", "evogs-a", "evogs-b")


def trained(method="evogs", integers=Integers(0.3), **changes):  # noqa: B008 - frozen
    return tiny.trained(method=method, integers=integers, **changes)


def quanta_of(tree, row):
    kinds = [channel_class(c) for c in range(n_channels(tree.sh_degree))]
    return np.array(tree.quanta[row])[kinds][:, None]


@pytest.mark.parametrize("method", METHODS)
def test_all_numbers_are_multiples_and_a_stream_holds_them(method):
    tree = trained(method)
    assert len(tree.quanta) == 1 + tree.n_levels
    for step in tree.steps:
        assert (step.adds % quanta_of(tree, 0) == 0).all()
        assert (step.psi % quanta_of(tree, 1 + step.level) == 0).all()
    assert sum(np.any(step.psi) for step in tree.steps)
    data = encode(tree)
    directory = read_directory(data)
    finest = np.min([quanta_of(tree, row) for row in range(len(tree.quanta))], axis=0)
    for level in range(tree.n_levels):
        right = tree.leaves(level).channels()
        found = decode(data, Cut.of_level(directory, level)).leaves(sh_degree=1).channels()
        right, found = (x[:, np.lexsort(np.round(x[:3], 2))] for x in (right, found))
        # A product of alpha is rounded to the grid, of which a quantum has 16 units at least.
        assert (np.abs(found - right) <= finest / 16).all()


def test_a_tree_keeps_its_quanta_in_a_file(tmp_path):
    tree = trained()
    write_tree(tmp_path / "a.tree.npz", tree)
    assert read_tree(tmp_path / "a.tree.npz").quanta == tree.quanta


def test_without_integers_nothing_is_rounded():
    tree, rounded = trained(integers=Integers()), trained()
    assert tree.quanta == ()
    psi = np.concatenate([step.psi for step in tree.steps], axis=1)
    assert (psi % quanta_of(rounded, 2) != 0).mean() > 0.5


@pytest.mark.parametrize("iterations", [(3, 40), (40, 3), (1, 1)])
def test_every_level_has_both_stages_however_short(iterations):
    tree = trained(iterations=iterations, integers=Integers(0.15))
    assert [step.level for step in tree.steps][-1] == 1
    assert len(tree.quanta) == 3


@pytest.mark.parametrize("part", [0, 0.3])
def test_a_last_level_may_lose_all_its_splats_but_no_other(part):
    growth = replace(tiny.config().frontier, prune_opacity=0.9999)
    tree = trained(integers=Integers(part), frontier=growth)
    assert (tree.n_levels, tree.n_leaves) == (2, 0)
    data = encode(tree, None if tree.quanta else CODEC_PRESETS["trained"])
    assert decode(data, verify=True).n_leaves == 0
    config = tiny.config(
        iterations=(40,) * 3,
        max_splats=(30, 60, 120),
        integers=Integers(part),
        frontier=growth,
    )
    with pytest.raises(InputError, match="level 1 ended without a splat"):
        run(config, tiny.pyramid(3), backend_for("cpu"))


def test_a_base_in_integers_keeps_them():
    config = tiny.config(integers=Integers(0.3))
    base = trained(integers=Integers(0.3, distortion=1e-3))
    tree = run(config, tiny.pyramid(), backend_for("cpu"), base=base)
    assert tree.quanta[:2] == base.quanta[:2]
    assert tree.quanta[2] != base.quanta[2]
    np.testing.assert_array_equal(tree.steps[0].adds, base.steps[0].adds)


def test_integers_of_finished_levels_are_found_again():
    """By the codec, when it rounds the next level: else that would correct what is not wrong."""
    config = tiny.config(
        iterations=(40, 40, 40), max_splats=(30, 60, 120), integers=Integers(0.3, distortion=1e-3)
    )
    tree = run(config, tiny.pyramid(3), backend_for("cpu"))
    done = Done(1, tree.steps, quanta=tree.quanta[:3])
    data = tiny.pyramid(3)[2]
    plan = Plan(2, 2, 10, 120, in_integers=True)
    path = CameraPath.of([view.camera for view in data.train])
    setting = Setting(config, plan, data, path, backend_for("cpu").device)
    coded, _ = quantised._coded(setting, done)
    found = quantised._in_floats(coded, done.steps)
    n_alphas = 0
    for before, after in zip(tree.steps, found, strict=True):
        if before.level == 2:
            continue
        np.testing.assert_array_equal(after.adds, before.adds)
        np.testing.assert_array_equal(after.psi, before.psi)
        splits = before.psi[:, before.kinds[before.kinds != Kind.DROP] == Kind.SPLIT]
        for group, channels in enumerate(GROUP_CHANNELS):
            matters = splits[channels].any(axis=0)  # else any alpha will do
            alphas = after.alpha[group, matters], before.alpha[group, matters]
            np.testing.assert_array_equal(*alphas)
            n_alphas += int(matters.sum())
    assert n_alphas > 50


def test_torch_draws_the_leaves_that_compiled_loops_draw():
    model, _ = begun(trained(integers=Integers()), distortion=1e-3)
    blocks = [columns.block for columns in model._columns]
    compiled = model.splats(0)
    plain = evolve_plain(model._base, blocks, np.flatnonzero(model._live))
    for a, b in zip(compiled, plain, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-6)


FINE = (2.0**-12,) * 6


def begun(tree, distortion):
    """The last level of a tree, rounded: what is trained, and its pictures."""
    level = tree.n_levels - 1
    config, data = tiny.config(integers=Integers(0.5, distortion=distortion)), tiny.pyramid()[1]
    plan = Plan(level, 1, 60, 100, in_integers=True)
    setting = Setting(
        config,
        plan,
        data,
        CameraPath.of([view.camera for view in data.train]),
        backend_for("cpu").device,
    )
    done = Done(tree.sh_degree, tree.steps, quanta=(FINE,) * (1 + level))
    return Evogs("D").begin(setting, done), data


def quality(splats, data):
    drawn = [(render(splats, v.camera, data.background), v.image) for v in data.train]
    return float(np.mean([psnr(picture, image) for picture, image in drawn]))


def test_training_corrects_what_rounding_lost():
    tree = trained(integers=Integers())
    model, data = begun(tree, distortion=0.02)
    before, rates = model.splats(0).params(), Integers(0.5).rates(PRESETS["quick"].rates)
    stage = Stage(data.train, data.background, 1.0, 600, 100, (0,), rates)
    training = Training(model, ScreenGradients(model.n_splats, CPU))
    train(training, stage, tiny.config(), backend_for("cpu"), lambda _: None)
    after = EvolutionTree(1, (*tree.steps[:1], *model.finished())).leaves()
    lost = quality(tree.leaves(), data) - quality(before, data)
    assert lost > 0.1
    assert quality(after, data) > quality(before, data) + 0.5 * lost


def test_more_distortion_makes_smaller_streams():
    streams = [encode(trained(integers=Integers(0.3, distortion=x))) for x in (0.001, 0.06, 1.0)]
    sizes = [len(data) for data in streams]
    assert sizes[0] > 1.2 * sizes[1]
    assert sizes[0] > 1.2 * 1.2 * sizes[2]
    # Half of the bytes and more are no numbers. Processors differ in a byte or two of the rest.
    numbers = [int(read_directory(data).packets["size"].sum()) for data in streams]
    assert numbers[0] > 1.4 * numbers[1]
    assert numbers[1] > 1.25 * numbers[2]


def test_zeros_stay_and_the_others_move():
    model, _ = begun(trained(integers=Integers()), distortion=0.5)
    for variable in model.variables():
        variable.value.detach().add_(10.0)
    before, after = (
        np.concatenate([step.psi for step in steps], axis=1)
        for steps in (model.steps, model.finished())
    )
    assert 0 < np.count_nonzero(before) < before.size
    assert ((after != before) == (before != 0)).all()


def test_steps_with_drops_and_refines_are_the_same_in_blocks():
    growth = replace(tiny.config().frontier, prune_opacity=0.1, refines_rest=True)
    tree = trained(integers=Integers(), frontier=growth)
    records = np.concatenate([step.kinds for step in tree.steps])
    assert set(Kind) - {Kind.ADD} == {Kind(kind) for kind in records}
    model, _ = begun(tree, distortion=1e-6)
    right, found = tree.leaves().channels(), model.splats(0).params().channels()
    again = EvolutionTree(1, (*tree.steps[:1], *model.finished())).leaves().channels()
    assert found.shape == again.shape == right.shape
    for x in (found, again):
        gaps = np.abs(x[:, :, None] - right[:, None]).max(0)
        assert gaps.min(1).max() < 0.02
        assert len(set(gaps.argmin(1))) == len(right.T)
