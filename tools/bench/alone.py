"""What levels and layers cost: streams beside those of the same splats alone."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from evogs_codec import decode_leaves, encode_scene
from evogs_codec.encoding.settings import TREE_PSNR
from tools.bench.page import Rows
from tools.bench.subjects import Subject

__all__ = ["alone"]

AROUND = (-0.4, 0.4)  # dB, from the PSNR of the stream: of the splats alone


def alone(of: Sequence[Subject]) -> Rows:
    """Bytes with all levels and layers, and of the splats alone at the same PSNR.

    The stream is that of `evogs encode` without options; of a trained tree at 52 dB, its default.
    The splats alone are two streams with `--levels 1 --layers 1 --target-psnr`, 0.4 dB below and
    above the PSNR of the stream. A line through the logarithms of their bytes says what the PSNR
    takes. PSNR is against the scene, or the leaves of the tree, over the 24 views by which streams
    are made.
    """
    rows: Rows = []
    for subject in of:
        data = subject.encoded(target_psnr=None if subject.is_scene else TREE_PSNR)
        reached = _psnr(subject, data)
        pairs = [_alone(subject, reached + way) for way in AROUND]
        decibels, sizes = np.array(sorted(pairs)).T
        slope = np.diff(np.log(sizes))[0] / np.diff(decibels)[0]
        n_alone = np.exp(np.log(sizes[0]) + slope * (reached - decibels[0]))
        rows.append(
            {
                "scene": subject.name,
                "splats": subject.tree.n_leaves,
                "PSNR, dB": f"{reached:.2f}",
                "bytes": len(data),
                "bytes of the splats alone": round(n_alone),
                "to the splats alone": f"{len(data) / n_alone:.2f}",
            }
        )
        print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def _alone(subject: Subject, decibels: float) -> tuple[float, int]:
    """PSNR and bytes of the splats alone, at about so many dB."""
    splats = subject.views.scene
    data = encode_scene(splats, levels=1, layers=1, target_psnr=decibels, up=subject.up)
    return _psnr(subject, data), len(data)


def _psnr(subject: Subject, data: bytes) -> float:
    return subject.views.psnr(decode_leaves(data))
