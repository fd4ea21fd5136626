"""Without a word of what to look at, pictures show the side that has something to show."""

import numpy as np
import pytest

from evogs_codec import SplatParams
from evogs_codec.render import cameras_around
from evogs_codec.render import front as module
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.front import most_detailed

pytest.importorskip("numba")


def wall(side):
    """A wall that is plain on one side and has squares on the other; z is up."""
    x, z = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 24)))
    square = np.where((np.arange(576) // 24 // 3 + np.arange(576) % 24 // 3) % 2, 1.5, -1.5)
    means = np.concatenate(
        [np.stack([x, np.full(576, y), z], axis=1) for y in (0.1 * side, -0.1 * side)]
    )
    dc = np.concatenate([square, np.zeros(576)])
    n = len(means)
    return SplatParams(
        means=means.astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),  # type: ignore[arg-type]
        log_scales=np.tile(np.log(np.float32([0.06, 0.01, 0.06])), (n, 1)),  # type: ignore[arg-type]
        opacity_logits=np.full(n, 8, np.float32),
        sh=np.repeat(dc.astype(np.float32)[:, None, None], 3, axis=2),
    )


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("size", [48, 400])
def test_the_side_with_detail_is_shown(side, size):
    scene = wall(side)
    cameras = cameras_around(scene, "z", size)
    chosen = cameras[most_detailed(scene, cameras)]
    assert chosen.position[1] * side > 0.5


def test_the_shipped_scene_is_seen_from_its_front():
    scene = make_scene(3000)
    assert 10 <= most_detailed(scene, cameras_around(scene, "z")) <= 17


def test_a_large_scene_is_judged_by_the_splats_that_cover_most(monkeypatch):
    scene = wall(1)
    plain = most_detailed(scene, cameras_around(scene, "z"))
    monkeypatch.setattr(module, "MAX_SPLATS", 1152)
    dust = wall(-1)
    small = SplatParams(
        dust.means * 0.9, dust.quats, dust.log_scales - 6, dust.opacity_logits, dust.sh
    )
    names = ("means", "quats", "log_scales", "opacity_logits", "sh")
    both = SplatParams(
        *(np.concatenate([getattr(small, name), getattr(scene, name)]) for name in names)
    )
    assert most_detailed(both, cameras_around(scene, "z")) == plain


def test_one_camera_is_the_one():
    scene = wall(1)
    assert most_detailed(scene, cameras_around(scene, "z", n=1)) == 0
