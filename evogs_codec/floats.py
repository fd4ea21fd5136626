"""The float view of decoded integers (spec 7.6)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from evogs_codec.compiled import kernels_for
from evogs_codec.directory import Directory
from evogs_codec.splats import F32, F64, GROUP_CHANNELS, I32, I64, SplatParams
from evogs_codec.state import TileState
from evogs_codec.threads import each

__all__ = ["float_rows", "float_view"]

BLOCK = 4096  # splats that are transposed at a time: their channels stay in cache


def float_view(directory: Directory, tiles: Sequence[TileState], sh_degree: int) -> SplatParams:
    """binary32 of (O + X) * 2**-G, rounded once (R-7.6-1), of the live slots."""
    live = [np.flatnonzero(tile.live[: tile.n_slots]) for tile in tiles]
    n, n_sh = sum(len(rows) for rows in live), 3 * (min(sh_degree, directory.sh_degree) + 1) ** 2
    origins = np.zeros(11 + n_sh, np.int64)
    scales = np.empty(11 + n_sh, np.float64)
    for exponent, channels in zip(directory.grid_exponents, GROUP_CHANNELS, strict=True):
        scales[channels] = 2.0**-exponent
    shapes = ((0, (n, 3)), (3, (n, 4)), (7, (n, 3)), (10, (n, 1)), (11, (n, n_sh)))
    parts = [(first, np.empty(shape, np.float32)) for first, shape in shapes]
    write = getattr(kernels_for(n), "float_rows", float_rows)
    begins = list(accumulate(map(len, live), initial=0))

    def view(number: int) -> None:
        x, rows = tiles[number].channels(), live[number]
        own = origins.copy()
        own[0:3] = directory.tiles[tiles[number].tile]["origin"]
        for first, out in parts:
            channels = slice(first, first + out.shape[1])
            to = out[begins[number] : begins[number + 1]]
            write(x[channels], rows, own[channels], scales[channels], to)

    for _ in each(view, range(len(tiles))):
        pass
    means, quats, log_scales, opacity_logits, sh = (out for _, out in parts)
    missing = 3 * (sh_degree + 1) ** 2 - n_sh  # of bands above those of the stream
    if missing:
        sh = np.concatenate([sh, np.zeros((n, missing), np.float32)], 1)
    return SplatParams(
        means, quats, log_scales, opacity_logits[:, 0], sh.reshape(n, (sh_degree + 1) ** 2, 3)
    )


def float_rows(x: I32, rows: I64, origins: I64, scales: F64, out: F32) -> None:
    """out[i, c] = binary32((origins[c] + x[c, rows[i]]) * scales[c]), blockwise.

    |O + X| is below 2**53, so binary64 holds it and the cast is the only rounding.
    """
    for at in range(0, len(rows), BLOCK):
        part = x[:, rows[at : at + BLOCK]] + origins[:, None]
        out[at : at + BLOCK] = (part * scales[:, None]).T
