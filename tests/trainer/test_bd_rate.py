"""BD-rate: known distances of curves, and what it refuses."""

import numpy as np
import pytest

from tools.bench.coded.bd_rate import at_worst, bd_rate, log_bytes

CURVE = [(1000, 30.0), (2000, 33.0), (4000, 35.0), (8000, 36.0)]


def scaled(factor):
    return [(factor * n_bytes, psnr) for n_bytes, psnr in CURVE]


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.0, 1.7])
def test_a_curve_with_so_many_times_the_bytes_is_so_far_away(factor):
    assert bd_rate(scaled(factor), CURVE) == pytest.approx(100 * (factor - 1), abs=1e-9)


def test_the_order_of_points_does_not_matter():
    assert bd_rate(scaled(0.8)[::-1], CURVE[2:] + CURVE[:2]) == pytest.approx(-20)


def test_straight_lines_have_the_distance_of_their_means():
    steep, flat = [(100, 30), (400, 32)], [(100, 30), (200, 32)]
    assert bd_rate(steep, flat) == pytest.approx(100 * (np.sqrt(2) - 1), abs=1e-3)


def test_only_the_psnr_that_both_have_counts():
    longer = [*scaled(0.5), (5000, 50.0)]
    assert bd_rate(longer, CURVE[:2]) == pytest.approx(bd_rate(longer[:3], CURVE[:2]))
    assert bd_rate([(1, 20), (2, 29)], CURVE) is None


def test_against_several_curves_the_best_at_each_psnr_counts():
    others = CURVE[:2], scaled(2)
    worst, best = bd_rate(CURVE, scaled(2)), bd_rate(CURVE, *others)
    assert worst == pytest.approx(-50)
    assert -50 < best < 0  # type: ignore[operator]
    assert bd_rate(CURVE[:2], *others) == pytest.approx(0, abs=1e-9)


def test_the_worst_psnr_of_a_curve_that_crosses_another_is_found():
    crossing, straight = [(50, 30.0), (400, 32.0)], [(100, 30.0), (200, 32.0)]
    assert bd_rate(crossing, straight) == pytest.approx(0, abs=1e-6)
    assert at_worst(crossing, straight) == pytest.approx(100)
    assert at_worst(scaled(0.8), CURVE) == pytest.approx(-20)
    assert at_worst([(1, 20), (2, 29)], CURVE) is None


def test_interpolation_keeps_the_points_and_does_not_swing_over():
    np.testing.assert_allclose(np.exp(log_bytes(CURVE, np.array([30, 33.0, 36]))), [1e3, 2e3, 8e3])
    assert (np.diff(log_bytes(CURVE, np.linspace(30, 36, 100))) > 0).all()
    assert np.isnan(log_bytes(CURVE, np.array([29.0, 37.0]))).all()


@pytest.mark.parametrize("curve", [[(1, 30)], [(1, 30), (2, 29)], [(1, 30), (1, 31)]])
def test_what_is_no_curve_is_refused(curve):
    with pytest.raises(ValueError, match=r"curve of 1 point|rise together"):
        bd_rate(curve, CURVE)
