"""How views find the prefixes of a stream: few first, and all where these leave doubt."""

from typing import Any

import numpy as np
import pytest

from evogs_codec.scene.falls.judges import Judges, Prefix
from tests.codec.scene.conftest import Shown


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


def prefix_of(psnr, judges: Any, where: float = 0.0) -> Prefix:
    leaves: Any = Shown(psnr, where)
    return Prefix(leaves, judges)


def judging(views: Any, few: Any = None, small: Any = None) -> Judges:
    return Judges(views, few, small)


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
    views = ByNumber(range(4))
    judges = judging(views, ByNumber(range(2)))
    prefix, other = (prefix_of(x, judges) for x in (one, [30.0] * 4))
    assert prefix.fall_after(other) == pytest.approx(fall)
    assert views.n_drawn == 2 * n_drawn
    by_all, other = (prefix_of(x, judging(views)) for x in (one, [30.0] * 4))
    assert by_all.fall_after(other) == pytest.approx(30.0 - np.mean(one))


@pytest.mark.parametrize(
    ("one", "fall", "n_drawn"),
    [
        ([29.0, 29.1, 30.0, 30.0], 0.95, 0),  # worse in the first two: no others are asked
        ([29.0, 29.8, 30.0, 30.0], 0.3, 4),  # worse in these, but not surely by 0.4 dB
    ],
)
def test_few_views_are_enough_to_tell_a_deep_fall(one, fall, n_drawn):
    views = ByNumber(range(4))
    judges = judging(views, ByNumber(range(2)))
    prefix, other = (prefix_of(x, judges) for x in (one, [30.0] * 4))
    assert prefix.fall_after(other, 0.4) == pytest.approx(fall)
    assert views.n_drawn == 2 * n_drawn


@pytest.mark.parametrize(("small", "n_drawn"), [(None, 4), (ByNumber([2]), 0)])
def test_without_small_pictures_all_views_judge_other_orders(small, n_drawn):
    views = ByNumber(range(4))
    other = prefix_of([30.0] * 4, judging(views, ByNumber(range(2)), small))
    leaves: Any = Shown([31.0, 31.0, 30.5, 30.5])
    prefix = other.like(leaves)
    assert prefix.fall_after(other) == pytest.approx(-0.75 if small is None else -1.0)
    assert views.n_drawn == 2 * n_drawn
    assert other.fall_after(prefix) == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("one", "has_same_splats", "fall", "n_drawn"),
    [
        ([30.0, 30.0, 28.0, 30.0], False, 0.5, 4),  # the few do not see it, small pictures do
        ([30.0, 30.0, 28.0, 30.0], True, 2.0, 0),  # which are enough to tell what SH do
        ([29.0, 29.1, 30.0, 30.0], False, 0.475, 4),  # the few alone see it
        ([29.0, 29.1, 30.0, 30.0], True, 0.0, 0),
        ([29.0, 29.1, 29.0, 30.0], False, 0.95, 0),  # both do
        ([30.6, 30.7, 20.0, 30.0], False, -0.65, 0),  # the few find it so good that it is no fall
        ([30.4, 30.5, 29.0, 30.0], False, 0.025, 4),
    ],
)
def test_small_pictures_show_what_a_few_views_do_not(one, has_same_splats, fall, n_drawn):
    views = ByNumber(range(4))
    judges = judging(views, ByNumber(range(2)), ByNumber([2]))
    prefix, other = prefix_of(one, judges, not has_same_splats), prefix_of([30.0] * 4, judges)
    assert prefix.fall_after(other, 0.4) == pytest.approx(fall)
    assert views.n_drawn == 2 * n_drawn
