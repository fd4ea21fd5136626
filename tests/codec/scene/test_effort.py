"""Effort by name: what each spends, and what it leaves out."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import (
    Engine,
    JobOptions,
    decode,
    encode_files,
    encode_scene,
    level_psnr,
    read_directory,
    read_ply,
    write_ply,
)
from evogs_codec.render import Views, cameras_around, viewpoints, views
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.forward import draw
from evogs_codec.scene import choose
from evogs_codec.scene.effort import EFFORTS, Effort
from evogs_codec.scene.found_stream import FoundStream

N = 600


@cache
def fast():
    return encode_scene(make_scene(N), levels=3, up="z", effort="fast")


def test_fast_takes_fewer_and_smaller_views(monkeypatch):
    weighed, drawn = Views.sensitivity, []

    def recorded(own, splats):
        drawn.append((len(own.cameras), max(camera.width for camera in own.cameras)))
        return weighed(own, splats)

    monkeypatch.setattr(Views, "sensitivity", recorded)
    monkeypatch.setattr(viewpoints, "SIZE", 400)
    encode_scene(make_scene(60), levels=2, up="z", effort="fast")
    assert set(drawn) == {(6, 300)}
    assert len(drawn) == 1, "the last level alone"


def test_cameras_that_are_given_are_made_small_too(monkeypatch):
    weighed, drawn = Views.sensitivity, []

    def recorded(own, splats):
        drawn.append((len(own.cameras), *{(c.width, c.height) for c in own.cameras}))
        return weighed(own, splats)

    monkeypatch.setattr(Views, "sensitivity", recorded)
    splats = make_scene(60)
    cameras = [camera.resized(400, 300) for camera in cameras_around(splats, "z", n=12)]
    encode_scene(splats, levels=2, cameras=cameras, effort="fast")
    assert set(drawn) == {(6, (300, 225))}


def test_fast_has_layers_and_is_verified_but_is_not_looked_at():
    directory = read_directory(fast())
    assert directory.n_levels == 4
    assert level_psnr(directory) is None
    decoded = decode(fast(), verify=True)
    assert directory.digests
    assert decoded.n_leaves == N


def test_first_bytes_of_fast_look_like_the_scene():
    splats = make_scene(N)
    judges = Views(splats, cameras_around(splats, "z", 100, n=4))
    directory = read_directory(fast())
    shown = [
        judges.psnr(decode(fast(), level=level).leaves(sh_degree=3))
        for level in range(directory.n_levels)
    ]
    assert shown == sorted(shown)
    assert shown[-1] > 30


def test_it_is_the_same_every_time():
    assert encode_scene(make_scene(N), levels=3, up="z", effort="fast") == fast()


def test_fast_encodes_one_of_two_trees(monkeypatch):
    splats = make_scene(N)
    sh = splats.sh.copy()
    sh[:, 1:] = np.random.default_rng(0).normal(size=(8, 15, 3))[np.arange(N) % 8]
    written = []
    monkeypatch.setattr(choose, "SURE_OF_PSI", 1e9)
    monkeypatch.setattr(choose, "SURE_OF_PICKS", 1e9)
    made = FoundStream.made
    monkeypatch.setattr(
        FoundStream,
        "made",
        lambda one: written.append(one.tree.palette) or made(one),  # type: ignore[func-returns-value]
    )
    shared = type(splats)(splats.means, splats.quats, splats.log_scales, splats.opacity_logits, sh)
    assert read_directory(encode_scene(shared, levels=2, up="z", effort="fast")).has_palette
    assert len(written) == 1
    written.clear()
    encode_scene(shared, levels=2, up="z")
    assert None in written[:2]
    assert written[:2] != [None, None]


def test_a_number_is_the_default_with_a_level_of_zstandard():
    assert Effort.of(3) == Effort(zstd_level=3)
    assert Effort.of(None) == Effort.of("default") == EFFORTS["default"]


@pytest.mark.parametrize("effort", ["best", "default"])
def test_errors_are_weighed_by_twelve_views_each_drawn_once(effort, monkeypatch):
    drawn = []
    monkeypatch.setattr(viewpoints, "SIZE", 40)
    monkeypatch.setattr(
        views,
        "draw",
        lambda *args, **more: drawn.append(args) or draw(*args, **more),  # type: ignore[func-returns-value]
    )
    encode_scene(make_scene(60), levels=1, up="z", effort=effort)
    finest = [camera for splats, camera, *_ in drawn if len(splats) == 60]
    assert len(finest) == len(set(finest)) == 12


@pytest.mark.parametrize("effort", ["slow", "", 0, 23])
def test_what_is_no_effort_is_refused(effort):
    with pytest.raises(ValueError, match=r"effort is .*, expected"):
        encode_scene(make_scene(20), levels=2, effort=effort)


def test_the_command_has_a_short_form(evogs, tmp_path):
    write_ply(tmp_path / "x.ply", make_scene(N))
    words = ("encode", tmp_path / "x.ply", tmp_path / "x.evogs", "--levels=3", "--up=z")
    assert evogs(*words, "--fast")[0] == 0
    by_command = (tmp_path / "x.evogs").read_bytes()
    expected = encode_scene(read_ply(tmp_path / "x.ply"), levels=3, up="z", effort="fast")
    assert decode(by_command).dump() == decode(expected).dump()
    assert evogs(*words, "--effort", "fast", "--force")[0] == 0
    assert (tmp_path / "x.evogs").read_bytes() == by_command


@pytest.mark.parametrize(
    "words", [("--effort", "slow"), ("--effort", "23"), ("--fast", "--effort=3")]
)
def test_the_command_refuses_others(evogs, tmp_path, words):
    code, _, err = evogs("encode", tmp_path / "x.ply", tmp_path / "x.evogs", *words)
    assert code == 2
    assert "--effort" in err


@pytest.mark.thorough
def test_tiles_take_it_too(tmp_path):
    write_ply(tmp_path / "x.ply", make_scene(400))
    sizes = {}
    for effort in ("fast", "default"):
        options = JobOptions(levels=2, per_tile=200, effort=effort)
        out = tmp_path / f"{effort}.evogs"
        encode_files([tmp_path / "x.ply"], out, options, engine=Engine("serial"))
        sizes[effort] = decode(out.read_bytes(), verify=True).n_leaves
    assert sizes == {"fast": 400, "default": 400}
    assert (tmp_path / "fast.evogs").read_bytes() != (tmp_path / "default.evogs").read_bytes()
