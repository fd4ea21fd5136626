"""No step back: first bytes of a stream look no worse than fewer of them, whatever the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import (
    PRESETS,
    Cut,
    TargetEncoder,
    decode,
    encode_scene,
    lift,
    read_directory,
)
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import steady
from evogs_codec.scene.choose import FoundStream

N = 600
WORST = 0.05  # dB


def odd_scenes():
    """Of odd statistics: by name."""
    splats = make_scene(N, 3)
    rng = np.random.default_rng(0)

    def like(values, of):
        return np.broadcast_to(values, of.shape).astype(np.float32)

    logits, sizes = splats.opacity_logits, splats.log_scales
    haze = rng.normal(-4.0, 0.3, logits.shape)
    clump = rng.normal(0.0, 0.5, splats.means.shape)
    return {
        "all opaque": replace(splats, opacity_logits=like(8.0, logits)),
        "all haze": replace(splats, opacity_logits=like(haze, logits)),
        "huge splats": replace(splats, log_scales=sizes + np.float32(2)),
        "one dense clump": replace(splats, means=like(clump, splats.means)),
        "SH degree 0": replace(splats, sh=splats.sh[:, :1]),
        "far apart": replace(splats, means=splats.means * np.float32(5)),
        "dots": replace(splats, log_scales=sizes - np.float32(2)),
    }


def deepest_fall(data, splats):
    """dB from the best prefix that ends with a packet of the levels to a longer one, 12 views."""
    views = Views(splats, cameras_around(splats, "z", 120, n=12))
    directory = read_directory(data)
    ends = directory.offsets + directory.packets["size"]
    ends = ends[(directory.columns == 0) & (directory.packets["size"] > 0)]
    best, fall = -np.inf, 0.0
    for end in ends[1:].tolist():
        leaves = decode(data, Cut.of_prefix(directory, end)).leaves(sh_degree=splats.sh_degree)
        shown = views.psnr(leaves)
        best, fall = max(best, shown), max(fall, best - shown)
    return fall


@pytest.mark.thorough
@pytest.mark.parametrize("name", odd_scenes())
def test_no_packet_of_core_makes_pictures_worse(name):
    """Those of SH are not looked at: one of a last layer was seen to cost 0.2 dB, of a clump."""
    splats = odd_scenes()[name]
    assert deepest_fall(encode_scene(splats, effort=1), splats) <= WORST


def test_without_looking_some_scenes_fall(monkeypatch):
    monkeypatch.setattr(steady, "FELL", np.inf)
    splats = odd_scenes()["all haze"]
    assert deepest_fall(encode_scene(splats, effort=1), splats) > 1.0


def test_what_is_looked_at_is_what_a_decoder_shows():
    splats = make_scene(N)
    tree = lift(splats, 3)
    aim = TargetEncoder(tree, PRESETS["scene"], Views(splats, cameras_around(splats, "z", 60, n=4)))
    found = FoundStream.draft(replace(aim, layers=2, n_tiles=2), 4e-6 / N)
    directory = read_directory(found.data)
    cuts = [cut for level in range(directory.n_levels) for cut in steady._cuts(directory, level)]
    assert len(cuts) > directory.n_levels
    for cut, leaves in zip(cuts, steady._shown(found, directory, cuts), strict=True):
        expected = decode(found.data, cut).leaves(sh_degree=3)
        assert np.array_equal(leaves.channels(), expected.channels())


def test_a_draft_has_the_integers_of_the_stream():
    splats = make_scene(N)
    views = Views(splats, cameras_around(splats, "z", 60, n=4))
    found = FoundStream.draft(TargetEncoder(lift(splats, 2), PRESETS["scene"], views), 4e-6 / N)
    whole = found.finished()
    assert len(whole) < len(found.data)
    assert not read_directory(found.data).digests
    assert decode(whole, verify=True).dump() == decode(found.data).dump()
