"""`evogs lift --refine`: coarse levels gain, the last one stays, and nothing is left to chance."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec import EvolutionTree, SplatParams, lift, write_ply
from evogs_codec.cli import commands
from evogs_codec.io.tree_npz import write_tree
from evogs_codec.lifting.parents import OFF_LINE
from evogs_codec.lifting.splitting import alpha_of
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render import cameras_around, orbit, save_cameras
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from reference_trainer.distil import refining
from reference_trainer.distil.coarse_levels import distil
from reference_trainer.distil.generations import levels_of, tree_of

SIZE = 48
SCALE = GROUP_CHANNELS[2]


@cache
def lifted() -> EvolutionTree:
    return lift(make_scene(600), 3)


def cameras(n=8, elevation=0.2):
    return cameras_around(lifted().leaves(), "z", SIZE, n=n, elevation=elevation)


@cache
def distilled():
    return distil(lifted(), cameras(), cameras(3, 0.5), iterations=40)


def arrays(tree):
    return [
        array
        for step in tree.steps
        for array in (step.slots, step.kinds, step.psi, step.alpha, step.adds)
    ]


def test_the_last_level_is_that_of_the_lifted_tree():
    before, after = lifted().leaves(), distilled().tree.leaves()
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        old, new = getattr(before, name), getattr(after, name)
        tolerance = 16 * 2.0**-23 * max(float(np.abs(old).max()), 1.0)
        np.testing.assert_allclose(new, old, rtol=0, atol=tolerance, err_msg=name)


def test_coarse_levels_gain_in_views_that_were_not_descended_on():
    views = Views(lifted().leaves(), cameras(5, 0.35))
    for level in range(2):
        gain = views.psnr(distilled().tree.leaves(level)) - views.psnr(lifted().leaves(level))
        assert gain > 1, level


def test_levels_have_as_many_splats_as_before():
    for level in range(3):
        assert len(distilled().tree.leaves(level)) == len(lifted().leaves(level))


def test_a_tenth_of_the_pairs_is_corrected_that_lifting_has_not_corrected():
    steps = distilled().tree.steps
    splits = [step for step in steps[1:] if (step.kinds == Kind.SPLIT).all()]
    refines = [step for step in steps[1:] if (step.kinds == Kind.REFINE).all()]
    for split, refine in zip(splits, refines, strict=True):
        n = len(split.slots)
        n_corrected = np.count_nonzero(split.alpha[2] == OFF_LINE)
        assert n / 10 - 1 < n_corrected < n / 4
        n_hidden = np.count_nonzero((alpha_of(split)[2:4] == OFF_LINE).all(axis=0))
        assert len(refine.slots) == n_corrected + n_hidden  # C2, and C1 where it was hidden
        assert refine.psi[SCALE].any(axis=0).all()
        if not n_hidden:
            assert not refine.psi[10:].any()


def test_distilling_again_gives_the_same_numbers():
    again = distil(lifted(), cameras(), cameras(3, 0.5), iterations=40)
    assert again.changes == distilled().changes
    for one, other in zip(arrays(again.tree), arrays(distilled().tree), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_level_that_does_not_gain_keeps_its_parents():
    away = orbit(1, (0.0, 0.0, 1e6), radius=1.0, width=8, height=8, fov_x=0.5)
    kept = distil(lifted(), cameras(), away, iterations=2)
    assert all(change.found == change.before for change in kept.changes)
    for level in range(3):
        old, new = lifted().leaves(level).channels(), kept.tree.leaves(level).channels()
        np.testing.assert_allclose(new, old, rtol=0, atol=1e-4)


@pytest.mark.parametrize("gains", [(True, False), (False, True)])
def test_a_level_may_gain_beside_one_that_does_not(gains, monkeypatch):
    of_levels = iter([float(x) for gain in reversed(gains) for x in (not gain, gain)])
    monkeypatch.setattr(Views, "psnr", lambda *_: next(of_levels))
    mixed = distil(lifted(), cameras(), cameras(1), iterations=4)
    assert tuple(change.gains for change in mixed.changes) == gains
    before, after = lifted().leaves().channels(), mixed.tree.leaves().channels()
    np.testing.assert_allclose(after, before, rtol=1e-5, atol=1e-5)
    slots = levels_of(lifted())[1][gains.index(False)].slots
    old, new = (tree.leaves(gains.index(False)).channels() for tree in (lifted(), mixed.tree))
    np.testing.assert_allclose(new[:, slots], old[:, slots], rtol=1e-5, atol=1e-5)


def test_parents_on_no_line_are_exact_by_refines_of_their_second_children():
    levels, generations = levels_of(lifted())
    moved = [level.copy() for level in levels]
    parents = generations[1].slots
    moved[1][:10, parents] += np.random.default_rng(0).normal(0, 0.1, (10, len(parents)))
    moved[0] = generations[0].coarser(moved[1], levels[0][:, generations[0].slots])
    tree = tree_of(3, moved, generations)
    for level in range(3):
        found = tree.leaves(level).channels()
        np.testing.assert_allclose(found, moved[level], rtol=1e-5, atol=1e-5)


def test_a_lifted_tree_is_its_levels_and_the_splits_between_them():
    again = tree_of(3, *levels_of(lifted()))
    assert [len(step.slots) for step in again.steps] == [len(s.slots) for s in lifted().steps]
    np.testing.assert_allclose(
        again.leaves().channels(), lifted().leaves().channels(), rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_splats_are_distilled(n):
    tree = lift(make_scene(600).take(np.arange(n)), 3)
    found = distil(tree, cameras(2), cameras(1), iterations=2).tree
    np.testing.assert_allclose(
        found.leaves().channels(), tree.leaves().channels(), rtol=1e-5, atol=1e-5
    )


def test_a_tree_of_one_level_has_nothing_to_distil():
    tree = lift(make_scene(50), 1)
    assert distil(tree, cameras(2), cameras(1), iterations=2).tree is tree


@pytest.mark.parametrize(
    ("views", "held_out", "iterations", "message"),
    [(0, 1, 4, "no cameras"), (1, 0, 4, "none is held out"), (1, 1, 1, "at least 2")],
)
def test_what_cannot_be_distilled_is_refused(views, held_out, iterations, message):
    with pytest.raises(ValueError, match=message):
        distil(lifted(), cameras(8)[:views], cameras(8)[:held_out], iterations=iterations)


def test_a_tree_that_is_not_lifted_is_refused():
    splats = make_scene(20)
    adds = Step.of_adds(0, splats.channels())
    refines = Step.of_refines(1, np.arange(2), np.zeros((59, 2)))
    for more in (Step.of_adds(1, adds.adds), refines):
        with pytest.raises(ValueError, match="begins with splits"):
            levels_of(EvolutionTree(3, (adds, more)))
    split = Step.of_splits(1, np.arange(2), np.zeros((59, 2)), np.ones((5, 2)))
    with pytest.raises(ValueError, match="refines"):
        levels_of(EvolutionTree(3, (adds, split, split)))


def test_without_numba_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(refining, "find_spec", lambda *_: None)
    with pytest.raises(Exception, match=r"pip install -e .*render"):
        refining.refine(lifted(), None, "z", 2, lambda *_: None)


def test_refining_says_what_became_of_each_level(capsys, monkeypatch):
    monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", SIZE)
    monkeypatch.setattr("evogs_codec.render.viewpoints.RINGS", ((5, 0.2, 2.0),))
    parts: list[float] = []
    tree = refining.refine(lifted(), None, "z", 4, lambda _, part: parts.append(part))
    assert parts == sorted(parts)
    assert len(parts) == 9
    assert parts[-1] == 1
    assert capsys.readouterr().err.count("evogs: level ") == 2
    assert tree.n_leaves == 600


def test_a_scene_without_splats_is_left_alone():
    empty = SplatParams.from_channels(np.zeros((14, 0)))
    tree = lift(empty, 3)
    assert refining.refine(tree, None, "z", 2, lambda *_: None) is tree


def evogs(monkeypatch, *arguments, refiners=()):
    """The exit code of a command, where these refiners are installed."""

    def entries(group):
        return [SimpleNamespace(load=lambda r=r: r) for r in refiners if group == "evogs.refiners"]

    monkeypatch.setattr("evogs_codec.cli.encode_and_lift.entry_points", entries)
    return commands.main([str(argument) for argument in arguments])


@pytest.mark.parametrize("command", ["lift", "encode"])
def test_a_scene_is_refined_as_it_is_lifted(command, tmp_path, monkeypatch):
    scene = tmp_path / "scene.ply"
    write_ply(scene, make_scene(100))
    asked = []

    def refiner(tree, camera, up, iterations, progress):
        asked.append((tree.n_levels, camera, up, iterations))
        progress("refine", 1.0)
        return tree

    for k, flags in enumerate((["--refine"], ["--refine", "5", "--up=-y", "--levels", "2"])):
        out = tmp_path / f"out{k}"
        assert evogs(monkeypatch, command, scene, out, *flags, refiners=[refiner]) == 0
        assert out.exists()
    assert asked == [(5, None, (0.0, 0.0, 1.0), 200), (2, None, (0.0, -1.0, 0.0), 5)]


def test_refining_is_refused_where_it_cannot_be_done(tmp_path, monkeypatch, capsys):
    scene, tree, out = tmp_path / "scene.ply", tmp_path / "a.tree.npz", tmp_path / "out.evogs"
    write_ply(scene, make_scene(20))
    write_tree(tree, lift(make_scene(20), 2))
    assert evogs(monkeypatch, "encode", scene, out, "--refine") == 1
    assert ".[render]" in capsys.readouterr().err
    assert evogs(monkeypatch, "encode", tree, out, "--refine", refiners=[refining.refine]) == 1
    assert "for .ply scenes" in capsys.readouterr().err
    save_cameras(tmp_path / "one.json", cameras(1))
    flags = ["--refine", "2", "--camera", tmp_path / "one.json"]
    assert evogs(monkeypatch, "encode", scene, out, *flags, refiners=[refining.refine]) == 1
    assert "1 cameras, expected at least 2" in capsys.readouterr().err
    assert not out.exists()
