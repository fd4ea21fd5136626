"""The PSNR of each level in the metadata: what it is, when it is there, and that parts keep it."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec import (
    Cut,
    LevelPsnr,
    SceneInfo,
    choose_cut,
    decode,
    encode_scene,
    encode_tree,
    extract,
    level_psnr,
    lift,
    read_directory,
    read_ply,
)
from evogs_codec.editing.level_psnr import KEY, with_level_psnr
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import measure
from evogs_codec.scene.falls.packet_falls import FIRST_VIEWS_EVERY
from evogs_codec.scene.falls.states import N_JUDGING_FIRST
from evogs_codec.scene.measure import N_VIEWS, PIXELS, Gauge
from evogs_codec.scene.request import Request


@cache
def stream():
    """300 splats in 3 levels and a layer, over 3 small views."""
    splats = make_scene(300)
    cameras = cameras_around(splats, "z", 48)[::8]
    return splats, cameras, encode_scene(splats, levels=3, cameras=cameras, effort=1)


def known_of(data):
    """What a stream says, which says something."""
    known = level_psnr(read_directory(data))
    assert known is not None
    return known


def test_each_number_is_the_psnr_of_its_level():
    splats, cameras, data = stream()
    known = known_of(data)
    assert known.views == "3 of the 3 cameras given, 200 pixels"
    views = Views(lift(splats, 3).leaves(), cameras)
    directory = read_directory(data)
    right = [
        views.psnr(decode(data, Cut.of_level(directory, level)).leaves(sh_degree=3))
        for level in range(directory.n_levels)
    ]
    assert len(right) == 4
    assert known.decibels == tuple(round(one, 2) for one in right)


def test_it_is_the_same_every_time():
    splats, cameras, data = stream()
    assert encode_scene(splats, levels=3, cameras=cameras, effort=1) == data


def test_without_cameras_views_on_a_circle_are_measured(monkeypatch):
    monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 40)
    known = known_of(encode_scene(make_scene(60), levels=2, effort=1))
    assert known.views == f"{N_VIEWS} views on a circle, {PIXELS} pixels"
    assert len(known.decibels) == 3


def test_of_many_cameras_a_few_are_measured_and_large_views_are_made_small(monkeypatch):
    sizes = []
    splats = make_scene(60)
    cameras = cameras_around(splats, "z", 300, n=31)
    measured = Views.psnr

    def recorded(views, shown):
        sizes.append((len(views.cameras), max(c.width for c in views.cameras)))
        return measured(views, shown)

    monkeypatch.setattr(Views, "psnr", recorded)
    data = encode_scene(splats, levels=1, preset="scene", cameras=cameras, effort=1)
    assert known_of(data).views == "4 of the 31 cameras given, 200 pixels"
    assert sizes[-1] == (N_VIEWS, PIXELS)


def widths(cameras):
    return [camera.width for camera in cameras]


@pytest.mark.parametrize("is_small", [True, False])
def test_falls_are_looked_for_in_views_of_two_sizes_also_by_few_of_them(monkeypatch, is_small):
    monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 400)
    monkeypatch.setattr(measure, "ALL_LOOK_UP_TO", 1000 if is_small else 100)
    gauge = Gauge.of(lift(make_scene(200), 2), Request.of("scene", {}))
    assert gauge is not None
    many = widths(gauge.many.cameras)
    assert len(many) == (24 if is_small else 8)
    assert many.count(400) == many.count(200) == len(many) // 2
    assert (
        {*widths(gauge.many.fewer(N_JUDGING_FIRST).cameras)}
        == {*many[::FIRST_VIEWS_EVERY]}
        == {200, 400}
    )
    assert widths(gauge.packets.cameras) == (many if is_small else 24 * [200])
    assert widths(gauge.views.cameras) == N_VIEWS * [200]


@pytest.mark.parametrize("options", [{"cameras": ()}, {"max_error": 0.1}])
def test_where_no_views_decide_nothing_is_said(options):
    data = encode_scene(make_scene(60), levels=2, effort=1, **options)
    assert level_psnr(read_directory(data)) is None


def test_of_a_scene_that_no_view_shows_nothing_is_said():
    unseen = replace(make_scene(60), opacity_logits=np.full(60, -40, np.float32))
    cameras = cameras_around(unseen, "z", 32)[::8]
    data = encode_scene(unseen, levels=2, cameras=cameras, effort=1)
    assert level_psnr(read_directory(data)) is None
    most = len(data) + 80
    aimed = encode_scene(unseen, levels=2, cameras=cameras, effort=1, target_bytes=most)
    assert len(aimed) <= most
    assert KEY not in read_directory(aimed).info.text


@pytest.mark.thorough
def test_trees_are_measured_too():
    _, cameras, _ = stream()
    tree = lift(make_scene(300), 3)
    for preset in (None, "trained"):
        data = encode_tree(tree, cameras=cameras, effort=1, preset=preset)
        assert len(known_of(data).decibels) == read_directory(data).n_levels


@pytest.mark.parametrize(
    ("n_bytes", "layers"),
    [
        (4000, 1),
        pytest.param(4000, 2, marks=pytest.mark.thorough),
        pytest.param(9000, 1, marks=pytest.mark.thorough),
        pytest.param(9000, 2, marks=pytest.mark.thorough),
    ],
)
def test_a_number_of_bytes_counts_what_is_said(n_bytes, layers):
    splats, cameras, _ = stream()
    data = encode_scene(
        splats, levels=3, target_bytes=n_bytes, layers=layers, cameras=cameras, effort=1
    )
    assert 0.98 * n_bytes <= len(data) <= n_bytes
    decibels = known_of(data).decibels
    assert len(decibels) == read_directory(data).n_levels == 2 + layers
    assert max(decibels) > 10


# --- the value ------------------------------------------------------------------------------------


def with_value(value):
    """The directory of a stream whose metadata says so."""
    data = stream()[2]
    directory = read_directory(data)
    return replace(directory, info=SceneInfo(text={KEY: value}))


GOOD = {
    "20.00; v": ((20.0,), "v"),
    "1.25 120.50; a; b\nc": ((1.25, 120.5), "a; b\nc"),
    "01.00 02.00 03.00 04.00; x": ((1.0, 2.0, 3.0, 4.0), "x"),
}
BAD = [
    *("", "20.00", "20.00;", "20.00; ", "20; v", "20.0; v", "20.000; v", "1000.00; v", "; v"),
    *("20.00  30.00; v", "-1.00; v", "nan; v", "20.00 ; v", " 20.00; v", "\uff120.00; v"),
    "1.00 2.00 3.00 4.00 5.00; more numbers than levels",
]


@pytest.mark.parametrize("value", GOOD)
def test_a_value_of_the_form_is_read(value):
    assert level_psnr(with_value(value)) == LevelPsnr(*GOOD[value])


@pytest.mark.parametrize("value", BAD)
def test_a_value_of_another_form_says_nothing(value):
    assert level_psnr(with_value(value)) is None


def test_what_is_written_is_read_within_the_numbers_that_are_written():
    data = stream()[2]
    given = LevelPsnr((-3.0, 0.004, 9.996, 150.0), "some views")
    found = level_psnr(read_directory(with_level_psnr(data, given)))
    assert found == LevelPsnr((0.0, 0.0, 10.0, 99.99), "some views")


def test_nothing_else_changes():
    data = stream()[2]
    changed = with_level_psnr(data, LevelPsnr((1.0,), "v"))
    assert decode(changed, verify=True).dump() == decode(data).dump()
    old, new = (read_directory(one) for one in (data, changed))
    assert new.digests == old.digests
    assert changed[new.data_offset :] == data[old.data_offset :]
    assert new.info == replace(old.info, text={**old.info.text, KEY: "01.00; v"})


# --- parts, and what is printed -------------------------------------------------------------------


def test_a_part_keeps_what_the_whole_said():
    data = stream()[2]
    directory = read_directory(data)
    for cut in (choose_cut(directory, level=1), choose_cut(directory, sh_degree=0)):
        assert level_psnr(read_directory(extract(data, cut))) == level_psnr(directory)


def test_info_shows_a_column_for_the_levels_that_are_there(evogs, tmp_path):
    data = stream()[2]
    directory = read_directory(data)
    decibels = known_of(data).decibels
    (tmp_path / "x.evogs").write_bytes(data)
    (tmp_path / "part.evogs").write_bytes(extract(data, choose_cut(directory, level=1)))
    for name, n in (("x", 4), ("part", 2)):
        code, out, _ = evogs("info", tmp_path / f"{name}.evogs")
        assert code == 0
        assert "PSNR of  3 of the 3 cameras given, 200 pixels" in out
        shown = [f" {one:.2f} " in out for one in decibels]
        assert shown == [True] * n + [False] * (4 - n)
        found = json.loads(evogs("info", tmp_path / f"{name}.evogs", "--json")[1])
        assert found["psnr_views"] == "3 of the 3 cameras given, 200 pixels"
        expected = [*decibels[:n], *[None] * (4 - n)]
        assert [level["psnr"] for level in found["levels"]] == expected
        assert KEY not in found["scene"]


def test_info_has_no_column_where_nothing_is_known(evogs, tmp_path):
    plain = encode_scene(make_scene(60), levels=2, cameras=(), effort=1)
    (tmp_path / "x.evogs").write_bytes(plain)
    assert "PSNR" not in evogs("info", tmp_path / "x.evogs")[1]
    found = json.loads(evogs("info", tmp_path / "x.evogs", "--json")[1])
    assert found["psnr_views"] is None
    assert [level["psnr"] for level in found["levels"]] == [None] * 2


def test_a_value_of_another_form_is_shown_as_text(evogs, tmp_path):
    info = SceneInfo(text={KEY: "very good"})
    data = encode_scene(make_scene(60), levels=2, cameras=(), effort=1, info=info)
    (tmp_path / "x.evogs").write_bytes(data)
    assert "psnr  very good" in evogs("info", tmp_path / "x.evogs")[1]
    found = json.loads(evogs("info", tmp_path / "x.evogs", "--json")[1])
    assert found["scene"][KEY] == "very good"


def test_a_decoded_scene_does_not_say_it(evogs, tmp_path):
    (tmp_path / "x.evogs").write_bytes(stream()[2])
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "x.ply", "--level", 0)[0] == 0
    header = (tmp_path / "x.ply").read_bytes().partition(b"end_header")[0]
    assert b"generator: evogs" in header
    assert b"psnr" not in header
    assert len(read_ply(tmp_path / "x.ply"))
