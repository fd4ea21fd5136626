"""Targets of many splats: a sketch guesses a price, and what is far out of reach is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import TargetMissedError, decode, encode_scene, encode_tree, lift
from evogs_codec.encoding import arrange as arranging
from evogs_codec.encoding import prepared
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import choose, reach

N = 1200


@pytest.fixture(autouse=True)
def _many(monkeypatch):
    monkeypatch.setattr(choose, "MANY", 1000)
    monkeypatch.setattr(reach, "SOME", 400)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ({"target_psnr": 119.0}, "119 dB cannot be met: about"),
        ({"target_psnr": 5.0}, "5 dB cannot be met: about"),
        ({"target_bytes": 100}, "100 bytes cannot be met: about"),
        ({"target_bytes": 10**8}, "100,000,000 bytes cannot be met: about"),
    ],
)
def test_a_target_far_out_of_reach_is_refused_by_a_few_splats(monkeypatch, target, said):
    sizes = []

    def arrange(tree, n_tiles):
        sizes.append(tree.n_leaves)
        return arranging.arrange(tree, n_tiles)

    monkeypatch.setattr(prepared, "arrange", arrange)
    scene = make_scene(N)
    means = scene.means.copy()
    means[:2] = [[-3e4] * 3, [3e4] * 3]  # no grid has 119 dB of the others
    scene = replace(scene, means=means)
    with pytest.raises(TargetMissedError, match=f"{said} [\\d,]+ to [\\d,]+ (dB|bytes) can be"):
        encode_scene(scene, up="z", effort=1, **target)
    assert max(sizes) < N / 2


@pytest.mark.thorough
@pytest.mark.usefixtures("any_views")
def test_targets_are_met_from_a_guess():
    splats = make_scene(N)
    views = Views.of(splats, cameras_around(splats, "z"))
    data = encode_scene(splats, up="z", effort=1, target_psnr=40.0)
    assert views.psnr(decode(data).leaves(sh_degree=3)) == pytest.approx(40.0, abs=0.2)
    data = encode_scene(splats, up="z", effort=1, target_psnr=85.0)
    assert views.psnr(decode(data).leaves(sh_degree=3)) == pytest.approx(85.0, abs=0.5)
    data = encode_scene(splats, up="z", effort=1, target_bytes=25_000)
    assert 24_500 <= len(data) <= 25_000


@pytest.mark.thorough
@pytest.mark.usefixtures("any_views")
def test_a_tree_is_met_from_a_guess():
    splats = make_scene(N)
    views = Views.of(splats, cameras_around(splats, "z"))
    data = encode_tree(lift(splats, 3), up="z", effort=1)
    assert views.psnr(decode(data).leaves(sh_degree=3)) == pytest.approx(52.0, abs=0.2)
