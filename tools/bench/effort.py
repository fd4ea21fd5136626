"""What each effort of `evogs encode` takes and gives, beside SPZ version 4."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gsply
import numpy as np

from evogs_codec import SplatParams, decode, read_ply, write_ply
from evogs_codec.encoding.layers import N_LAYERS
from evogs_codec.encoding.settings import SCENE_PRICE
from evogs_codec.scene.effort import EFFORTS
from tools.bench.measure import cost
from tools.bench.page import Rows
from tools.bench.peers import from_gsply
from tools.bench.subjects import Subject, aim_of

__all__ = ["effort", "to_default"]

DOUBLINGS = (3, 2, 1, 0, -1)  # of the price of a bit: about 12 dB
ENCODE = "found = encode_scene(splats, up={up!r}, effort={name!r})"
READ = "from evogs_codec import encode_scene, read_ply\nsplats = read_ply({ply!r})"
KEEP = "open({out!r}, 'wb').write(found)"
SPZ = "import gsply\ndata = gsply.plyread({ply!r})\ngsply.write_spz({out!r}, data, version=4)"
WRITE = "gsply.write_spz({out!r}, data, version=4)"
SPZ_NAME = "SPZ 4, gsply (no levels)"


@dataclass(frozen=True)
class _Made:
    name: str
    n_bytes: int
    decibels: float
    processor: float
    seconds: float

    @property
    def point(self) -> tuple[int, float]:
        """Bytes and dB."""
        return self.n_bytes, self.decibels


def effort(subjects: Sequence[Subject], folder: Path) -> Rows:
    """Each effort of `evogs encode` and gsply writing SPZ 4, in processes of their own.

    Seconds are of the processor, of all threads, and of the clock beside them; reading the file and
    loading libraries come before, what numba loads when it first runs does not. PSNR is over 24
    views, a third of which weigh errors in the default. "At equal PSNR" are the bytes to those that
    the default would take for the PSNR: streams at prices of a bit that differ by a factor of two,
    interpolated.
    """
    rows: Rows = []
    for subject in subjects:
        made = _made(subject, folder)
        default = next(one for one in made if one.name == "default")
        curve = _curve(subject)
        rows += [
            {
                "scene": subject.name,
                "effort": one.name,
                "processor, s": f"{one.processor:.1f}",
                "seconds": f"{one.seconds:.1f}",
                "us a splat": f"{1e6 * one.processor / subject.tree.n_leaves:.0f}",
                "bytes": one.n_bytes,
                "PSNR, dB": f"{one.decibels:.2f}",
                "at equal PSNR": _cell(to_default(curve, one.point, default.point)),
            }
            for one in made
        ]
    return rows


def to_default(
    curve: Sequence[tuple[int, float]], one: tuple[int, float], default: tuple[int, float]
) -> float:
    """Bytes of a stream to those that the default would take for its PSNR; NaN off the curve.

    Args:
        curve: bytes and dB of streams like the default, in any order.
        one: bytes and dB of the stream.
        default: likewise, beside the curve: it is moved to go through this point.
    """
    sizes, decibels = np.array(sorted(curve, key=lambda point: point[1])).T
    at = np.interp([one[1], default[1]], decibels, np.log(sizes), left=np.nan, right=np.nan)
    return float(one[0] / default[0] * np.exp(at[1] - at[0]))


def _made(subject: Subject, folder: Path) -> list[_Made]:
    """The streams of all efforts, and the SPZ file."""
    ply, out = folder / f"{subject.name}-effort.ply", folder / "effort.out"
    write_ply(ply, subject.views.scene)
    splats = read_ply(ply)
    found = []
    for name in EFFORTS:
        print(f"{subject.name}, {name} ...", file=sys.stderr)
        words = {"ply": str(ply), "out": str(out), "name": name, "up": subject.up}
        taken = cost(ENCODE.format(**words), READ.format(**words), KEEP.format(**words))
        data = out.read_bytes()
        shown = subject.views.psnr(decode(data).leaves(sh_degree=splats.sh_degree))
        found.append(_Made(name, len(data), shown, taken.processor, taken.seconds))
    words = {"ply": str(ply), "out": str(out)}
    taken = cost(WRITE.format(**words), SPZ.format(**words))
    shown = subject.views.psnr(_of_spz(out, splats))
    return [*found, _Made(SPZ_NAME, out.stat().st_size, shown, taken.processor, taken.seconds)]


def _of_spz(path: Path, like: SplatParams) -> SplatParams:
    return from_gsply(gsply.read_spz(path), like)


def _curve(subject: Subject) -> list[tuple[int, float]]:
    """Bytes and dB of streams like the default."""
    views = subject.views.fewer(EFFORTS["default"].n_views)
    ordering = views.fewer(EFFORTS["default"].n_ordering_views)
    aim = aim_of(subject.best, subject.settings, views, layers=N_LAYERS, ordering=ordering)
    price = SCENE_PRICE / subject.tree.n_leaves
    found = []
    for data in aim.at_prices([price * 2.0**k for k in DOUBLINGS]):
        shown = decode(data).leaves(sh_degree=subject.best.shown_degree)
        found.append((len(data), subject.views.psnr(shown)))
    return found


def _cell(ratio: float) -> str:
    return "" if np.isnan(ratio) else f"{ratio:.3f}"
