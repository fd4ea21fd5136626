"""Size against pictures: streams aimed at a PSNR, presets, and the files of others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import gsply

from evogs_codec import decode
from evogs_codec.cli.options import DEFAULT_ITERATIONS
from tools.bench.peers import from_gsply, with_fewer_sh_bits, write_compressed_ply, write_spz
from tools.bench.subjects import Subject, aim_of

__all__ = ["rate"]

Rows = list[dict[str, object]]
FEWER = "SPZ 4, SH as its reference encoder rounds"
TARGETS = (40, 45, 50)  # dB


class Point(NamedTuple):
    """A file and what its pictures are worth."""

    name: str
    n_bytes: int
    decibels: float


def rate(of: Sequence[Subject], folder: Path) -> Rows:
    """Bytes a splat and PSNR against the scene, over 24 views; ours have all levels in them.

    The views that polishing goes by are others. The scene playbot was decoded from SOG: its SH are
    entries of a palette, which our streams have too, where that is smaller, and which Zstandard
    in SPZ finds in part.
    """
    rows: Rows = []
    for subject in of:
        splats = subject.views.scene
        peers = list(_peers(subject, folder))
        spz, fewer = (next(p for p in peers if p.name == name) for name in ("SPZ 4", FEWER))
        ours = _ours(subject, (fewer.decibels, spz.decibels))
        rows += [
            {
                "scene": subject.name,
                "stream": point.name,
                "bytes a splat": f"{point.n_bytes / len(splats):.2f}",
                "PSNR, dB": f"{point.decibels:.2f}",
                "to SPZ 4": f"{point.n_bytes / spz.n_bytes:.2f}",
                "to that with fewer SH bits": f"{point.n_bytes / fewer.n_bytes:.2f}",
            }
            for point in (*peers, *ours)
        ]
    return rows


def _ours(subject: Subject, peers: tuple[float, ...]) -> Iterator[Point]:
    """At round targets and at the PSNR of peers, there polished too."""
    views, degree = subject.views, subject.best.shown_degree
    trees = [subject.best, subject.tree] if subject.best is not subject.tree else [subject.tree]

    def point(name: str, data: bytes) -> Point:
        return Point(name, len(data), views.psnr(decode(data).leaves(sh_degree=degree)))

    yield point("evogs, preset", subject.stream)
    for polish, targets in ((0, (*TARGETS, *peers)), (DEFAULT_ITERATIONS, peers)):
        aims = [aim_of(tree, subject.settings, views, polish=polish) for tree in trees]
        for decibels in targets:
            data = min((aim.at_psnr(decibels) for aim in aims), key=len)
            name = f"evogs --target-psnr {decibels:.4g}{' --polish' if polish else ''}"
            yield point(name, data)


def _peers(subject: Subject, folder: Path) -> Iterator[Point]:
    splats, name = subject.views.scene, subject.name
    fewer = with_fewer_sh_bits(splats)
    files = {
        "SPZ 3": write_spz(splats, folder / f"rate-{name}-3.spz", version=3),
        "SPZ 4": write_spz(splats, folder / f"rate-{name}-4.spz"),
        FEWER: write_spz(fewer, folder / f"rate-{name}-4-fewer.spz"),
        "compressed PLY": write_compressed_ply(splats, folder / f"rate-{name}.compressed.ply"),
    }
    for kind, path in files.items():
        read = gsply.plyread if path.suffix == ".ply" else gsply.read_spz
        found = subject.views.psnr(from_gsply(read(path), splats))
        yield Point(kind, path.stat().st_size, found)
