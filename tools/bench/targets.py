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
DECIBELS = (28, 32, 36, 40, 46, 52, 60, 70, 80)
SHARES = (0.5, 0.75, 1.5, 2.5, 5.0)  # of the bytes of the plain encode
TURNS, FEW = 3, 100_000  # turns; scenes of more splats have one


def targets(subjects: Sequence[Subject], folder: Path) -> Rows:
    """Encodes with a target, each after a plain one.

    Seconds are of the processor, in processes of their own that have one processor: medians of
    three turns, or one of more than 100,000 splats. So are the ratios, of a turn each: a machine
    may be slower a minute later. Reading the file and loading libraries come before, what numba
    loads when it first runs does not. PSNR is over 24 views. A target that cannot be met has no
    bytes.
    """
    rows: Rows = []
    for subject in subjects:
        path, out = write_subject(subject, folder), folder / "target.evogs"
        encode_seconds(subject, CHECKOUT, path, out)  # numba compiles what it has not yet
        size = out.stat().st_size
        asked: dict[str, dict[str, float]] = {
            f"{decibels} dB": {"target_psnr": decibels} for decibels in DECIBELS
        }
        of_bytes = (int(share * size) for share in SHARES)
        asked |= {f"{n:,} bytes": {"target_bytes": n} for n in of_bytes}
        seconds: dict[str, list[float]] = {name: [] for name in ("", *asked)}
        ratios: dict[str, list[float]] = {name: [] for name in asked}
        reached: dict[str, bytes] = {}
        for _ in range(TURNS if subject.tree.n_leaves <= FEW else 1):
            for name, options in asked.items():
                for one, given in (("", {}), (name, options)):
                    seconds[one].append(encode_seconds(subject, CHECKOUT, path, out, **given))
                    reached[one] = out.read_bytes()
                ratios[name].append(seconds[name][-1] / seconds[""][-1])
        for name, data in reached.items():
            row: dict[str, object] = {
                "scene": subject.name,
                "splats": subject.tree.n_leaves,
                "target": name,
                "bytes": len(data) or "",
                "PSNR, dB": f"{subject.views.psnr(decode_leaves(data)):.2f}" if data else "",
                "s": f"{median(seconds[name]):.1f}",
                "to plain": f"{median(ratios[name]) if name else 1:.2f}",
            }
            rows.append(row)
            print(*row.values(), sep=", ", file=sys.stderr, flush=True)
    return rows
