"""What an encode takes beside that of an earlier checkout."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from evogs_codec import write_ply, write_tree
from tools.bench.measure import cost
from tools.bench.page import Rows
from tools.bench.subjects import Subject

__all__ = ["before", "encode_seconds", "write_subject"]

TURNS = 3
# On one processor, so that the time of a thread is not that of waiting for another one.
SETUP = """
import os, sys
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
sys.path.insert(0, {checkout!r})
import evogs_codec
assert evogs_codec.__file__.startswith({checkout!r})
from evogs_codec import *
scene = {read}({path!r})
"""
KEEP = "open({out!r}, 'wb').write(found)"


def before(subjects: Sequence[Subject], checkout: Path, folder: Path) -> Rows:
    """`evogs encode` without options, of an earlier checkout and of this one.

    Seconds are of the processor, in processes of their own that have one processor, which the two
    take in turns: medians of three. Reading the file and loading libraries come before, what numba
    loads when it first runs does not.
    """
    checkouts = checkout, Path(__file__).parents[2]
    rows: Rows = []
    for subject in subjects:
        path, out = write_subject(subject, folder), folder / "before.evogs"
        seconds: tuple[list[float], list[float]] = [], []
        sizes = [0, 0]
        for _ in range(1 + TURNS):  # in the first, numba compiles what it has not yet
            for k, one in enumerate(checkouts):
                seconds[k].append(encode_seconds(subject, one, path, out))
                sizes[k] = out.stat().st_size
        old, now = (median(found[1:]) for found in seconds)
        rows.append(
            {
                "scene": subject.name,
                "splats": subject.tree.n_leaves,
                "before, bytes": sizes[0],
                "bytes": sizes[1],
                "before, s": f"{old:.1f}",
                "s": f"{now:.1f}",
                "to before": f"{now / old:.2f}",
            }
        )
        print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def write_subject(subject: Subject, folder: Path) -> Path:
    """The file of a scene or tree, for `encode_seconds`."""
    path = folder / f"{subject.name}.scene"
    if subject.is_scene:
        write_ply(path, subject.views.scene)
    else:
        write_tree(path, subject.tree)
    return path


def encode_seconds(
    subject: Subject, checkout: Path, path: Path, out: Path, **options: float
) -> float:
    """Processor seconds of an encode by a checkout, on one processor, in a process of its own.

    Args:
        subject: what is encoded.
        checkout: whose encoder does it.
        path: its file.
        out: file of the stream.
        options: of the encode. If they are a target that cannot be met, the file is empty.
    """
    read, encode = (
        ("read_ply", "encode_scene") if subject.is_scene else ("read_tree", "encode_tree")
    )
    code = f"found = {encode}(scene, **{dict(options, up=subject.up)})"
    if options:
        code = f"try:\n    {code}\nexcept TargetMissedError:\n    found = b''"
    setup = SETUP.format(checkout=str(checkout.resolve()), read=read, path=str(path))
    return cost(code, setup, KEEP.format(out=str(out))).processor
