"""How views find the prefixes of a stream: what falls, and what makes it good."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import read_directory
from evogs_codec.model.packet_id import PacketId
from evogs_codec.render import Views
from evogs_codec.scene.falls import packet_looks
from evogs_codec.scene.found_stream import FoundStream
from tests.codec.scene.conftest import Shown

A_PREFIX: Any = object()
ANOTHER: Any = object()


@pytest.mark.parametrize(
    ("n_splats", "n_views", "is_at_once", "n_few"),
    [
        (20_000, 24, False, 5),
        (20_000, 24, True, 5),
        (20_000, 20, False, 0),
        (20_000, 1, True, 0),
        (90_000, 24, False, 5),
        (90_000, 20, False, 0),
        (90_000, 24, True, 0),
    ],
)
def test_of_many_splats_few_views_judge_first_where_they_are_enough(
    monkeypatch, layered, n_splats, n_views, is_at_once, n_few
):
    views = layered.encoder.views
    views = Views(views.scene, [views.cameras[0]] * n_views)
    monkeypatch.setattr(FoundStream, "is_at_once", is_at_once)
    monkeypatch.setattr(type(layered.tree), "n_leaves", n_splats)
    judges = packet_looks.judges_of(views, layered)
    assert (0 if judges.few is None else len(judges.few.cameras)) == n_few
    if n_splats > 20_000 or not n_few:
        assert judges.small is None
    else:
        assert judges.small is not None
        assert len(judges.small.cameras) == n_views
        assert all(camera.width <= packet_looks.SMALL_PIXELS for camera in judges.small.cameras)


def test_what_is_known_of_prefixes_before_a_packet():
    first, second = A_PREFIX, ANOTHER
    until = [(3, 0.0, first), (5, 0.1, first), (6, 0.1, second)]
    looks = packet_looks.Looks(0.0, {}, 0.1, frozenset(), until)
    assert looks.before(3) == (0.0, None)
    assert looks.before(4) == (0.0, first)
    assert looks.before(6) == (0.1, first)
    assert looks.before(7) == (0.1, second)


def test_packets_of_few_bytes_that_fall_and_those_that_make_them_good():
    def band(component, step):
        return PacketId(0, component, step)

    falls = {band(2, 4): 0.3, band(3, 1): 0.1}
    small = frozenset({band(2, 4), band(3, 4), band(1, 1)})
    good = (band(2, 4), band(0, 5), band(3, 4), band(3, 1))
    recovered = [packet_looks.Fall(range(7, 11), A_PREFIX, good)]
    looks = packet_looks.Looks(40.0, falls, 0.3, frozenset(), [], small, recovered)
    assert looks.small_worse == {band(2, 4)}
    assert looks.small_until_good == {band(2, 4), band(3, 4)}


def test_of_a_stream_that_falls_more_nothing_is_known(layered):
    views = layered.encoder.views
    looks = packet_looks.Looks.of(layered, views)
    assert looks is not None
    assert packet_looks.Looks.of(layered, views, looks.fall) is not None
    assert packet_looks.Looks.of(layered, views, -1.0) is None


class Told(Views):
    """Views that are told what each finds."""

    def psnr_of_each(self, leaves):
        return np.array(leaves)


@pytest.mark.parametrize(
    ("decibels", "recovered"),
    [
        ([20.0, 21.0, 22.0], []),
        ([20.0, 21.0, 20.5], []),
        ([20.0, 21.0, 20.99, 22.0], []),
        ([20.0, 21.0, 20.99, 20.5, 20.7, 21.1], [(3, 5, 21.0)]),
        ([20.0, 19.0, 20.0, 21.0, 20.9, 21.5], [(1, 2, 20.0), (4, 5, 21.0)]),
    ],
)
def test_falls_that_later_packets_make_good_are_known(monkeypatch, layered, decibels, recovered):
    rows = packet_looks.rows_of(read_directory(layered.data))
    shown = [*decibels, *[decibels[-1]] * (len(rows) - len(decibels))]
    monkeypatch.setattr(packet_looks, "shown", lambda *_: (Shown([x] * 4) for x in shown))
    views = Told(layered.encoder.views.scene, layered.encoder.views.cameras)
    looks = packet_looks.Looks.of(layered, views)
    assert looks is not None
    found = [(fall.rows[0], fall.rows[-1], fall.best.psnr) for fall in looks.recovered]
    assert found == [(rows[begin], rows[end], highest) for begin, end, highest in recovered]
    # From the first packet that looks worse to the last of all.
    worse = [k for k, value in enumerate(decibels) if k and max(decibels[:k]) - value > 0.025]
    if not worse:
        assert looks.first is None
    else:
        n_packets = len(read_directory(layered.data).packets)
        assert looks.first is not None
        assert looks.first.rows == range(rows[worse[0]], n_packets)
        assert looks.first.best.psnr == max(decibels[: worse[0]])
