"""Depth: how many levels pay for small scenes."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

import numpy as np

from evogs_codec import SplatParams, decode_leaves, encode_scene
from evogs_codec.lifting.lift import N_LEVELS, default_levels
from evogs_codec.render import Views
from tools.bench.measure import seconds_text
from tools.bench.page import Rows
from tools.bench.subjects import Subject

__all__ = ["depth"]

N_SPLATS = (500, 1_000, 2_000, 4_000, 8_000, 16_000)
SEEDS = (1, 2)
SLOPE = 14.0  # dB of a stream to the logarithm of its bytes, from 30 to 65 dB about


def depth(of: Sequence[Subject]) -> Rows:
    """Parts of scenes with as many levels as by default, and with five.

    Each part is the splats nearest to one that is chosen at random; of each number two are made,
    and bytes, PSNR and seconds are their means. Streams are of `evogs encode` without other
    options. PSNR is over the 24 views by which they are made; bytes at equal PSNR take 14 dB to be
    e times the bytes. Seconds are those of the processor.
    """
    rows: Rows = []
    for subject in of:
        scene = subject.views.scene
        for n_splats in (n for n in N_SPLATS if subject.is_scene and n < len(scene)):
            levels = {default_levels(n_splats), N_LEVELS}
            parts = [_part(scene, n_splats, seed) for seed in SEEDS]
            found = {n: np.mean([_encoded(part, n) for part in parts], axis=0) for n in levels}
            of_five = found[N_LEVELS]
            for n, (n_bytes, decibels, seconds) in sorted(found.items()):
                ratio = n_bytes / of_five[0] * math.exp((of_five[1] - decibels) / SLOPE)
                rows.append(
                    {
                        "scene": subject.name,
                        "splats": n_splats,
                        "levels": n,
                        "bytes": round(n_bytes),
                        "PSNR, dB": f"{decibels:.2f}",
                        "to five levels, at equal PSNR": f"{ratio:.2f}",
                        "encode, s": seconds_text(seconds),
                    }
                )
                print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def _part(scene: SplatParams, n_splats: int, seed: int) -> SplatParams:
    """The splats nearest to one."""
    center = scene.means[np.random.default_rng(seed).integers(len(scene))]
    away = np.square(scene.means - center).sum(axis=1)
    return scene.take(np.sort(np.argsort(away, kind="stable")[:n_splats]))


def _encoded(splats: SplatParams, n_levels: int) -> tuple[int, float, float]:
    """Bytes, PSNR in dB, and seconds of the processor."""
    start = time.process_time()
    data = encode_scene(splats, levels=n_levels)
    seconds = time.process_time() - start
    return len(data), Views.of(splats).psnr(decode_leaves(data)), seconds
