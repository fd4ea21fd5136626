"""Level 1 of a mixed tree is tried with refines before its splits and without."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import EvolutionTree, encode
from evogs_codec.model.tree import Kind
from evogs_codec.render import render
from reference_trainer.config import PRESETS, Integers
from reference_trainer.methods import method_named, refines_first
from reference_trainer.models.backends import backend_for
from reference_trainer.run import run
from reference_trainer.runtime.progress import Progress
from tests.trainer import tiny
from tests.trainer.stopping import StoppedError, StopsAt

LEVELS = {"iterations": (40, 40, 40), "max_splats": (20, 40, 60)}


def config(refines=None, *, all_alphas=False, **changes):
    changes = {"integers": Integers(0.3)} | changes
    found = tiny.config(method="evogs-mixed", rates=PRESETS["quick"].rates, **changes)
    frontier = replace(found.frontier, refines_first=refines, all_alphas=all_alphas)
    return replace(found, frontier=frontier)


def tree_of(*arguments, folder=None, progress=None, **changes):
    own = config(*arguments, **changes)
    scales = tiny.pyramid(own.n_levels)
    cpu = backend_for("cpu")
    return run(own, scales, cpu, folder=folder, resume=bool(folder), progress=progress)


def assert_same(tree, other):
    assert tree.quanta == other.quanta
    for a, b in zip(tree.steps, other.steps, strict=True):
        assert a.level == b.level
        for name in ("slots", "kinds", "psi", "alpha", "adds"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def answers(monkeypatch, *errors):
    """The pictures of the two attempts have these errors."""
    left = list(errors)
    monkeypatch.setattr(refines_first, "_error", lambda setting, done: left.pop(0))


def test_a_level_is_tried_in_integers_and_where_there_is_one():
    def names(own):
        plans = method_named(own.method).plans(own)
        return [(plan.level, plan.in_integers, plan.without_refines) for plan in plans]

    tried = names(config(**LEVELS))
    twice = [(1, False, True), (1, True, True)]
    assert tried[2:6] == [(1, False, False), (1, True, False), *twice]
    for other in (
        config(True, **LEVELS),
        config(False, **LEVELS),
        replace(config(**LEVELS), method="evogs"),
        replace(config(**LEVELS), integers=Integers()),
        config(iterations=(40,), max_splats=(20,)),
    ):
        assert not any(again for *_, again in names(other))
    assert len(tried) == 8


def test_presets_try_it():
    for name in ("two-cores", "quick"):
        assert PRESETS[name].frontier.refines_first is None
        assert PRESETS[name].as_published().frontier.refines_first is None


@pytest.mark.parametrize("kept", [True, False])
def test_all_levels_are_made_as_the_attempt_that_is_kept(monkeypatch, capsys, kept):
    answers(monkeypatch, *((0.1, 0.2) if kept else (0.2, 0.1)))
    tree = tree_of(progress=Progress(shows_bar=True), **LEVELS)
    said = capsys.readouterr().err
    assert "refines before splits save" in said
    assert ("all levels have them" if kept else "no level has them") in said
    assert_same(tree, tree_of(kept, all_alphas=not kept, **LEVELS))


@pytest.mark.parametrize(("without", "kept"), [(1040, False), (1060, True)])
def test_of_as_good_pictures_refines_have_to_save_a_twentieth_of_the_level(
    monkeypatch, without, kept
):
    answers(monkeypatch, 0.1, 0.1)

    def sized(tree):
        if tree.n_levels == 1:
            return bytes(500)
        return bytes(1500 if has_refines(tree) else without + 500)

    monkeypatch.setattr(refines_first, "encode", sized)
    assert has_refines(tree_of()) == kept


def has_refines(tree):
    return any((step.kinds == Kind.REFINE).any() for step in tree.steps)


@pytest.mark.parametrize("distortion", [0.01, 0.3])
def test_what_refines_save_is_bits_and_what_errors_are_worth(monkeypatch, distortion):
    seen = []
    better = refines_first.better

    def looked_at(setting, done):
        found = better(setting, done)
        seen.append((done.rival, done, found))
        return found

    monkeypatch.setattr("reference_trainer.methods.evogs.better", looked_at)
    progress = Progress()
    tree_of(progress=progress, integers=Integers(0.3, distortion=distortion))
    ((first, second, found),) = seen
    data = tiny.pyramid()[1]
    errors = [
        np.mean(
            [
                np.square(render(a.tree.leaves(), v.camera, data.background).clip(0, 1) - v.image)
                for v in data.train
            ]
        )
        for a in (first, second)
    ]
    n = sum(step.psi.size for step in first.steps if step.level)
    price = max(distortion, 0.07) * errors[0] / n
    roots = EvolutionTree(1, first.steps[:1], first.quanta[:2])
    bits = [8 * len(encode(tree)) for tree in (first.tree, second.tree, roots)]
    saved = bits[1] - bits[0] + (errors[1] - errors[0]) / price
    assert found.refines_save == pytest.approx(saved / (bits[0] - bits[2]), rel=1e-4)
    assert found.rival is None
    assert progress.refines_save is not None
    assert found.steps is (first if progress.refines_save > 0.05 else second).steps
    assert progress.refines_save == found.refines_save


def test_refines_stay_where_without_them_nothing_is_left_of_the_level():
    tree = tree_of(max_splats=(30, 10))
    assert {step.level for step in tree.steps} == {0, 1}
    assert has_refines(tree)


@pytest.fixture(scope="module")
def whole():
    return tree_of(**LEVELS)


@pytest.mark.parametrize("n", [110, 150])
def test_a_run_that_was_stopped_in_a_second_attempt_goes_on_to_the_same_tree(tmp_path, whole, n):
    with pytest.raises(StoppedError):
        tree_of(folder=tmp_path, progress=StopsAt(n), **LEVELS)
    assert_same(tree_of(folder=tmp_path, **LEVELS), whole)
