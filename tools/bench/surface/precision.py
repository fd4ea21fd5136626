"""The rasterizer in float32 and in float64, and the exponentials inside."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numba
import numpy as np
import numpy.typing as npt
from numba.np.unsafe.ndarray import to_fixed_tuple

from evogs_codec.render import psnr, render
from evogs_codec.render.compiled import POWERS, exp2
from tools.bench.measure import least
from tools.bench.subjects import WHITE, Subject

__all__ = ["exponentials", "precisions"]

Rows = list[dict[str, object]]
Real = npt.NDArray[np.floating]
TURNS = 5
N_VIEWS = 6
N = 1 << 16  # exponents
LN2 = math.log(2)
N_POWERS = len(POWERS)


def precisions(of: Sequence[Subject]) -> Rows:
    """Pictures in float32 and float64: processor time, and how far apart they are.

    float32 has the fast exponential, float64 that of the C library. Projection is float64 in both.
    The other thresholds, 1 / 255 for an alpha and 1e-4 for what is left of the background, and the
    boxes of tiles that follow from them are part of the definition: there is no other path.
    """
    rows: Rows = []
    for subject in of:
        leaves = subject.tree.leaves()
        exact: dict[int, Real] = {}
        found: dict[str, list[float]] = {"float64": [], "float32": []}
        worst = dict.fromkeys(found, 0.0)
        cameras = subject.gauge.cameras[:: max(1, len(subject.gauge.cameras) // N_VIEWS)]
        for dtype in found:
            for k, camera in enumerate(cameras):
                picture = render(leaves, camera, WHITE, dtype=dtype)
                exact.setdefault(k, picture)
                found[dtype].append(psnr(picture, exact[k]))
                worst[dtype] = max(worst[dtype], float(np.abs(picture - exact[k]).max()))
        draw = {dtype: partial(render, leaves, cameras[0], WHITE, dtype=dtype) for dtype in found}
        times = {dtype: least(run, TURNS) for dtype, run in draw.items()}
        rows += [
            {
                "scene": subject.name,
                "numbers": dtype,
                "picture, ms": f"{1000 * times[dtype]:.1f}",
                "to float32": f"{times[dtype] / times['float32']:.2f}",
                "PSNR to float64, dB": f"{np.mean(found[dtype]):.1f}",
                "largest difference": f"{worst[dtype]:.2g}",
            }
            for dtype in found
        ]
    return rows


def exponentials() -> Rows:
    """The exponential of the kernels and that of the C library, in loops of their own.

    2**t over 65,536 exponents between -8 and 0, which is where alphas are seen. The compiler makes
    vector code of the fast one alone.
    """
    t64 = np.linspace(-8, 0, N)
    right = np.exp2(t64)
    rows: Rows = []
    powers = np.array(POWERS, np.float32)
    for name, run, t in (
        ("fast, float32", partial(_fast, powers=powers), t64.astype(np.float32)),
        ("C library, float32", _library, t64.astype(np.float32)),
        ("C library, float64", _library, t64),
    ):
        out = np.empty_like(t)
        seconds = least(partial(run, t, out), 50)
        # Of float32 the exponents too are rounded, which is no fault of the exponential.
        true = np.exp2(t.astype(np.float64)) if t.dtype == np.float32 else right
        rows.append(
            {
                "exponential": name,
                "ns": f"{1e9 * seconds / N:.2f}",
                "largest relative error": f"{float(np.abs(out / true - 1).max()):.1e}",
            }
        )
    return rows


@numba.njit(fastmath=True)  # type: ignore[untyped-decorator]
def _fast(t: Real, out: Real, powers: Real) -> None:
    values = to_fixed_tuple(powers, N_POWERS)
    for i in range(len(t)):
        out[i] = exp2(t[i], values)


@numba.njit(fastmath=True)  # type: ignore[untyped-decorator]
def _library(t: Real, out: Real) -> None:
    for i in range(len(t)):
        out[i] = math.exp(t[i] * t.dtype.type(LN2))
