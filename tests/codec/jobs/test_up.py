"""What is up in a scene that is never in memory as a whole."""

import numpy as np
import pytest

from evogs_codec import SceneInfo, write_ply
from evogs_codec._generated import registry
from evogs_codec.common.progress import no_progress
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.jobs import up as of_jobs
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.partition import partition
from evogs_codec.jobs.up import up_of_tiles
from evogs_codec.render.demo_scene import make_scene

pytest.importorskip("numba")

Z_TO_MINUS_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@pytest.fixture(scope="module")
def turned():
    return transformed(make_scene(6000), Z_TO_MINUS_Y)


def tiles_of(folder, scene):
    write_ply(folder / "scene.ply", scene)
    made = folder / "tiles"
    made.mkdir()
    return partition(SplatFiles([folder / "scene.ply"]), made, no_progress, 1500)


@pytest.mark.parametrize("few", [10_000, 0], ids=["some splats", "stand-ins"])
def test_the_ground_of_all_tiles_shows_what_is_up(few, turned, tmp_path, monkeypatch):
    monkeypatch.setattr(of_jobs, "SAMPLED_UP_TO", few)
    found = up_of_tiles(tiles_of(tmp_path, turned), None, SceneInfo())
    assert found.name == "-y"
    assert "splats" in found.source


def test_the_order_of_splats_does_not_change_what_is_up(turned, tmp_path):
    order = np.random.default_rng(0).permutation(len(turned))
    found = []
    for name, scene in (("a", turned), ("b", turned.take(order))):
        (tmp_path / name).mkdir()
        tiles = tiles_of(tmp_path / name, scene)
        found.append(of_jobs._some(tiles).channels())
    assert np.array_equal(found[0], found[1])


def test_who_asks_comes_before_the_file_and_the_file_before_the_splats(turned, tmp_path):
    tiles = tiles_of(tmp_path, turned)
    says_x = SceneInfo(up_axis=registry.UP_AXES.index("+x"))
    assert up_of_tiles(tiles, "y", says_x).name == "y"
    assert up_of_tiles(tiles, (0.0, 3.0, 4.0), says_x).vector == pytest.approx((0, 0.6, 0.8))
    assert up_of_tiles(tiles, None, says_x).name == "x"
