"""What a prefix loses: its PSNR below that of a stream that was made for as many bytes."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

from evogs_codec import Cut, decode, read_directory
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.encoding.settings import TREE_PSNR
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tools.bench.measure import seconds_text
from tools.bench.page import Rows
from tools.bench.prefix import ends_of_packets, sizes_of_packets
from tools.bench.subjects import Subject, aim_of

__all__ = ["Losses", "scene_without_bands"]

DEFAULT = "default"
LAYERS = (1, 2, 3)
CUTS = range(5, 105, 5)  # % of the bytes
JUDGED = np.array([30 <= cut <= 90 for cut in CUTS])
MAX_PSNR = 70.0  # dB, beyond which nobody looks for a dedicated stream
PLACES = 100  # prefixes between which falls are looked for
FALL_VIEWS = 6  # that falls are judged by
HALF_DECADE = 10**-0.5
BARE_SEED = 1
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]


def scene_without_bands(n: int = 40_000) -> Subject:
    """The demo scene of another seed, SH degree 0."""
    splats = make_scene(n, BARE_SEED)
    return Subject.of_scene("SH degree 0", replace(splats, sh=splats.sh[:, :1]), "z")


@dataclass(frozen=True, eq=False)
class Losses:
    """Prefixes of streams beside dedicated streams, measured once for both tables.

    Attributes:
        subjects: trees and their views; called once, when the first table is made.
        folder: for files of other formats; without one, or without gsply, they are left out.
    """

    subjects: Callable[[], Sequence[Subject]]
    folder: Path | None = None

    def table(self) -> Rows:
        """PSNR of the dedicated stream of n bytes less that of the prefix of n bytes.

        A prefix has the packets that are whole after n bytes. Dedicated is a stream of one layer of
        the same tree that `--target-bytes` would make: the PSNR of streams at prices half a decade
        apart, interpolated in bytes. PSNR is against the scene, or the leaves of the tree, over 24
        views. The default is `evogs encode` without options. Streams with layers aim at the PSNR of
        the preset, of a trained tree at 52 dB as its default does, and come within 0.2 dB of it.
        "To one layer" is their bytes, to those that a dedicated stream takes for the PSNR that they
        have; all weigh errors by the same views. Losses are those at every 5 % from 30 to 90 % of
        the bytes. The deepest fall is from a prefix to the next, of all that end with a packet, or
        of one per percent if there are more than 100; 6 of the views judge it. Seconds are those of
        the processor, from the tree to the stream, with its search; of the default of a scene, from
        the splats. An SPZ file shows nothing before its last byte. The streamed SOG is the model of
        the table of connections. Cells are empty where no dedicated stream is so large, and of what
        is not known of other formats.
        """
        return [_row(curve) for curve in self._measured]

    def curves(self) -> Rows:
        """The streams of the table above: the prefix, the dedicated stream, and the loss, in dB.

        A cell is empty where no stream of one layer is so small. The picture shows the prefixes of
        each stream, and the dedicated streams as the thick line.
        """
        rows: Rows = []
        for curve in self._measured:
            for what in ("prefix", "dedicated", "loss"):
                row: dict[str, object] = {
                    "scene": curve.stream.scene,
                    "stream": curve.stream.name,
                    "bytes a splat": f"{curve.stream.bytes_per_splat:.2f}",
                    "curve": what,
                }
                values = [_cell(value) for value in getattr(curve, what)]
                rows.append(row | dict(zip((f"{cut} %" for cut in CUTS), values, strict=True)))
        return rows

    @cached_property
    def _measured(self) -> list[_Curve]:
        found = []
        for subject in self.subjects():
            for curve in _curves(subject, self.folder):
                print(*_row(curve).values(), sep=", ", file=sys.stderr, flush=True)
                found.append(curve)
        return found


@dataclass(frozen=True, eq=False)
class _Stream:
    """A stream, and the processor seconds that its encoder took; of another format only its size.

    Attributes:
        data: empty of another format.
    """

    scene: str
    name: str
    data: bytes
    seconds: float
    n_splats: int
    n_bytes: int

    @property
    def bytes_per_splat(self) -> float:
        return self.n_bytes / self.n_splats


@dataclass(frozen=True, eq=False)
class _Curve:
    """What the prefixes of a stream are worth.

    Attributes:
        stream: whose prefixes.
        prefix: (20,) dB of the prefixes at `CUTS`.
        dedicated: (20,) dB of dedicated streams of as many bytes; NaN where none is so small.
        to_one_layer: bytes, to those of one layer at the same PSNR; NaN where none has it.
        fall: dB, the deepest from a prefix to the next.
        largest: % of the bytes that the largest packet takes.
    """

    stream: _Stream
    prefix: F64
    dedicated: F64
    to_one_layer: float
    fall: float
    largest: float

    @property
    def loss(self) -> F64:
        """(20,) dB."""
        return self.dedicated - self.prefix


def _row(curve: _Curve) -> dict[str, object]:
    return {
        "scene": curve.stream.scene,
        "stream": curve.stream.name,
        "bytes a splat": f"{curve.stream.bytes_per_splat:.2f}",
        "PSNR, dB": f"{curve.prefix[-1]:.2f}",
        "to one layer": _cell(curve.to_one_layer, 3),
        "mean loss, dB": _cell(_judged(curve.loss, np.mean)),
        "largest loss, dB": _cell(_judged(curve.loss, np.max)),
        "deepest fall, dB": _cell(curve.fall),
        "largest packet, %": _cell(curve.largest, 1),
        "encode, s": "" if np.isnan(curve.stream.seconds) else seconds_text(curve.stream.seconds),
    }


def _curves(subject: Subject, folder: Path | None) -> Iterator[_Curve]:
    """Those of the streams of a subject, then of files of other formats."""
    streams, others = list(_streams(subject)), _others(subject, folder)
    most = max([*(len(stream.data) for stream in streams), *(n[-1] for _, n, _ in others)])
    one_layer = _OneLayer.of(subject, most, _aim(subject))
    degree = subject.best.shown_degree
    for stream in streams:
        n = len(stream.data)
        prefixes = _Prefixes(stream.data, degree)
        at = [prefixes.n_packets(n * cut // 100) for cut in CUTS]
        worth = prefixes.worth(at, subject.views)
        places: Sequence[int] = range(len(prefixes.ends) + 1)
        if len(places) > PLACES + 1:
            parts = range(PLACES + 1)
            places = sorted({prefixes.n_packets(n * part // PLACES) for part in parts})
        some = prefixes.worth(places, _some(subject.views))
        fall = abs(float(np.diff(some).min(initial=0.0)))
        largest = 100 * int(prefixes.sizes.max(initial=0)) / n
        yield _curve(stream, worth, one_layer, fall, largest)
    nothing = subject.views.psnr(subject.views.scene.take(np.arange(0)))
    for name, ends, decibels in others:
        n = int(ends[-1])
        n_pictures = np.searchsorted(ends, [n * cut // 100 for cut in CUTS], side="right")
        worth = np.append(nothing, decibels)[n_pictures]
        stream = _Stream(subject.name, name, b"", math.nan, subject.tree.n_leaves, n)
        yield _curve(stream, worth, one_layer, math.nan, math.nan)


def _curve(
    stream: _Stream, worth: F64, one_layer: _OneLayer, fall: float, largest: float
) -> _Curve:
    n = stream.n_bytes
    dedicated = np.array([one_layer.decibels(n * cut // 100) for cut in CUTS])
    return _Curve(stream, worth, dedicated, n / one_layer.n_bytes(worth[-1]), fall, largest)


def _others(subject: Subject, folder: Path | None) -> list[tuple[str, I64, F64]]:
    """Files of other formats: bytes after which there is a better picture, and its PSNR."""
    if folder is None or not find_spec("gsply"):
        return []
    from tools.bench.fetched import sog_files, spz_file

    found = [spz_file(subject, subject.views, folder)]
    found += sog_files(subject, subject.views, folder)
    return [(file.name, file.places, file.decibels) for file in found]


def _streams(subject: Subject) -> Iterator[_Stream]:
    """The preset, and streams with layers at its PSNR, or at that which trees have by default."""

    def timed(name: str, make: Callable[[Subject], bytes]) -> _Stream:
        # No stream finds views drawn, or a palette made, for another.
        fresh = replace(subject, tree=subject.best, lifted=None, views=replace(subject.views))
        start = time.process_time()
        data = make(fresh)
        seconds = time.process_time() - start
        return _Stream(subject.name, name, data, seconds, subject.tree.n_leaves, len(data))

    preset = timed("preset", lambda fresh: fresh.stream)
    yield preset
    target = TREE_PSNR
    ways: dict[str, Callable[[Subject], bytes]] = {DEFAULT: lambda fresh: fresh.encoded()}
    if subject.is_scene:
        leaves = decode(preset.data).leaves(sh_degree=subject.best.shown_degree)
        target = round(subject.views.psnr(leaves), 2)
    for n_layers in LAYERS:
        name = f"--target-psnr {target:g} --layers {n_layers}"
        ways[name] = partial(_aimed, n_layers=n_layers, target=target)
    for name, make in ways.items():
        print(f"{subject.name}, {name} ...", file=sys.stderr)
        try:
            yield timed(name, make)
        except TargetMissedError as error:
            print(f"{subject.name}, {name} is left out: {error}", file=sys.stderr)


def _aimed(subject: Subject, n_layers: int, target: float) -> bytes:
    return _aim(subject, n_layers).at_psnr(target)


def _aim(subject: Subject, n_layers: int = 1) -> TargetEncoder:
    return aim_of(subject.best, subject.settings, subject.views, layers=n_layers)


@dataclass(frozen=True, eq=False)
class _OneLayer:
    """Rate and distortion of streams of one layer.

    Attributes:
        sizes: (m,) bytes, rising.
        worth: (m,) dB, rising.
    """

    sizes: F64
    worth: F64

    @staticmethod
    def of(subject: Subject, most: int, aim: TargetEncoder) -> _OneLayer:
        """Of streams at falling prices, until one is larger than `most` bytes."""
        degree = subject.best.shown_degree
        points: list[tuple[int, float]] = []
        for data in aim.at_prices(_prices()):
            points.append((len(data), subject.views.psnr(decode(data).leaves(sh_degree=degree))))
            if len(data) > most or points[-1][1] > MAX_PSNR:
                break
        kept: list[tuple[int, float]] = []
        for point in sorted(points):
            if not kept or (point[0] > kept[-1][0] and point[1] > kept[-1][1]):
                kept.append(point)
        sizes, worth = np.array(kept, np.float64).T
        return _OneLayer(sizes, worth)

    def decibels(self, n_bytes: int) -> float:
        """Of a stream of so many bytes; NaN where there is none."""
        return _between(self.sizes, self.worth, n_bytes)

    def n_bytes(self, decibels: float) -> float:
        """Of a stream with this PSNR; NaN where there is none."""
        return _between(self.worth, self.sizes, decibels)


def _prices() -> Iterator[float]:
    """From the highest that a search tries to the lowest, half a decade apart."""
    lowest, price = PRICES
    while price >= lowest:
        yield price
        price *= HALF_DECADE


def _between(x: F64, y: F64, at: float) -> float:
    """Monotone cubic interpolation; NaN outside."""
    if len(x) < 2:
        return float("nan")
    return float(PchipInterpolator(x, y, extrapolate=False)(at))


class _Prefixes:
    """Prefixes of a stream that end with a packet."""

    def __init__(self, data: bytes, sh_degree: int) -> None:
        self.data, self.sh_degree = data, sh_degree
        self.directory = read_directory(data)
        self.order = np.arange(len(self.directory.packets))
        self.sizes = sizes_of_packets(self.directory, self.order)
        self.ends = ends_of_packets(data, self.sizes)

    def n_packets(self, n_bytes: int) -> int:
        """Those that are whole after so many bytes."""
        return int(np.searchsorted(self.ends, n_bytes, side="right"))

    def worth(self, n_packets: Sequence[int], views: Views) -> F64:
        """Mean PSNR over views after so many packets, dB."""
        found: dict[tuple[bytes, int], float] = {}
        out = []
        for n in n_packets:
            cut = Cut.of_rows(self.directory, self.order[:n])
            key = cut.steps.tobytes(), cut.palette
            if key not in found:
                leaves = decode(self.data, cut).leaves(sh_degree=self.sh_degree)
                found[key] = views.psnr(leaves)
            out.append(found[key])
        return np.array(out)


def _some(views: Views) -> Views:
    every = -(-len(views.cameras) // FALL_VIEWS)
    return replace(views, cameras=views.cameras[::every])


def _judged(loss: F64, of: Callable[[F64], float]) -> float:
    """Of the losses from 30 to 90 % of the bytes that are known."""
    known = loss[JUDGED & ~np.isnan(loss)]
    return float(of(known)) if len(known) else float("nan")


def _cell(number: float, digits: int = 2) -> str:
    return "" if np.isnan(number) else f"{number:.{digits}f}"
