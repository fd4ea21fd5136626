"""Streams of every setting, and parts of streams: bytes, pictures, times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from evogs_codec import Cut, Directory, InputError, decode_leaves, encode, extract, read_directory
from evogs_codec.encoding.settings import RangeBits
from tools.bench.measure import least
from tools.bench.subjects import Subject, aim_of
from tools.bench.surface.fronts import NOISE, better

__all__ = ["streams"]

Rows = list[dict[str, object]]
BITS = (4, 6, 8, 10)
FINER = (0.5, 2, 4)
TARGETS = (35, 40, 45, 50)  # dB, against pictures of the leaves
TURNS = 5


class Point(NamedTuple):
    """A stream: what is turned, how far, and its bytes."""

    axis: str
    setting: str
    data: bytes


def streams(of: Sequence[Subject]) -> Rows:
    """Streams of every setting, and parts of the stream of the preset.

    Parts are of the stream of the preset, as `extract` makes them: a level, no SH bands above a
    degree, or SH bands only of the records up to a level. PSNR is over 24 views of the scene, or
    held-out photographs of a tree. Times are processor time, the least of 5 decodes and the median
    of the pictures of 400 x 400 pixels. The last columns name a point that is no worse and smaller,
    or a quarter faster to decode and draw. What has a name in the first is a cross in the picture.
    """
    rows: Rows = []
    for subject in of:
        n = subject.tree.n_leaves
        names, sizes, worths, times, own = [], [], [], [], Rows()
        for point in _points(subject):
            splats = decode_leaves(point.data)
            worth, draw = subject.gauge(splats)
            decode = 1000 * least(partial(decode_leaves, point.data), TURNS)
            names.append(point.setting)
            sizes.append(len(point.data))
            worths.append(worth)
            times.append(decode + draw)
            own.append(
                {
                    "scene": subject.name,
                    "axis": point.axis,
                    "setting": point.setting,
                    "splats": len(splats),
                    "bytes a splat": f"{len(point.data) / n:.2f}",
                    "PSNR, dB": f"{worth:.2f}",
                    "decode, ms": f"{decode:.1f}",
                    "picture, ms": f"{draw:.1f}",
                }
            )
        smaller = better(list(zip(names, sizes, worths, strict=True)))
        faster = better(list(zip(names, times, worths, strict=True)), NOISE)
        for row, in_size, in_time in zip(own, smaller, faster, strict=True):
            row |= {"smaller": in_size, "faster": in_time}
        rows += own
    return rows


def _points(subject: Subject) -> Iterator[Point]:
    tree, settings, whole = subject.best, subject.settings, subject.stream
    yield Point("preset", "preset", whole)
    for factor in FINER:
        yield Point("steps", f"--finer {factor:g}", encode(tree, settings.finer(factor)))
    for bits in BITS:
        yield Point(
            "bits", f"--bits {bits}", encode(tree, replace(settings, accuracy=RangeBits(bits)))
        )
    aim = aim_of(tree, settings, subject.views)
    for decibels in TARGETS:
        try:
            yield Point("target", f"--target-psnr {decibels}", aim.at_psnr(decibels))
        except InputError:  # beyond what steps can do
            continue
    for axis, setting, cut in _cuts(read_directory(whole)):
        yield Point(axis, setting, extract(whole, cut))


def _cuts(directory: Directory) -> Iterator[tuple[str, str, Cut]]:
    """Parts of a stream: levels, SH degrees, and SH of coarse levels on all splats."""
    full = Cut.full(directory)
    for level in range(directory.n_levels - 1):
        at = Cut.of_level(directory, level)
        yield "level", f"--level {level}", at
        yield "SH by level", f"SH 1+ to level {level}", _sh_of(at, full)
    for degree in range(directory.sh_degree):
        yield "SH degree", f"--sh-degree {degree}", full.with_sh_degree(degree)


def _sh_of(coarse: Cut, full: Cut) -> Cut:
    """Core of one cut, higher SH bands, or picks, of another."""
    steps = np.concatenate([full.steps[:, :1], coarse.steps[:, 1:]], axis=1)
    return Cut(steps, full.palette)
