"""Zstandard levels: the bytes and the time of each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

from evogs_codec import decode_leaves
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.write import write
from tools.bench.measure import least
from tools.bench.subjects import Subject
from tools.bench.surface.fronts import NOISE, better

__all__ = ["efforts"]

Rows = list[dict[str, object]]
EFFORTS = (1, 3, 5, 7, 9, 11, 13, 15, 17, 18, 19, 22)
TURNS = 5


def efforts(of: Sequence[Subject]) -> Rows:
    """Zstandard levels: bytes, time to write the packets of integers that are there, to decode.

    Writing is processor time of all threads, digests included; lifting and quantising come before
    it and are the same at all levels. The last column names a level that is smaller and a
    quarter faster to write.
    """
    rows: Rows = []
    for subject in of:
        tree = subject.best
        tiles = arrange(tree)
        coded = quantise(tiles, tree.n_levels, subject.settings)
        found = []
        for effort in EFFORTS:
            start = time.process_time()
            data = write(coded, zstd_level=effort)
            seconds = time.process_time() - start
            found.append((effort, data, seconds, least(partial(decode_leaves, data), TURNS)))
        points = [(f"{e}", seconds, -float(len(data))) for e, data, seconds, _ in found]
        base = next(len(data) for e, data, _, _ in found if e == subject.settings.zstd_level)
        rows += [
            {
                "scene": subject.name,
                "--effort": effort,
                "bytes a splat": f"{len(data) / tree.n_leaves:.3f}",
                "to the default": f"{len(data) / base:.3f}",
                "write, s": f"{seconds:.2f}",
                "decode, ms": f"{1000 * decode:.1f}",
                "dominated by": other,
            }
            for (effort, data, seconds, decode), other in zip(
                found, better(points, NOISE), strict=True
            )
        ]
    return rows
