"""Targets of small scenes with odd statistics: how long they take, and what their prefixes lose."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from evogs_codec import InputError, SplatParams, encode_scene
from tools.bench.falls import fallen, odd_scenes
from tools.bench.measure import seconds_text
from tools.bench.page import Rows

__all__ = ["small_targets"]

SCENES = ((4_000, 29), (8_000, 30))  # splats and seeds on which nothing was tuned
DECIBELS = (30, 38, 46, 58)
SHARES = (0.5, 2.0)  # of the bytes of the plain encode


def small_targets(scenes: Sequence[tuple[int, int]] = SCENES) -> Rows:
    """Encodes with a target: the processor time of each, in times of the plain encode.

    The scenes are those of `falls`, without the planes. All are encoded in one process, the first
    of them twice, since compiled loops are loaded by then. Without times, a target cannot be met.
    Falls are over 24 views of 300 pixels: that of the plain encode, and the deepest of all encodes
    with a target.
    """
    rows: Rows = []
    for n_splats, seed in scenes:
        for name, splats in odd_scenes(n_splats, seed):
            if name == "black plane":
                continue
            if not rows:
                _measured(splats)
            rows.append({"scene": name, "splats": len(splats)} | _measured(splats))
            print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def _measured(splats: SplatParams) -> dict[str, object]:
    data, seconds = _timed(splats)
    asked: dict[str, dict[str, float]] = {
        f"{decibels} dB": {"target_psnr": decibels} for decibels in DECIBELS
    }
    asked |= {f"{share:g} of bytes": {"target_bytes": int(share * len(data))} for share in SHARES}
    row: dict[str, object] = {"bytes": len(data), "encode, s": seconds_text(seconds)}
    falls = [0.0]
    for target, options in asked.items():
        made, its = _timed(splats, **options)
        row[target] = f"{its / seconds:.2f}" if made else ""
        falls += [_fall(made, splats)] if made else []
    return row | {"fall, dB": f"{_fall(data, splats):.2f}", "with targets": f"{max(falls):.2f}"}


def _timed(splats: SplatParams, **options: float) -> tuple[bytes, float]:
    """A stream, or nothing if the target cannot be met; and processor time, s."""
    start = time.process_time()
    try:
        data = encode_scene(splats, **options)  # type: ignore[arg-type]
    except InputError:
        data = b""
    return data, time.process_time() - start


def _fall(data: bytes, splats: SplatParams) -> float:
    return float(str(fallen(data, splats)["deepest fall, dB"]))
