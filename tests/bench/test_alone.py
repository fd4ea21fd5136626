"""`python -m tools.bench --only alone`: streams beside those of the splats alone."""

import pytest

from evogs_codec import PRESETS, decode_leaves, encode_scene, lift

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from tests.support.view_sizes import SMALL, views_of
from tools.bench.alone import alone
from tools.bench.subjects import Subject

pytestmark = pytest.mark.thorough


def test_the_splats_alone_have_the_psnr_of_the_stream():
    scene = make_scene(6000)
    with views_of(SMALL):
        views = Views(scene, cameras_around(scene, "z", SMALL, n=24))
        subject = Subject.of_tree("small", lift(scene, 3), PRESETS["scene"], views)
        (row,) = alone([subject])
        reached = float(str(row["PSNR, dB"]))
        single, better = (
            encode_scene(scene, levels=1, layers=1, target_psnr=reached + more, up="z")
            for more in (0, 1)
        )
    off, more = (views.psnr(decode_leaves(data)) - reached for data in (single, better))
    assert abs(off) < 0.21
    a_decibel = (len(better) / len(single)) ** (1 / (more - off))
    expected = len(single) / a_decibel**off
    assert row["bytes of the splats alone"] == pytest.approx(expected, rel=0.01)
    ratio = float(str(row["bytes"])) / float(str(row["bytes of the splats alone"]))
    assert float(str(row["to the splats alone"])) == pytest.approx(ratio, abs=0.005)
