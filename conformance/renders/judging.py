"""Whether a picture is the golden one, with numbers. numpy only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conformance.renders.manifest import Image, Suite
from conformance.renders.png import Pixels, decode_png

__all__ = ["Golden", "Numbers", "judge", "read_golden", "read_picture", "side_by_side"]

F64 = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
ROUNDED = 40.0  # dB; levels this close differ by rounding to 8 bits, or down
GOLDEN_ROUNDING = 0.5 / 255
AMPLIFIED = 16  # errors in pictures of differences
ENLARGED = 3
GAP = 4  # pixels
DOUBTFUL_GREY = 0.25


@dataclass(frozen=True, eq=False)
class Golden:
    """A golden picture.

    Attributes:
        image: (H, W, 3), white is 1.
        stable: (H, W) pixels that are judged.
        finest: (H, W, 3) golden of the finest level; None: this is it.
    """

    image: F64
    stable: Bools
    finest: F64 | None


@dataclass(frozen=True)
class Numbers:
    """How far a picture is from the golden one.

    Attributes:
        error: largest of a channel at a stable pixel, beyond rounding; white is 1.
        at: (x, y) of that pixel.
        n_over: stable pixels over the threshold.
        n_doubtful_over: doubtful pixels over it, which do not count.
        psnr: of the stable pixels, dB.
        level_psnr: against the golden of the finest level, dB; None at that level.
        failures: sentences; none: it passes.
    """

    error: float
    at: tuple[int, int]
    n_over: int
    n_doubtful_over: int
    psnr: float
    level_psnr: float | None
    failures: tuple[str, ...]


def judge(image: Image, golden: Golden, pixels: Pixels) -> Numbers:
    """Compare a candidate's pixels, (H, W, 3 or 4) of 8 or 16 bits, with a golden picture."""
    limits = image.thresholds
    picture = as_floats(pixels)
    rounding = GOLDEN_ROUNDING + 0.5 / np.iinfo(pixels.dtype).max
    difference = np.abs(picture - golden.image)
    error = np.maximum(0, difference.max(2) - rounding)
    # Two files of 8 bits differ by whole steps: a sum of halves must not be a hair less.
    over = error > limits.max_error + 1e-9
    y, x = np.unravel_index(np.argmax(np.where(golden.stable, error, -1)), error.shape)
    worst = float(error[y, x]) if golden.stable.any() else 0.0
    n_over = int(np.count_nonzero(over & golden.stable))
    found = _psnr(difference[golden.stable])
    level = None if golden.finest is None else _psnr(picture - golden.finest)

    failures = []
    if n_over > limits.max_over:
        seen, wanted = (" ".join(f"{v:.4f}" for v in p[y, x]) for p in (picture, golden.image))
        failures.append(
            f"{n_over} stable pixels are off by more than {limits.max_error:.4f}"
            f" ({limits.max_over} may be); the worst, x {x} y {y}, is {seen}, not {wanted}"
        )
    if found < limits.min_psnr:
        failures.append(f"PSNR {found:.2f} dB is below {limits.min_psnr:g} dB")
    if level is not None and _apart(level, image.level_psnr or 0) > limits.level_psnr:
        failures.append(
            f"against the finest level it has {level:.2f} dB, not {image.level_psnr} dB"
        )
    return Numbers(
        worst,
        (int(x), int(y)),
        n_over,
        int(np.count_nonzero(over & ~golden.stable)),
        found,
        level,
        tuple(failures),
    )


def read_golden(suite: Suite, image: Image) -> Golden:
    """The golden picture of an image; its alpha is 0 where a pixel is doubtful."""
    pixels = read_picture(suite.golden(image), image)
    finest = suite.finest(image)
    best = None
    if finest is not image:
        best = as_floats(read_picture(suite.golden(finest), finest))
    return Golden(as_floats(pixels), pixels[..., 3] > 0, best)


def read_picture(data: bytes, image: Image) -> Pixels:
    """The pixels of a PNG file for this image.

    Raises:
        PngError: it is not one that can be judged.
    """
    return decode_png(data, width=image.camera["width"], height=image.camera["height"])


def as_floats(pixels: Pixels) -> F64:
    """R G B, white is 1; alpha is left out."""
    return pixels[..., :3].astype(np.float64) / np.iinfo(pixels.dtype).max


def side_by_side(golden: Golden, pixels: Pixels | None) -> npt.NDArray[np.uint8]:
    """Golden, candidate, and 16 times their difference; doubtful pixels are grey in the last."""
    picture = np.zeros_like(golden.image) if pixels is None else as_floats(pixels)
    difference = np.minimum(1, AMPLIFIED * np.abs(picture - golden.image))
    difference[~golden.stable] = DOUBTFUL_GREY
    gap = np.ones((len(picture), GAP, 3))
    strip = np.concatenate([golden.image, gap, picture, gap, difference], 1)
    large = np.repeat(np.repeat(strip, ENLARGED, 0), ENLARGED, 1)
    return np.asarray(np.rint(large * 255), np.uint8)


def _apart(a: float, b: float) -> float:
    """Difference of two PSNR of a level, dB, as far as rounding to 8 bits does not make it."""
    return abs(min(a, ROUNDED) - min(b, ROUNDED))


def _psnr(difference: F64) -> float:
    """Of differences with peak 1, dB; infinite where there are none."""
    error = float(np.mean(np.square(difference))) if difference.size else 0.0
    return math.inf if error == 0 else -10 * math.log10(error)
