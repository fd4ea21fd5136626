"""A target, for a scene that may be encoded with a palette or without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import TargetMissedError, encode_scene, read_directory
from evogs_codec.encoding.sketch import Sketch
from evogs_codec.render import Views
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import choose
from evogs_codec.scene.found_stream import FoundStream

N = 400


def shared():
    """Splats of which many share their SH."""
    splats = make_scene(N)
    sh = splats.sh.copy()
    sh[:, 1:] = np.random.default_rng(0).normal(size=(8, 15, 3))[np.arange(N) % 8]
    return replace(splats, sh=sh)


def made(monkeypatch, sure):
    """Whether each tree that is encoded has a palette."""
    trees = []
    plainly = FoundStream.made

    def counted(one):
        if one.stream is None:
            trees.append(one.tree.palette is not None)
        return plainly(one)

    monkeypatch.setattr(choose, "SURE_OF_PSI", sure)
    monkeypatch.setattr(choose, "SURE_OF_PICKS", 1e9)
    monkeypatch.setattr(FoundStream, "made", counted)
    return trees


@pytest.mark.parametrize("target", [{"target_psnr": 36.0}, {"target_bytes": 9000}])
@pytest.mark.parametrize(("sure", "expected"), [(0.0, {True}), (1e9, {True, False})])
def test_both_are_tried_unless_an_estimate_is_sure(monkeypatch, target, sure, expected):
    trees = made(monkeypatch, sure)
    data = encode_scene(shared(), levels=2, up="z", effort=1, **target)
    assert set(trees) == expected
    assert len(data) <= target.get("target_bytes", 1e9)


@pytest.mark.usefixtures("any_views")
@pytest.mark.parametrize(
    ("target", "is_shared"),
    [
        ({"target_psnr": 36.0}, True),
        ({"target_psnr": 36.0}, False),
        ({"target_bytes": 9000}, True),
        ({"target_bytes": 30_000}, False),  # more than the tree with a palette has
    ],
)
def test_of_many_splats_a_sketch_chooses_and_views_are_drawn_once(monkeypatch, target, is_shared):
    trees = made(monkeypatch, 1e9)
    monkeypatch.setattr(choose, "MIN_GUESSED", 100)
    if "target_psnr" in target:
        told = {True: 0.0, False: 100.0 if is_shared else -100.0}
        monkeypatch.setattr(
            choose, "_fewness", lambda one, _: -told[one.prepared.task.tree.palette is not None]
        )
    weighed, plainly_drawn = [], Views.sensitivity

    def drawn(views, splats):
        weighed.append(len(splats))
        return plainly_drawn(views, splats)

    monkeypatch.setattr(Views, "sensitivity", drawn)
    encode_scene(shared(), levels=2, up="z", effort=1, **target)
    assert set(trees) == {is_shared}
    assert weighed.count(N) == 1


@pytest.mark.usefixtures("any_views")
def test_a_tree_that_cannot_meet_a_target_is_not_chosen(monkeypatch):
    trees = made(monkeypatch, 1e9)
    monkeypatch.setattr(choose, "MIN_GUESSED", 100)
    monkeypatch.setattr(
        Sketch, "psnr", lambda one, _: 0.0 if one.prepared.task.tree.palette else 99.0
    )
    data = encode_scene(shared(), levels=2, up="z", effort=1, target_bytes=9000)
    assert len(data) <= 9000  # the other tree has 9,684 at least
    assert set(trees) == {True}


@pytest.mark.thorough
def test_a_target_that_both_miss_is_refused_with_what_the_nearer_reaches(monkeypatch):
    trees = made(monkeypatch, 1e9)
    with pytest.raises(TargetMissedError) as with_either:
        encode_scene(shared(), levels=2, up="z", effort=1, target_bytes=700)
    assert trees == [True, False]
    with pytest.raises(TargetMissedError) as without:
        encode_scene(shared(), levels=2, up="z", effort=1, target_bytes=700, palette="never")
    assert with_either.value.by <= without.value.by


def test_the_stream_of_a_target_has_a_palette_where_that_pays():
    data = encode_scene(shared(), levels=2, up="z", effort=1, target_psnr=36.0)
    assert read_directory(data).has_palette
