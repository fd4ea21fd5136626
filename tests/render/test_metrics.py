"""PSNR and SSIM, against numpy that says what it does."""

import math

import numba
import numpy as np
import pytest

from evogs_codec.render import psnr, ssim, ssim_gradient


def plain_ssim(a, b):
    """Wang et al. 2004, an 11 x 11 Gaussian of 1.5 pixels, zeros around; pixel after pixel."""
    taps = np.arange(11) - 5
    window = np.exp(-(taps**2) / 4.5)
    window = np.outer(window, window) / window.sum() ** 2
    height, width, channels = a.shape
    pad = ((5, 5), (5, 5), (0, 0))
    a, b = np.pad(a.astype(float), pad), np.pad(b.astype(float), pad)
    values = np.empty((height, width, channels))
    for y in range(height):
        for x in range(width):
            p, q = a[y : y + 11, x : x + 11], b[y : y + 11, x : x + 11]
            mean_p, mean_q, pp, qq, pq = (
                np.einsum("yx,yxc->c", window, z) for z in (p, q, p * p, q * q, p * q)
            )
            var_p, var_q, cov = pp - mean_p**2, qq - mean_q**2, pq - mean_p * mean_q
            values[y, x] = (2 * mean_p * mean_q + 1e-4) * (2 * cov + 9e-4)
            values[y, x] /= (mean_p**2 + mean_q**2 + 1e-4) * (var_p + var_q + 9e-4)
    return values.mean()


def pictures(height, width, dtype=np.float64, seed=0):
    rng = np.random.default_rng(seed)
    a = rng.random((height, width, 3))
    return a.astype(dtype), np.clip(a + 0.2 * rng.normal(size=a.shape), 0, 1).astype(dtype)


@pytest.mark.parametrize("dtypes", [("f4", "f4"), ("f8", "f4"), ("f8", "f8")])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 7), (16, 16)])
def test_psnr_is_that_of_numpy(height, width, dtypes):
    a, b = pictures(height, width)
    a, b = a.astype(dtypes[0]), b.astype(dtypes[1])
    error = np.mean(np.square(a.astype(float) - b))
    assert psnr(a, b) == pytest.approx(-10 * math.log10(error), rel=1e-12)
    assert psnr(a[::-1, ::-1], b[::-1, ::-1]) == pytest.approx(psnr(a, b), rel=1e-12)


def test_psnr_is_of_pictures_with_pixels():
    with pytest.raises(ValueError, match="without pixels"):
        psnr(np.empty((0, 4, 3)), np.empty((0, 4, 3)))


@pytest.mark.thorough
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 20), (20, 3), (24, 33)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_ssim_is_the_formula(height, width, dtype):
    a, b = pictures(height, width, dtype)
    tolerance = 1e-12 if dtype == np.float64 else 1e-5
    assert ssim(a, b) == pytest.approx(plain_ssim(a, b), abs=tolerance)
    assert ssim_gradient(a, b)[0] == ssim(a, b)


@pytest.mark.thorough
def test_ssim_of_a_picture_with_itself_is_one():
    a, _ = pictures(20, 30, np.float32)
    assert ssim(a, a) == pytest.approx(1, abs=1e-6)
    assert np.abs(ssim_gradient(a, a)[1]).max() < 1e-6


@pytest.mark.thorough
def test_the_gradient_of_ssim_is_its_finite_difference():
    a, b = pictures(14, 17)
    _, gradient = ssim_gradient(a, b)
    assert gradient.shape == a.shape
    rng = np.random.default_rng(1)
    for _ in range(30):
        place = tuple(rng.integers(0, n) for n in a.shape)
        up, down = a.copy(), a.copy()
        up[place] += 1e-5
        down[place] -= 1e-5
        expected = (ssim(up, b) - ssim(down, b)) / 2e-5
        assert gradient[place] == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.thorough
def test_the_gradient_of_ssim_in_float32_is_close_to_that_in_float64():
    a, b = pictures(60, 50)
    _, exact = ssim_gradient(a, b)
    _, ours = ssim_gradient(a.astype(np.float32), b.astype(np.float32))
    assert ours.dtype == np.float32
    assert np.abs(ours - exact).max() <= 1e-4 * np.abs(exact).max()


@pytest.mark.thorough
def test_ssim_is_the_same_for_any_number_of_threads():
    a, b = pictures(90, 80, np.float32)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        value, gradient = ssim_gradient(a, b)
    finally:
        numba.set_num_threads(before)
    again, other = ssim_gradient(a, b)
    assert value == again
    np.testing.assert_array_equal(gradient, other)


def test_psnr_is_the_formula():
    a, b = pictures(9, 8)
    assert psnr(a, b) == pytest.approx(10 * np.log10(1 / np.mean((a - b) ** 2)))
    assert psnr(a, a) == math.inf


def test_pictures_of_two_sizes_are_refused():
    a, _ = pictures(9, 8)
    for measure in (psnr, ssim, ssim_gradient):
        with pytest.raises(ValueError, match="shapes"):
            measure(a, a[1:])
