"""Wrong renderers, each with one line of meaning of the oracle changed; and right ones.

Each wrong one must fail a picture, each right one must pass all. `says` ends "a renderer in which".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conformance.renders.png import Pixels
from conformance.renders.reference import to_pixels
from conformance.renders.rendering import Rendering

__all__ = ["RIGHT", "WRONG"]

TO_CAMERA = "    x, y, z = camera.rotation @ mean + camera.translation\n"
TAKES = "        takes = counts & (rest >= T_MIN)\n"
COUNTS = "        counts = is_open & (alpha >= ALPHA_MIN)\n"
ALPHA = "        alpha = np.minimum(options.alpha_max, reached)\n"
ADDS = "        image += np.where(takes, alpha * transmittance, 0.0)[..., None] * splat.colour\n"
ENDS = "    image += transmittance[..., None] * np.asarray(background, np.float64)\n"
CENTERS = "    y, x = np.mgrid[: camera.height, : camera.width] + 0.5\n"
SORTS = "    projected.sort(key=lambda splat: splat.depth)\n"
NEAR = "    if not z > options.near:\n"
DILATION = "        e = options.dilation\n"
DIRECTION = "    direction = mean - camera.position\n"
COLOR = "    return np.maximum(0.0, np.array(basis[: len(sh)]) @ sh + 0.5)\n"
SLOPE_X = "    tx = z * np.clip(x / z, left - margin_x, right + margin_x)\n"
SLOPE_Y = "    ty = z * np.clip(y / z, top - margin_y, bottom + margin_y)\n"
QUAT = "    w, x, y, z = quat / norm if norm > 0 else (1.0, 0.0, 0.0, 0.0)\n"
CENTER = (
    "        center = np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])\n"
)
AXES = (
    "        u, v = _projection_matrix(camera, x, y, z) @ _rotation(quat)"
    " @ np.diag(np.exp(log_scale))\n"
)
AREA = "            opacity *= math.sqrt(max(0.0, flat / determinant))\n"
SIGMA = "        sigma: F64 = 0.5 * (across * across * (yy / splat.determinant) + dy * dy / yy)\n"
BASIS_1 = (
    "        -0.4886025119029199 * y,\n"
    "        0.4886025119029199 * z,\n"
    "        -0.4886025119029199 * x,\n"
)
BASIS_6 = "        0.31539156525252005 * (2 * zz - xx - yy),\n"
BASIS_10 = "        2.890611442640554 * x * y * z,\n"
BASIS_15 = "        -0.5900435899266435 * x * (xx - 3 * yy),\n"
PROJECTED = (
    "        return Projected("
    "center, covariance, determinant, _colour(mean, sh, camera), opacity, z)\n"
)


def _truncated(image: npt.NDArray[np.float64]) -> Pixels:
    return np.asarray(np.clip(image, 0, 1) * 255, np.uint8)


def _sixteen_bits(image: npt.NDArray[np.float64]) -> Pixels:
    return to_pixels(image, np.uint16)


def _in(line: str, old: str, new: str) -> tuple[str, str]:
    """An edit of a part of a line."""
    return line, line.replace(old, new)


def _wrong(name: str, says: str, *edits: tuple[str, str]) -> Rendering:
    return Rendering(name, says, edits)


WRONG = (
    _wrong("no-dilation", "footprints are not dilated", (DILATION, "        e = 1e-9\n")),
    _wrong("dilation-0.1", "the dilation is 0.1, not 0.3", (DILATION, "        e = 0.1\n")),
    _wrong(
        "dilated-twice",
        "the dilation is a deviation of 0.3, not a variance",
        (DILATION, "        e = 0.09\n"),
    ),
    _wrong(
        "sh1-sign",
        "the signs of the first SH band are missing",
        _in(BASIS_1, "-0", "0"),
    ),
    _wrong(
        "sh1-order",
        "the first SH band is in the order x, y, z",
        (BASIS_1, "".join(BASIS_1.splitlines(True)[i] for i in (2, 0, 1))),
    ),
    _wrong("sh2-sign", "Y6 has the other sign", _in(BASIS_6, "0.3", "-0.3")),
    _wrong("sh3-factor", "Y10 has half its factor", _in(BASIS_10, "2.89", "1.44")),
    _wrong("sh3-sign", "Y15 has the other sign", _in(BASIS_15, "-0.5", "0.5")),
    _wrong(
        "sh-degree-2",
        "SH of degree 3 are left out",
        (COLOR, COLOR.replace("@ sh +", "@ sh[:9] +").replace("len(sh)", "min(9, len(sh))")),
    ),
    _wrong(
        "sh-opposite",
        "colours are those of the opposite direction",
        (DIRECTION, "    direction = camera.position - mean\n"),
    ),
    _wrong(
        "sh-of-camera",
        "directions of colours are those of the camera, not of the world",
        (DIRECTION, "    direction = camera.rotation @ (mean - camera.position)\n"),
    ),
    _wrong(
        "sh-one-direction",
        "all splats have the direction of the middle of the view",
        (DIRECTION, "    direction = camera.rotation[2]\n"),
    ),
    _wrong(
        "colour-to-one",
        "colours are clamped to 1",
        (COLOR, "    return np.clip(np.array(basis[: len(sh)]) @ sh + 0.5, 0.0, 1.0)\n"),
    ),
    _wrong(
        "colour-below-zero",
        "colours are not clamped at 0",
        (COLOR, "    return np.asarray(np.array(basis[: len(sh)]) @ sh + 0.5)\n"),
    ),
    _wrong(
        "ties-reversed",
        "of equal depths, the last slot is drawn first",
        (SORTS, "    projected = sorted(projected[::-1], key=lambda splat: splat.depth)\n"),
    ),
    _wrong(
        "children-together",
        "the children of a split are neighbours in the order of slots",
        (
            SORTS,
            "    half = len(projected) // 2\n"
            "    projected = [projected[i // 2 + i % 2 * half] for i in range(2 * half)]"
            " + projected[2 * half :]\n" + SORTS,
        ),
    ),
    _wrong(
        "depth-8-bit",
        "depths are sorted in 256 buckets",
        (
            SORTS,
            "    deepest = max((splat.depth for splat in projected), default=1.0)\n"
            "    projected.sort(key=lambda splat: int(255 * splat.depth / deepest))\n",
        ),
    ),
    _wrong(
        "by-distance",
        "splats are sorted by distance, not by depth",
        (PROJECTED, "        z = float(np.linalg.norm([x, y, z]))\n" + PROJECTED),
    ),
    _wrong(
        "unsorted",
        "splats are drawn in order of slots",
        (SORTS, "    projected.sort(key=lambda _: 0)\n"),
    ),
    _wrong(
        "back-to-front",
        "splats are drawn from back to front",
        (SORTS, "    projected.sort(key=lambda splat: -splat.depth)\n"),
    ),
    _wrong("near-0.01", "the near plane is at 0.01", (NEAR, "    if not z > 0.01:\n")),
    _wrong(
        "at-near", "what is at the near plane is drawn", (NEAR, "    if not z >= options.near:\n")
    ),
    _wrong("no-near", "there is no near plane", (NEAR, "    if z == 0:\n")),
    _wrong(
        "three-sigma",
        "splats end at three deviations",
        (ALPHA, "        reached = np.where(_sigma(splat, x, y) > 4.5, 0.0, reached)\n" + ALPHA),
    ),
    _wrong(
        "three-sigma-square",
        "splats end at a square of three times their largest deviation",
        (
            ALPHA,
            "        half = 3 * math.sqrt(np.linalg.eigvalsh(splat.covariance)[1])\n"
            "        far = np.maximum(abs(x - splat.center[0]), abs(y - splat.center[1])) > half\n"
            "        reached = np.where(far, 0.0, reached)\n" + ALPHA,
        ),
    ),
    _wrong(
        "at-most-64-pixels",
        "splats end 32 pixels from their centre",
        (
            ALPHA,
            "        far = np.maximum(abs(x - splat.center[0]), abs(y - splat.center[1])) > 32\n"
            "        reached = np.where(far, 0.0, reached)\n" + ALPHA,
        ),
    ),
    _wrong(
        "centre-culled",
        "splats whose centre is out of the picture are left out",
        (
            CENTER,
            CENTER
            + "        if not (0 <= center[0] < camera.width and 0 <= center[1] < camera.height):\n"
            "            return None\n",
        ),
    ),
    _wrong(
        "alpha-0.999", "alpha is at most 0.999, not 0.99", _in(ALPHA, "options.alpha_max", "0.999")
    ),
    _wrong("alpha-1", "alpha is not clamped", _in(ALPHA, "options.alpha_max", "1.0")),
    _wrong("no-cut", "alphas below 1/255 are not skipped", _in(COUNTS, "ALPHA_MIN", "1e-9")),
    _wrong("cut-0.01", "alphas below 0.01 are skipped", _in(COUNTS, "ALPHA_MIN", "0.01")),
    _wrong("never-closed", "pixels do not close", _in(TAKES, "T_MIN", "0")),
    _wrong("closed-early", "pixels close at a transmittance of 0.001", _in(TAKES, "T_MIN", "1e-3")),
    _wrong(
        "closing-drawn",
        "the splat that closes a pixel is drawn",
        (TAKES, "        takes = counts & (transmittance >= T_MIN)\n"),
    ),
    _wrong("half-pixel", "pixel centres are at whole numbers", _in(CENTERS, " + 0.5", " + 0.0")),
    _wrong(
        "flipped",
        "y points up",
        (CENTERS, CENTERS + "    y = camera.height - y\n"),
    ),
    _wrong(
        "xyzw",
        "quaternions are read x y z w",
        (
            QUAT,
            QUAT.replace("w, x, y, z =", "x, y, z, w =").replace(
                "(1.0, 0.0, 0.0, 0.0)", "(0.0, 0.0, 0.0, 1.0)"
            ),
        ),
    ),
    _wrong(
        "transposed", "rotations are transposed", _in(AXES, "_rotation(quat)", "_rotation(quat).T")
    ),
    _wrong(
        "not-normalised",
        "quaternions are not normalised",
        (QUAT, "    w, x, y, z = quat if norm > 0 else (1.0, 0.0, 0.0, 0.0)\n"),
    ),
    _wrong(
        "zero-quat",
        "splats with a zero quaternion are left out",
        (AXES, "        if not quat.any():\n            return None\n" + AXES),
    ),
    _wrong(
        "scale-squared",
        "scales are taken for variances",
        _in(AXES, "np.exp(log_scale)", "np.exp(0.5 * log_scale)"),
    ),
    _wrong(
        "orthographic",
        "footprints are not sheared towards the border",
        (SLOPE_X, "    tx = 0.0\n"),
        (SLOPE_Y, "    ty = 0.0\n"),
    ),
    _wrong(
        "no-slope-clamp",
        "slopes are not clamped",
        (SLOPE_X, "    tx = x\n"),
        (SLOPE_Y, "    ty = y\n"),
    ),
    _wrong(
        "slope-clamp-centred",
        "slopes are clamped as if the principal point were in the middle",
        (
            SLOPE_X,
            "    left, right = -camera.width / 2 / camera.fx, camera.width / 2 / camera.fx\n"
            "    top, bottom = -camera.height / 2 / camera.fy, camera.height / 2 / camera.fy\n"
            + SLOPE_X,
        ),
    ),
    _wrong(
        "principal-point",
        "the principal point is the middle of the picture",
        (
            CENTER,
            CENTER.replace("camera.cx", "camera.width / 2").replace(
                "camera.cy", "camera.height / 2"
            ),
        ),
    ),
    _wrong("one-focal-length", "fy is taken to be fx", _in(CENTER, "camera.fy", "camera.fx")),
    _wrong("not-antialiased", "the antialiased mode is ignored", (AREA, "            pass\n")),
    _wrong(
        "antialiased-squared",
        "the compensation lacks its square root",
        (AREA, "            opacity *= max(0.0, flat / determinant)\n"),
    ),
    _wrong(
        "always-antialiased",
        "opacity is always compensated",
        ("        if options.antialiased:\n", "        if True:\n"),
    ),
    _wrong("sigma-doubled", "the exponent lacks its factor 1/2", _in(SIGMA, "0.5 *", "1.0 *")),
    _wrong(
        "float32-view",
        "positions meet the view matrix in float32",
        (
            TO_CAMERA,
            # Not `@`, whose last bits depend on the processor.
            "    r, p = camera.rotation.astype(np.float32), mean.astype(np.float32)\n"
            "    turned = r[:, 0] * p[0] + r[:, 1] * p[1] + r[:, 2] * p[2]\n"
            "    x, y, z = turned + camera.translation.astype(np.float32)\n",
        ),
    ),
    _wrong("black-background", "the background is black", (ENDS, "    image += 0.0\n")),
    _wrong(
        "background-added",
        "the background is added without the transmittance",
        _in(ENDS, "transmittance[..., None] * ", ""),
    ),
    _wrong(
        "gamma",
        "pixels are raised to 1/2.2",
        (ENDS, ENDS + "    image = np.maximum(image, 0) ** (1 / 2.2)\n"),
    ),
    _wrong(
        "8-bit-blending",
        "colours are rounded to 8 bits after each splat",
        (ADDS, ADDS + "        image = np.rint(np.clip(image, 0, 1) * 255) / 255\n"),
    ),
    _wrong("bgr", "red and blue are exchanged", (ENDS, ENDS + "    image = image[..., ::-1]\n")),
    Rendering(
        "finest-level",
        "the finest level is drawn, whatever was asked",
        level=lambda _asked, last: last,
    ),
    Rendering(
        "next-level",
        "the level after the one that was asked is drawn",
        level=lambda asked, last: min(asked + 1, last),
    ),
)

_TO_FLOAT32 = (
    (
        TO_CAMERA,
        "    mean = (mean - camera.position).astype(np.float32)\n"
        "    x, y, z = camera.rotation.astype(np.float32) @ mean\n"
        "    quat, log_scale, sh = (array.astype(np.float32) for array in (quat, log_scale, sh))\n",
    ),
    (DIRECTION, "    direction = mean\n"),
    (
        "    return jacobian @ camera.rotation\n",
        "    return jacobian.astype(np.float32) @ camera.rotation.astype(np.float32)\n",
    ),
    (CENTERS, CENTERS + "    y, x = y.astype(np.float32), x.astype(np.float32)\n"),
    (
        "    image = np.zeros((camera.height, camera.width, 3))\n",
        "    image = np.zeros((camera.height, camera.width, 3), np.float32)\n",
    ),
    (
        "    transmittance = np.ones((camera.height, camera.width))\n",
        "    transmittance = np.ones((camera.height, camera.width), np.float32)\n",
    ),
    (CENTER, CENTER.rstrip(")\n") + ", np.float32)\n"),
    _in(SIGMA, "yy / splat.determinant", "yy / np.float32(splat.determinant)"),
    _in(ADDS, "splat.colour", "splat.colour.astype(np.float32)"),
    _in(ENDS, "float64", "float32"),
)

RIGHT = (
    Rendering("oracle", "the oracle itself"),
    Rendering("truncating", "rounds down to 8 bits", convert=_truncated),
    Rendering("16-bit", "writes 16 bits", convert=_sixteen_bits),
    Rendering(
        "float16",
        "blends in float16",
        ((ADDS, ADDS + "        image = image.astype(np.float16).astype(np.float64)\n"),),
    ),
    Rendering(
        "float32", "computes everything behind the position of the camera in float32", _TO_FLOAT32
    ),
)
