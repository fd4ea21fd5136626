"""Scenes and streams of any size, and what a process takes, for `python -m tools.bench`."""

import numpy as np
import pytest

from evogs_codec import PRESETS, EvolutionTree, decode, encode
from tools.bench import scale
from tools.bench.measure import cost
from tools.scene import make_scene


@pytest.fixture
def small_copies(monkeypatch):
    monkeypatch.setattr(scale, "COPY", 300)


@pytest.mark.parametrize("n", [1, 299, 1000])
def test_copies_of_a_scene_are_as_many_splats_as_asked_no_two_alike(small_copies, n):
    splats = scale.tiled(n)
    assert len(splats) == n
    assert splats.sh_degree == scale.SH_DEGREE
    assert splats.finite().all()
    assert len(np.unique(splats.means, axis=0)) == n


def test_a_repeated_stream_decodes_to_its_tiles_side_by_side():
    data = encode(EvolutionTree.of_splats(make_scene(500)), PRESETS["scene"], n_tiles=2)
    many = decode(scale.repeated(data, 3), verify=True).leaves()
    once = decode(data).leaves()
    assert len(many) == 3 * len(once)
    x = many.means[:, 0].reshape(3, -1)
    assert (x[1:].min(axis=1) >= x[:-1].max(axis=1)).all()
    np.testing.assert_allclose(x - x[:, :1], np.tile(x[0] - x[0, 0], (3, 1)), atol=1e-4)
    np.testing.assert_array_equal(many.sh, np.tile(once.sh, (3, 1, 1)))


def test_the_cost_of_code_is_its_own_peak():
    large = "x = bytearray(64 << 20)\nx = None"
    base, while_there = cost("").peak, cost(large).peak
    assert 60 << 20 < while_there - base < 72 << 20
    assert cost("", before=large, after="print('later')").peak - base < 16 << 20
