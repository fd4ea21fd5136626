"""Scenes turned from one frame into another: positions, orientations and SH bands.

A frame is named by three letters, the directions of x, y and z: RDF is right, down, forward. The
numbers of a `.ply` are taken as RDF, the axes of the common trainers; all readers return these.

Letters: N splats, K SH coefficients, S directions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from evogs_codec._generated import registry
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, SplatParams

__all__ = ["PLY_FRAME", "frame_of", "info_of_frame", "rotated_by", "transformed", "turn"]

PLY_FRAME = "RDF"
OPPOSITE = dict(zip("RLUDFB", "LRDUBF", strict=True))
# The axes in which each SH function above band 0 is odd: it changes its sign with each of them.
ODD_IN = ("y", "z", "x", "xy", "yz", "", "xz", "", "y", "xyz", "y", "z", "x", "z", "x")


def turn(source: str, target: str) -> F64:
    """(3, 3) the matrix that takes coordinates of one frame to those of another; entries 0, ±1."""
    matrix = np.zeros((3, 3))
    for row, letter in enumerate(target):
        for column, other in enumerate(source):
            matrix[row, column] = (other == letter) - (other == OPPOSITE[letter])
    return matrix


def frame_of(info: SceneInfo) -> str:
    """The frame that a scene says it has; that of a `.ply` if it says none."""
    name = registry.name(registry.COORDINATE_SYSTEMS, info.coordinate_system)
    return name if name in registry.COORDINATE_SYSTEMS[1:] else PLY_FRAME


def info_of_frame(info: SceneInfo, source: str) -> SceneInfo:
    """What a scene says that was turned from `source`, where up is known, to the frame of a `.ply`.

    Args:
        info: what else is known.
        source: the frame of the file, which has the letter U or D.
    """
    up = turn(source, PLY_FRAME) @ [(letter == "U") - float(letter == "D") for letter in source]
    axis = int(np.argmax(np.abs(up)))
    name = ("-" if up[axis] < 0 else "+") + "xyz"[axis]
    return replace(
        info,
        coordinate_system=registry.COORDINATE_SYSTEMS.index(PLY_FRAME),
        up_axis=registry.UP_AXES.index(name),
    )


def transformed(splats: SplatParams, linear: F64, offset: F64 | None = None) -> SplatParams:
    """Splats moved by x -> linear @ x + offset.

    Args:
        splats: N splats.
        linear: (3, 3) a rotation or reflection, times a positive factor.
        offset: (3,) added to positions.
    """
    factor = float(np.cbrt(abs(np.linalg.det(linear))))
    matrix = linear / factor
    if np.array_equal(linear, np.eye(3)) and offset is None:
        return splats
    signs = np.diag(matrix)
    if np.array_equal(matrix, np.diag(np.sign(signs))):
        means = splats.means * (signs * factor).astype(np.float32)
        # A covariance R S R' becomes (MRM) S (MRM)': the turn of MRM is about the axis det M n.
        flips = np.array([1, *(np.prod(signs) * signs)], np.float32)
        quats, sh = splats.quats * flips, _with_signs(splats.sh, signs)
    else:
        means = (splats.means @ (linear.T)).astype(np.float32)
        quats = rotated_by(splats.quats, matrix * np.sign(np.linalg.det(matrix)))
        sh = _rotated_sh(splats.sh, matrix)
    if offset is not None:
        means = (means + offset).astype(np.float32)
    log_scales = (
        splats.log_scales if factor == 1 else splats.log_scales + np.float32(np.log(factor))
    )
    return SplatParams(means, quats, log_scales, splats.opacity_logits, sh)


def rotated_by(quats: F32, matrix: F64) -> F32:
    """(N, 4) the rotations w x y z of `quats`, each followed by the rotation of `matrix`."""
    w, x, y, z = _quaternion(matrix)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    turned: F32 = (quats @ left.T).astype(np.float32)
    return turned


def _quaternion(matrix: F64) -> F64:
    """(4,) w x y z of a rotation matrix."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    # Four times the products of each pair of components: the row of the largest has no small root.
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    row = products[int(np.argmax(np.diag(products)))]
    quaternion: F64 = row / np.linalg.norm(row)
    return quaternion


def _with_signs(sh: F32, signs: F64) -> F32:
    """(N, K, 3) coefficients of the mirrored scene: mirrors change only signs of them."""
    by_name = dict(zip("xyz", signs, strict=True))
    flips = [np.prod([by_name[axis] for axis in odd]) for odd in ODD_IN[: sh.shape[1] - 1]]
    flipped: F32 = sh.reshape(len(sh), 3 * sh.shape[1]) * np.repeat([1, *flips], 3).astype(
        np.float32
    )
    return flipped.reshape(sh.shape)


def _rotated_sh(sh: F32, matrix: F64) -> F32:
    """(N, K, 3) coefficients of the turned scene, band by band."""
    directions = np.random.default_rng(0).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    after, before = _functions(directions), _functions(directions @ matrix)
    turned = sh.copy()
    for band in range(1, 4):
        part = slice(band**2, (band + 1) ** 2)
        if band**2 >= sh.shape[1]:
            break
        mixed = np.linalg.lstsq(after[:, part], before[:, part], rcond=None)[0]
        turned[:, part] = np.einsum("jk,nkc->njc", mixed.astype(np.float32), sh[:, part])
    return turned


def _functions(directions: F64) -> npt.NDArray[np.float64]:
    """(S, 16) the SH functions of bands 0 to 3 at unit directions, up to a factor for each band."""
    x, y, z = directions.T
    a, b = 1.0925484305920792, 0.5462742152960396
    c, d = 0.5900435899266435, 2.890611442640554
    xx, yy, zz = x * x, y * y, z * z
    functions = (
        np.ones_like(x),
        -y,
        z,
        -x,
        a * x * y,
        -a * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -a * x * z,
        b * (xx - yy),
        -c * y * (3 * xx - yy),
        d * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -c * x * (xx - 3 * yy),
    )
    return np.stack(functions, axis=1)
