"""A camera that moves while a scene comes: what it sees, and what came for nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import gsply
import numpy as np

from evogs_codec import Cut, SplatParams, decode, encode_scene, read_directory
from evogs_codec.format.directory import Directory
from evogs_codec.model.splats import F64
from evogs_codec.render import Camera, cameras_around, psnr, render
from tools.bench.page import Rows
from tools.bench.peers import from_gsply, with_fewer_sh_bits, write_spz
from tools.bench.streamed_sog import SogStream, stream_levels
from tools.bench.subjects import SIZE, WHITE, Subject
from tools.bench.traces import FIRST, TRACES, Trace
from tools.bench.view_order import Boxes, view_order

__all__ = ["Source", "Trip", "moves", "trip"]

LOOKS = 3
ZOOM = 3  # times as near as the cameras around a scene
SAMPLES = 8  # pictures of a look that are judged
PART = 0.75  # of our file comes until the last look ends
GOOD = 25.0  # dB
TILES = 16
SET_PART = 16  # a set has so much of the splats, or less


@dataclass(frozen=True, eq=False)
class Source:
    """A file that comes in pieces, in an order that its client chooses.

    Attributes:
        name: in tables.
        head: bytes before the first piece.
        sizes: bytes of each piece.
        first: pieces that the first request brings.
        order: of all pieces, the most urgent first, for a camera.
        drawn: which of the pieces that are there a picture is made of.
        scene: what is there, if that is something to draw.
    """

    name: str
    head: int
    sizes: Sequence[int]
    first: Sequence[int]
    order: Callable[[Camera], Sequence[int]]
    drawn: Callable[[Sequence[int], Camera], set[int]]
    scene: Callable[[Sequence[int]], SplatParams | None]


@dataclass(frozen=True, eq=False)
class Trip:
    """What came while the camera moved.

    Attributes:
        seconds: when each piece was there.
        pieces: which ones, in that order.
        n_bytes: that came, with the head and with pieces that are not whole.
        unused: of these, bytes of pieces that no picture was made of, and of those not whole.
    """

    seconds: Sequence[float]
    pieces: Sequence[int]
    n_bytes: int
    unused: int

    def there(self, seconds: float) -> tuple[int, ...]:
        """The pieces then, in the order of their numbers."""
        n = int(np.searchsorted(self.seconds, seconds, side="right"))
        return tuple(sorted(self.pieces[:n]))


def moves(of: Sequence[Subject], folder: Path) -> Rows:
    """What a camera that moves sees, and what came for nothing.

    It looks at the scene three times, from another side each time, at a third of the width of the
    views above. The last look ends when three quarters of our file would be there. Pieces come one
    after the other, the most urgent first. After a move the client asks anew: what was on its way
    is left, unless it is still first, and a round trip passes. The streams have 16 tiles, and are
    otherwise as `evogs encode` makes them; packets come by view as `evogs-fetch` orders them, or in
    the order of the file. The streamed SOG is the model of above, in sets of a sixteenth of the
    splats: every level, or the coarsest and the finest, and what is in sight before the rest.
    Bytes are used if a picture was made of them: a packet if its tile was in sight, a set if a box
    in sight showed its level. What is left at the end of a look counts as not used, until it comes
    whole. PSNR is that of the view against the scene, when each look ends; seconds under 25 dB are
    those without a better picture, to an eighth of a look.
    """
    return [row for subject in of for row in _rows(subject, folder)]


def trip(source: Source, trace: Trace, cameras: Sequence[Camera], dwell: float) -> Trip:
    """Fetch while the camera stays `dwell` seconds at each place."""
    left = list(source.sizes)
    there: list[int] = []
    came_whole: set[int] = set()
    seconds: list[float] = []
    used: set[int] = set()
    at = trace.capacity(2 * trace.round_trip) + source.head
    on_its_way = -1
    for look, camera in enumerate(cameras):
        wanted = dict.fromkeys([*source.first, *source.order(camera)])
        missing = [i for i in wanted if i not in came_whole]
        if look and missing[:1] != [on_its_way]:
            at = max(at, trace.capacity(look * dwell + trace.round_trip))
        end = trace.capacity((look + 1) * dwell)
        used |= source.drawn(there, camera)
        for on_its_way in missing:
            came = int(min(left[on_its_way], max(0, end - at)))
            at += came
            left[on_its_way] -= came
            if left[on_its_way] > 0:
                break
            there.append(on_its_way)
            came_whole.add(on_its_way)
            seconds.append(float(trace.when(at)))
            used |= source.drawn(there, camera)
    came_of = [size - rest for size, rest in zip(source.sizes, left, strict=True)]
    unused = sum(came for i, came in enumerate(came_of) if i not in used)
    return Trip(seconds, there, source.head + sum(came_of), unused)


def _rows(subject: Subject, folder: Path) -> Iterator[dict[str, object]]:
    scene = subject.views.scene
    around = cameras_around(scene, subject.up, SIZE, n=LOOKS)
    cameras = [replace(camera, fx=ZOOM * camera.fx, fy=ZOOM * camera.fy) for camera in around]
    targets = [render(scene, camera, WHITE) for camera in cameras]
    data = encode_scene(scene, up=subject.up, n_tiles=TILES)
    for source in _sources(subject, data, folder):
        found: dict[tuple[int, tuple[int, ...]], float] = {}

        def worth(look: int, there: tuple[int, ...], source: Source = source) -> float:
            splats = source.scene(there)
            return psnr(render(splats, cameras[look], WHITE), targets[look]) if splats else 0.0

        for trace in TRACES:
            until = float(trace.when(trace.capacity(4 * trace.round_trip) + PART * len(data)))
            dwell = until / LOOKS
            came = trip(source, trace, cameras, dwell)
            decibels = np.zeros((LOOKS, SAMPLES))
            for look, k in np.ndindex(LOOKS, SAMPLES):
                key = look, came.there((look + (k + 1) / SAMPLES) * dwell)
                if key not in found:
                    found[key] = worth(*key)
                decibels[look, k] = found[key]
            row = _row(subject.name, source, trace, came, decibels, dwell)
            print(*row.values(), sep=", ", file=sys.stderr, flush=True)
            yield row


def _row(
    scene: str, source: Source, trace: Trace, came: Trip, decibels: F64, dwell: float
) -> dict[str, object]:
    waits = np.count_nonzero(decibels < GOOD) / SAMPLES * dwell
    at_ends = {
        f"look {look + 1}, dB": f"{worth:.2f}" if worth else ""
        for look, worth in enumerate(decibels[:, -1])
    }
    return {
        "scene": scene,
        "connection": trace.name,
        "file": source.name,
        "seconds": f"{LOOKS * dwell:.2f}",
        "bytes": came.n_bytes,
        "never used": came.unused,
        "of the bytes, %": f"{100 * came.unused / came.n_bytes:.1f}",
        f"under {GOOD:g} dB, s": f"{waits:.2f}",
        **at_ends,
    }


# --- what is fetched ------------------------------------------------------------------------------


def _sources(subject: Subject, data: bytes, folder: Path) -> Iterator[Source]:
    directory = read_directory(data)
    by_view = _of_stream("evogs, by view", data, directory)
    yield by_view
    in_file = range(len(directory.packets))
    yield replace(by_view, name="evogs, order of the file", order=lambda _: in_file)
    yield _of_spz(subject, folder)
    scene = subject.views.scene
    most = -(-len(scene) // SET_PART)
    stream = SogStream.of(stream_levels(scene), most, folder / f"moves-{subject.name}-sog")
    yield _of_sog("streamed SOG, every level", stream, stream.n_levels)
    yield _of_sog("streamed SOG, coarsest, finest", stream, 1)


def _of_stream(name: str, data: bytes, directory: Directory) -> Source:
    packets, boxes = directory.packets, Boxes.of_tiles(directory)
    ends = directory.offsets + packets["size"]
    adds = (packets["component"] == 0) & (packets["n_adds"] > 0)

    def order(camera: Camera) -> list[int]:
        return [int(i) for i in view_order(directory, boxes.weights(camera))]

    def drawn(there: Sequence[int], camera: Camera) -> set[int]:
        rows = np.array(there, np.int64)
        in_sight = boxes.in_sight(camera)[packets["tile"][rows]]
        return set(rows[in_sight | (directory.columns[rows] < 0)].tolist())

    def scene(there: Sequence[int]) -> SplatParams | None:
        rows = np.array(there, np.int64)
        if not adds[rows].any():
            return None
        return decode(data, Cut.of_rows(directory, rows)).leaves()

    return Source(
        name,
        head=int(directory.offsets[0]),
        sizes=packets["size"].tolist(),
        first=np.flatnonzero(ends <= FIRST).tolist(),
        order=order,
        drawn=drawn,
        scene=scene,
    )


def _of_spz(subject: Subject, folder: Path) -> Source:
    splats = subject.views.scene
    path = write_spz(with_fewer_sh_bits(splats), folder / f"stream-{subject.name}.spz")
    decoded = from_gsply(gsply.read_spz(path), splats)
    return Source(
        "SPZ 4",
        head=0,
        sizes=[path.stat().st_size],
        first=[],
        order=lambda _: [0],
        drawn=lambda there, _: set(there),
        scene=lambda there: decoded if there else None,
    )


def _of_sog(name: str, stream: SogStream, steps: int) -> Source:
    """Levels from the coarsest to the finest, which are `steps` steps apart."""
    boxes = Boxes(stream.boxes[:, 0], stream.boxes[:, 1])
    sets, finest = stream.sets, stream.n_levels - 1
    wanted = [i for i, one in enumerate(sets) if one.level in (0, finest) or steps > 1]

    def order(camera: Camera) -> list[int]:
        covers, in_sight = boxes.covers(camera), boxes.in_sight(camera)

        def urgency(i: int) -> tuple[bool, bool, int, float]:
            cells, level = stream.cells_of[i], sets[i].level
            is_unseen = not in_sight[cells].any()
            return level > 0, is_unseen, level, -float(covers[cells].max())

        return sorted(wanted, key=urgency)

    def drawn(there: Sequence[int], camera: Camera) -> set[int]:
        in_sight, shown = boxes.in_sight(camera), stream.levels_of(there)
        return {i for i in there if (in_sight & (shown == sets[i].level))[stream.cells_of[i]].any()}

    def scene(there: Sequence[int]) -> SplatParams | None:
        return stream.shown(there) if there else None

    sizes = [len(one.data) for one in sets]
    return Source(name, len(stream.manifest), sizes, [], order, drawn, scene)
