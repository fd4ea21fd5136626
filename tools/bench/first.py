"""Time to the first picture: bytes, decoding and drawing of what a viewer shows first."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import gsply

from evogs_codec import Decoder, SplatParams, decode_leaves, read_directory, read_ply, write_ply
from evogs_codec.render import render
from tools.bench.measure import least
from tools.bench.peers import from_gsply, write_compressed_ply, write_spz
from tools.bench.subjects import WHITE, Subject

__all__ = ["first"]

Rows = list[dict[str, object]]
BANDWIDTHS = (10, 50)  # Mbit/s
TURNS = 5


class Picture(NamedTuple):
    """What is shown: its name, the bytes that it takes, and what reads them."""

    name: str
    n_bytes: int
    read: Callable[[], SplatParams]


def first(of: Sequence[Subject], folder: Path) -> Rows:
    """Until the first picture, of 400 x 400 pixels: from a stream, and from whole files of others.

    A stream is fed to `Decoder` up to a byte and drawn: where every tile has its first step, and at
    the end of the core of each level. Of others nothing can be drawn before the last byte. Decoding
    and drawing are processor time, the least of 5 turns; the seconds are those of the bytes at the
    bandwidth, and of decoding and drawing after them.
    """
    rows: Rows = []
    for subject in of:
        camera = subject.gauge.cameras[0]
        for picture in (*_prefixes(subject.encoded()), *_files(subject, folder)):
            splats = picture.read()
            worth, _ = subject.gauge(splats)
            decode = least(picture.read, TURNS)
            draw = least(partial(render, splats, camera, WHITE), TURNS)
            seconds = {
                f"s at {rate} Mbit/s": f"{8e-6 * picture.n_bytes / rate + decode + draw:.2f}"
                for rate in BANDWIDTHS
            }
            rows.append(
                {
                    "scene": subject.name,
                    "picture": picture.name,
                    "bytes": picture.n_bytes,
                    "splats": len(splats),
                    "PSNR, dB": f"{worth:.2f}",
                    "decode, ms": f"{1000 * decode:.1f}",
                    "draw, ms": f"{1000 * draw:.1f}",
                    **seconds,
                }
            )
    return rows


def _prefixes(data: bytes) -> Iterator[Picture]:
    """Of a stream: its first step, and its levels."""
    directory = read_directory(data)
    rows = directory.packets
    ends = directory.offsets + rows["size"]
    core = rows["component"] == 0
    first_steps = core & (directory.steps == 0)
    yield _prefix("evogs, first step", data, int(ends[first_steps].max()))
    for level in range(directory.n_levels - 1):
        end = int(ends[core & (rows["level"] <= level)].max())
        yield _prefix(f"evogs, level {level}, core", data, end)
    yield Picture("evogs, whole", len(data), partial(decode_leaves, data))


def _prefix(name: str, data: bytes, end: int) -> Picture:
    part = data[:end]

    def read() -> SplatParams:
        decoder = Decoder()
        decoder.feed(part)
        return decoder.leaves()

    return Picture(name, end, read)


def _files(subject: Subject, folder: Path) -> Iterator[Picture]:
    """Of others."""
    splats, name = subject.views.scene, f"first-{subject.name}"
    spz = write_spz(splats, folder / f"{name}.spz")
    compressed = write_compressed_ply(splats, folder / f"{name}.compressed.ply")
    ply = folder / f"{name}.ply"
    write_ply(ply, splats)
    for kind, path, read in (
        ("SPZ 4", spz, lambda: from_gsply(gsply.read_spz(spz), splats)),
        ("compressed PLY", compressed, lambda: from_gsply(gsply.plyread(compressed), splats)),
        ("PLY", ply, partial(read_ply, ply)),
    ):
        yield Picture(kind, path.stat().st_size, read)
