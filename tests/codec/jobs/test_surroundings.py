"""Views of a tile among others: which put packets in order, and what counts in two kinds."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from evogs_codec import SplatParams, decode_leaves, write_ply
from evogs_codec.jobs import Engine, JobOptions, encode_files
from evogs_codec.jobs.surroundings import NearAndWide, Neighbourhood, Standing, part_shown
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from tests.support.view_sizes import SMALL, views_of


@pytest.mark.parametrize(("all_round", "n_circle"), [(True, 8), (False, 12)])
def test_packets_are_put_in_order_by_views_on_the_circle(all_round, n_circle):
    splats = make_scene(60)
    standing = Standing.around(splats, up="z", n_views=12, all_round=all_round, pixels=None)
    views = Neighbourhood.of(splats, standing, 60, keep=1.0)
    heights = np.array([camera.position[2] for camera in views.views.cameras])
    assert len(heights) == 12
    assert np.ptp(heights[:n_circle]) < 1e-6
    ordering = views.fewer(3).views.cameras
    assert len(ordering) == 3
    assert [camera.position[2] for camera in ordering] == pytest.approx([heights[0]] * 3)


def test_what_wide_views_alone_show_counts_in_prices_of_a_bit():
    splats = make_scene(60)
    near, far = (
        Neighbourhood.of(
            splats,
            Standing.around(part, up="z", n_views=3, all_round=False, pixels=60),
            n_shown,
            keep=0.0,
        )
        for part, n_shown in ((splats.take(slice(0, 5)), 60), (splats, 600))
    )
    both = NearAndWide(near, far)
    expected = near.sensitivity(splats) + 10 * far.sensitivity(splats)
    worth, decibels = both.sensitivity_and_psnr(nothing := splats.take(slice(0, 1)))
    assert np.allclose(both.sensitivity(splats), expected)
    assert worth.shape == (expected.shape[0], 1)
    assert decibels == pytest.approx(both.psnr(nothing))
    errors = [10 ** (-views.psnr(nothing) / 10) for views in (near, far, both)]
    assert errors[2] == pytest.approx(errors[0] + 10 * errors[1])
    grey = [splats.sh, 0 * splats.sh]
    found = [list(views.psnr_of_sh(splats, grey)) for views in (near, far, both)]
    for own, wide, each in zip(*found, strict=True):
        assert 10 ** (-each / 10) == pytest.approx(10 ** (-own / 10) + 10 * 10 ** (-wide / 10))
    assert both.fewer(2).wide.views.cameras == far.fewer(2).views.cameras
    assert both.n_shown == 60


def test_tiles_that_are_a_dot_among_the_others_are_not_counted_with_what_views_show():
    city = make_scene(300)
    dot = make_scene(100)
    dot = replace(dot, means=dot.means / np.float32(1000))
    none = city.take(slice(0))
    parts = [city.take(slice(0, 150)), dot, none, city.take(slice(150, None))]
    assert part_shown(parts) == 0.75
    assert part_shown([parts[0], parts[3]]) == 1
    far = replace(dot, means=dot.means + np.float32(1000))
    assert part_shown([dot, far]) == 1, "nothing else is shown"


@pytest.mark.thorough
def test_tiles_with_views_of_their_own_keep_the_sky_that_others_show(tmp_path):
    # A tile is small ground and a part of the sky, which cameras near the ground do not show.
    one = make_scene(1000)
    beside = [np.array([90 * i, 90 * j, 0], np.float32) for i in range(3) for j in range(2)]
    parts = [replace(one, means=one.means + way).channels() for way in beside]
    scene = SplatParams.from_channels(np.concatenate(parts, axis=1))
    write_ply(tmp_path / "a.ply", scene)
    options = JobOptions(levels=2, per_tile=900, up="z")
    with views_of(SMALL):
        encode_files([tmp_path / "a.ply"], tmp_path / "a.evogs", options, engine=Engine("serial"))
    leaves = decode_leaves((tmp_path / "a.evogs").read_bytes())
    assert Views(scene, cameras_around(scene, "z", 150, n=6)).psnr(leaves) > 43
