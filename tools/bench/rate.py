"""Size against pictures: streams aimed at a PSNR, presets, and the files of others."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple, TypedDict, Unpack

import gsply

from evogs_codec import SplatParams, decode
from evogs_codec.cli.options import DEFAULT_ITERATIONS
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.render import Views, cameras_around
from tools.bench.measure import seconds_text
from tools.bench.peers import from_gsply, with_fewer_sh_bits, write_compressed_ply, write_spz
from tools.bench.subjects import SIZE, Subject

__all__ = ["rate"]

Rows = list[dict[str, object]]
FEWER = "SPZ 4, SH as its reference encoder rounds"
TARGETS = (40, 45, 50)  # dB
MAX_POLISHED = 50_000  # splats: half a million take half an hour


class Point(NamedTuple):
    """A file: its bytes, the splats that it shows, and the seconds that writing it took."""

    name: str
    n_bytes: int
    splats: SplatParams
    seconds: float


class Options(TypedDict, total=False):
    """Of `Subject.encoded`."""

    target_psnr: float
    polish: int


def rate(of: Sequence[Subject], folder: Path) -> Rows:
    """Bytes a splat and PSNR against the scene; ours have all levels and layers in them.

    Our streams are those of `evogs encode` with the options that are named. It aims by the 24 views
    on a circle. Other views are 12, nearer, half of them from above and half from below, which
    nothing aims by. Seconds are processor time of one run. The scene playbot was decoded from SOG:
    its SH are entries of a palette, which our streams have too, where that is smaller, and which
    Zstandard in SPZ finds in part.
    """
    rows: Rows = []
    for subject in of:
        others = _other_views(subject)
        peers = list(_peers(subject, folder))
        spz, fewer = (next(p for p in peers if p.name == name) for name in ("SPZ 4", FEWER))
        for point in chain(peers, _ours(subject, (fewer, spz))):
            n_bytes, shown = point.n_bytes, point.splats
            row: dict[str, object] = {
                "scene": subject.name,
                "stream": point.name,
                "bytes a splat": f"{n_bytes / len(subject.views.scene):.2f}",
                "PSNR, dB": f"{subject.views.psnr(shown):.2f}",
                "of other views, dB": f"{others.psnr(shown):.2f}",
                "to SPZ 4": f"{n_bytes / spz.n_bytes:.2f}",
                "to that with fewer SH bits": f"{n_bytes / fewer.n_bytes:.2f}",
                "encode, s": seconds_text(point.seconds),
            }
            print("  ".join(str(cell) for cell in row.values()), file=sys.stderr, flush=True)
            rows.append(row)
    return rows


def _other_views(subject: Subject) -> Views:
    scene = subject.views.scene
    cameras = [
        camera
        for elevation in (0.9, -0.3)
        for camera in cameras_around(
            scene, subject.up, SIZE, n=6, elevation=elevation, distance=1.4
        )
    ]
    return Views(scene, cameras)


def _ours(subject: Subject, peers: Sequence[Point]) -> Iterator[Point]:
    """The default, at round targets, and at the PSNR of peers: polished, too, of a scene of few."""

    def point(**options: Unpack[Options]) -> Point:
        named = [f"--{name.replace('_', '-')} {value:.4g}" for name, value in options.items()]
        start = time.process_time()
        data = subject.encoded(**options)
        seconds = time.process_time() - start
        shown = decode(data).leaves(sh_degree=subject.tree.shown_degree)
        return Point(" ".join(["evogs encode", *named]), len(data), shown, seconds)

    yield point()
    theirs = [round(subject.views.psnr(peer.splats), 2) for peer in peers]
    ways: list[Options] = [{"target_psnr": decibels} for decibels in (*TARGETS, *theirs)]
    if subject.tree.n_leaves <= MAX_POLISHED:
        ways += [{"target_psnr": decibels, "polish": DEFAULT_ITERATIONS} for decibels in theirs]
    for options in ways:
        try:
            yield point(**options)
        except TargetMissedError as error:
            print(f"{subject.name}, {options} is left out: {error}", file=sys.stderr)


def _peers(subject: Subject, folder: Path) -> Iterator[Point]:
    splats, name = subject.views.scene, subject.name
    fewer = with_fewer_sh_bits(splats)
    files: dict[str, Callable[[], Path]] = {
        "SPZ 3": lambda: write_spz(splats, folder / f"rate-{name}-3.spz", version=3),
        "SPZ 4": lambda: write_spz(splats, folder / f"rate-{name}-4.spz"),
        FEWER: lambda: write_spz(fewer, folder / f"rate-{name}-4-fewer.spz"),
        "compressed PLY": lambda: write_compressed_ply(
            splats, folder / f"rate-{name}.compressed.ply"
        ),
    }
    for kind, write in files.items():
        start = time.process_time()
        path = write()
        seconds = time.process_time() - start
        read = gsply.plyread if path.suffix == ".ply" else gsply.read_spz
        yield Point(kind, path.stat().st_size, from_gsply(read(path), splats), seconds)
