"""The last packets of few splats in the order that falls least."""

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
from evogs_codec.model.packet_id import PacketId
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene.order_by_views import MOST_STATES, ordered_by_views

N_BANDS = 3


@pytest.fixture(scope="module")
def stream():
    splats = make_scene(300)
    views = Views(splats, cameras_around(splats, "z", 60, n=4))
    return TargetEncoder(lift(splats, 3), PRESETS["scene"], views, layers=2).at_price(1e-10)


class Judge(Views):
    """Views whose PSNR is that of the SH bands that splats have: a bit of each."""

    def __init__(self, whole, decibels):
        self.whole, self.decibels = whole, decibels

    def psnr(self, leaves):
        is_there = 0
        for band in range(1, 1 + N_BANDS):
            part = slice(band**2, (band + 1) ** 2)
            found = leaves.sh[:, part]
            same = found.shape == self.whole.sh[:, part].shape
            is_there |= (same and np.array_equal(found, self.whole.sh[:, part])) << (band - 1)
        return self.decibels.get(is_there, 0.0) if len(leaves) == len(self.whole) else -1.0


def packets(data):
    directory = read_directory(data)
    return [
        PacketId(int(row["tile"]), int(row["component"]), int(step))
        for row, step in zip(directory.packets, directory.steps, strict=True)
        if row["size"]
    ]


@pytest.mark.parametrize(
    ("decibels", "bands"),
    [
        ({1: -5, 2: 1, 3: -5, 4: -5, 5: -5, 6: 2, 7: 3}, [2, 3, 1]),
        ({1: -5, 2: -5, 3: 5, 4: 1, 5: 2, 6: -5, 7: 3}, [3, 1, 2]),
        ({1: 1, 2: -1, 3: -5, 4: 2, 5: 0.5, 6: -5, 7: 3}, [1, 3, 2]),
    ],
)
def test_bands_come_in_the_order_that_falls_least(stream, decibels, bands):
    whole = decode(stream).leaves()
    data = ordered_by_views(stream, Judge(whole, decibels), 3)
    ends = {packet.component: k for k, packet in enumerate(packets(data))}
    assert sorted(range(1, 1 + N_BANDS), key=lambda band: ends[band]) == bands


def test_nothing_but_the_order_changes(stream):
    judge = Judge(decode(stream).leaves(), {4: 1, 6: 2, 7: 3})
    data = ordered_by_views(stream, judge, 3)
    assert data != stream
    assert len(data) == len(stream)
    assert sorted(packets(data)) == sorted(packets(stream))
    assert decode(data, verify=True).dump() == decode(stream).dump()
    directory = read_directory(data)
    for k in range(len(directory.packets)):
        end = int(directory.offsets[k] + directory.packets["size"][k])
        decode(data[:end] if end < len(data) else data, Cut.of_prefix(directory, end))


def test_states_are_bounded(stream):
    class Counting(Judge):
        n = 0

        def psnr(self, leaves):
            self.n += 1
            return float(self.n)

    judge = Counting(decode(stream).leaves(), {})
    ordered_by_views(stream, judge, 3)
    assert 2 ** (1 + N_BANDS) <= judge.n <= MOST_STATES


def test_several_tiles_stay_as_they_are():
    data = encode_scene(make_scene(200), n_tiles=2, preset="scene")
    assert ordered_by_views(data, Judge(decode(data).leaves(), {}), 3) is data
