"""Size against pictures: streams aimed at a PSNR, presets, and the files of others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import gsply

from conformance.cli import around
from conformance.views import Views
from evogs_codec import PRESETS, SplatParams, decode, encode, lift
from evogs_codec.aiming import Aim
from tools.bench.peers import from_gsply, with_fewer_sh_bits, write_compressed_ply, write_spz

__all__ = ["rate"]

Rows = list[dict[str, object]]
N_LEVELS = 5
SIZE = 400  # pixels, of a view
FEWER = "SPZ 4, SH as its reference encoder rounds"
TARGETS = (40, 45, 50)  # dB


class Point(NamedTuple):
    """A file and what its pictures are worth."""

    name: str
    n_bytes: int
    decibels: float


def rate(splats: SplatParams, scene: str, up: str, folder: Path) -> Rows:
    """Bytes a splat and PSNR against the scene, over 24 views; ours have all levels in them."""
    views = Views(splats, around(splats, up, SIZE))
    peers = list(_peers(splats, views, folder))
    spz, fewer = (next(p for p in peers if p.name == name) for name in ("SPZ 4", FEWER))
    ours = list(_ours(splats, views, (*TARGETS, fewer.decibels, spz.decibels)))
    return [
        {
            "scene": scene,
            "stream": point.name,
            "bytes a splat": f"{point.n_bytes / len(splats):.2f}",
            "PSNR, dB": f"{point.decibels:.2f}",
            "to SPZ 4": f"{point.n_bytes / spz.n_bytes:.2f}",
            "to that with fewer SH bits": f"{point.n_bytes / fewer.n_bytes:.2f}",
        }
        for point in (*peers, *ours)
    ]


def _ours(splats: SplatParams, views: Views, targets: tuple[float, ...]) -> Iterator[Point]:
    tree = lift(splats, N_LEVELS)

    def point(name: str, data: bytes) -> Point:
        return Point(name, len(data), views.psnr(decode(data).leaves(sh_degree=splats.sh_degree)))

    yield point("evogs --preset scene", encode(tree, PRESETS["scene"]))
    aim = Aim(tree, PRESETS["scene"], views)
    for decibels in targets:
        yield point(f"evogs --target-psnr {decibels:.4g}", aim.at_psnr(decibels))


def _peers(splats: SplatParams, views: Views, folder: Path) -> Iterator[Point]:
    files = {
        "SPZ 3": write_spz(splats, folder / "rate-3.spz", version=3),
        "SPZ 4": write_spz(splats, folder / "rate-4.spz"),
        FEWER: write_spz(with_fewer_sh_bits(splats), folder / "rate-4-fewer.spz"),
        "compressed PLY": write_compressed_ply(splats, folder / "rate.compressed.ply"),
    }
    for name, path in files.items():
        read = gsply.plyread if path.suffix == ".ply" else gsply.read_spz
        found = views.psnr(from_gsply(read(path), splats))
        yield Point(name, path.stat().st_size, found)
