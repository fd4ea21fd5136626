"""What an encode with a target takes beside a plain one, and how near it comes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from evogs_codec import decode_leaves
from tools.bench.before import encode_seconds, write_subject
from tools.bench.page import Rows
from tools.bench.subjects import Subject

__all__ = ["targets"]

CHECKOUT = Path(__file__).parents[2]
DECIBELS = (32, 36, 40, 44, 48, 52, 56, 60, 65, 70, 75, 80)
SHARES = (0.5, 0.75, 1.5, 2.5, 5.0)  # of the bytes of the plain encode
TURNS, FEW = 3, 100_000  # turns; one with more splats


def targets(subjects: Sequence[Subject], folder: Path) -> Rows:
    """Encodes with a target, beside a plain one.

    Seconds are of the processor, in processes of their own that have one processor: medians of
    three turns, or one of more than 100,000 splats. Reading the file and loading libraries come
    before, what numba loads when it first runs does not. PSNR is over 24 views.
    """
    rows: Rows = []
    for subject in subjects:
        path, out = write_subject(subject, folder), folder / "target.evogs"
        encode_seconds(subject, CHECKOUT, path, out)  # numba compiles what it has not yet
        size = out.stat().st_size
        asked: list[dict[str, float]] = [{}]
        asked += [{"target_psnr": decibels} for decibels in DECIBELS]
        asked += [{"target_bytes": int(share * size)} for share in SHARES]
        seconds: list[list[float]] = [[] for _ in asked]
        reached: list[tuple[int, float]] = []
        for turn in range(TURNS if subject.tree.n_leaves <= FEW else 1):
            for options, own in zip(asked, seconds, strict=True):
                own.append(encode_seconds(subject, CHECKOUT, path, out, **options))
                if not turn:
                    data = out.read_bytes()
                    reached.append((len(data), subject.views.psnr(decode_leaves(data))))
        plain = median(seconds[0])
        for options, own, (n_bytes, decibels) in zip(asked, seconds, reached, strict=True):
            row = {
                "scene": subject.name,
                "splats": subject.tree.n_leaves,
                "target": _said(options),
                "bytes": n_bytes,
                "PSNR, dB": f"{decibels:.2f}",
                "s": f"{median(own):.1f}",
                "to plain": f"{median(own) / plain:.2f}",
            }
            rows.append(row)
            print(*row.values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def _said(options: dict[str, float]) -> str:
    """A target, to be read; empty without one."""
    return "".join(
        f"{wanted:,} {'dB' if name == 'target_psnr' else 'bytes'}"
        for name, wanted in options.items()
    )
