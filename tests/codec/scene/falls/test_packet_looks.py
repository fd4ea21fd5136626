"""How views find the prefixes of a stream: what falls, and what makes it good."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import read_directory
from evogs_codec.render import Views
from evogs_codec.scene.falls import packet_looks
from evogs_codec.scene.found_stream import FoundStream


class ByNumber:
    """Views that give splats the PSNR that they are."""

    which: Any
    n_drawn: int

    def __init__(self, which: Any) -> None:
        self.which, self.n_drawn = which, 0

    def psnr_of_each(self, leaves):
        self.n_drawn += len(self.which)
        return np.array([float(leaves[k]) for k in self.which])

    def psnr(self, leaves):
        return float(self.psnr_of_each(leaves).mean())


def prefix_of(leaves: Any, views: Any, few: Any) -> packet_looks._Prefix:
    return packet_looks._Prefix(leaves, views, few)


@pytest.mark.parametrize(
    ("one", "fall", "n_drawn"),
    [
        ([31.0, 31.1, 31.2, 29.0], -1.05, 0),  # better in the first two: no others are asked
        ([30.02, 29.98, 29.0, 30.0], 0.0, 0),  # the same in these, nearly
        ([31.0, 29.5, 29.0, 29.7], 0.2, 4),  # better in one of these
        ([30.0, 29.9, 30.0, 29.0], 0.275, 4),
    ],
)
def test_all_views_judge_where_a_few_leave_doubt(one, fall, n_drawn):
    views, few = ByNumber(range(4)), ByNumber(range(2))
    prefix, other = (prefix_of(x, views, few) for x in (one, [30.0] * 4))
    assert prefix.fall_after(other) == pytest.approx(fall)
    assert views.n_drawn == 2 * n_drawn
    by_all, other = (prefix_of(x, views, None) for x in (one, [30.0] * 4))
    assert by_all.fall_after(other) == pytest.approx(30.0 - np.mean(one))


@pytest.mark.parametrize(
    ("n_splats", "n_views", "is_at_once", "n_few"),
    [
        (20_000, 24, False, 5),
        (20_000, 4, True, 1),
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
    few = packet_looks._few_of(views, layered)
    assert (0 if few is None else len(few.cameras)) == n_few


def test_what_is_known_of_prefixes_before_a_packet():
    views = ByNumber(range(2))
    first, second = (prefix_of(x, views, views) for x in ([20.0, 22.0], [30.0, 31.0]))
    until = [(3, 0.0, first), (5, 0.1, first), (6, 0.1, second)]
    looks = packet_looks.Looks(0.0, {}, 0.1, frozenset(), until)
    assert looks.before(3) == (0.0, -np.inf)
    assert looks.before(4) == (0.0, 21.0)
    assert looks.before(6) == (0.1, 21.0)
    assert looks.before(7) == (0.1, 30.5)


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
    monkeypatch.setattr(packet_looks, "shown", lambda *_: ([x] * 4 for x in shown))
    views = Told(layered.encoder.views.scene, layered.encoder.views.cameras)
    looks = packet_looks.Looks.of(layered, views)
    assert looks is not None
    found = [(fall.rows[0], fall.rows[-1], fall.highest) for fall in looks.recovered]
    assert found == [(rows[begin], rows[end], highest) for begin, end, highest in recovered]
    # From the first packet that looks worse to the last of all.
    worse = [k for k, value in enumerate(decibels) if k and max(decibels[:k]) - value > 0.025]
    if not worse:
        assert looks.first is None
    else:
        n_packets = len(read_directory(layered.data).packets)
        assert looks.first is not None
        assert looks.first.rows == range(rows[worse[0]], n_packets)
        assert looks.first.highest == max(decibels[: worse[0]])
