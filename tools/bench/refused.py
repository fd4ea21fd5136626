"""Targets that cannot be met: how long an answer takes, and how near its estimates are."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from evogs_codec import decode_leaves, write_ply, write_tree
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.layers import N_LAYERS
from tools.bench.measure import Cost, cost
from tools.bench.page import Rows
from tools.bench.subjects import Subject, aim_of

__all__ = ["refused"]

FINEST, COARSEST = PRICES
# Options of targets, the price of a bit at the end of the range that they are beyond, and the words
# that name this end.
TARGETS = (
    ({"target_psnr": 115}, FINEST, r"to ([\d.]+) dB"),
    ({"target_psnr": 5}, COARSEST, r"([\d.]+) to [\d.]+ dB"),
    ({"target_bytes": 10**10}, FINEST, r"to ([\d,]+) bytes"),
    ({"target_bytes": 1000}, COARSEST, r"([\d,]+) to [\d,]+ bytes"),
)
READ = "from evogs_codec import *\nscene = {read}({path!r})"
ENCODE = """
try:
    {encode}(scene, up={up!r}, **{target})
    said = ''
except TargetMissedError as error:
    said = str(error)
"""
KEEP = "open({out!r}, 'w').write(said)"


def refused(subjects: Sequence[Subject], folder: Path) -> Rows:
    """What `evogs encode` says of impossible targets, in processes of their own.

    Seconds are of the clock, and of the processor beside them; reading the file and loading
    libraries come before, what numba loads when it first runs does not. The end that is named is an
    estimate from few splats; the measured one is that of a whole stream, over 24 views: of the tree
    with a palette, where there is one.
    """
    rows: Rows = []
    for subject in subjects:
        ends = dict(zip(PRICES, _ends(subject), strict=True))
        for target, price, words in TARGETS:
            taken, said = _answer(subject, target, folder)
            (name, wanted), named = *target.items(), re.search(words, said)
            is_psnr = name == "target_psnr"
            measured = f"{ends[price][0]:.1f}" if is_psnr else f"{ends[price][1]:,}"
            rows.append(
                {
                    "scene": subject.name,
                    "splats": subject.tree.n_leaves,
                    "target": f"{wanted:,} {'dB' if is_psnr else 'bytes'}",
                    "seconds": f"{taken.seconds:.1f}",
                    "processor, s": f"{taken.processor:.1f}",
                    "end that is named": named[1] if named else "",
                    "measured": measured,
                }
            )
            print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def _answer(subject: Subject, target: dict[str, int], folder: Path) -> tuple[Cost, str]:
    """What an encode with a target takes, and what it says if it refuses."""
    path, out = folder / f"{subject.name}-refused.scene", folder / "said.txt"
    if subject.is_scene:
        write_ply(path, subject.views.scene)
    else:
        write_tree(path, subject.tree)
    words = {
        "path": str(path),
        "out": str(out),
        "target": target | ({"levels": subject.tree.n_levels} if subject.is_scene else {}),
        "up": subject.up,
        "read": "read_ply" if subject.is_scene else "read_tree",
        "encode": "encode_scene" if subject.is_scene else "encode_tree",
    }
    taken = cost(ENCODE.format(**words), READ.format(**words), KEEP.format(**words))
    return taken, out.read_text()


def _ends(subject: Subject) -> Iterator[tuple[float, int]]:
    """PSNR, dB, and bytes of whole streams at the ends of the range of prices."""
    aim = aim_of(subject.best, subject.settings, subject.views, layers=N_LAYERS)
    for data in aim.at_prices(PRICES):
        yield subject.views.psnr(decode_leaves(data)), len(data)
