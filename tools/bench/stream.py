"""Streams over connections that are replayed: when there is a picture, and how good it is."""

from __future__ import annotations

import http.client
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evogs_codec import Cut, decode, encode_scene, read_directory
from evogs_codec.cli.viewer.scenes import OneFile
from evogs_codec.cli.viewer.server import Server
from evogs_codec.format.directory import Directory
from evogs_codec.render.views import Views
from tools.bench.fetched import Fetched, sog_files, spz_file
from tools.bench.page import Rows
from tools.bench.prefix import by_level
from tools.bench.subjects import Subject
from tools.bench.traces import FIRST, TRACES, Arrival, ByteRange, Trace, replay

__all__ = ["Streams"]

I64 = npt.NDArray[np.int64]
F64 = npt.NDArray[np.float64]

VIEWS = 6
PLACES = 40  # of a stream, at which its picture is judged
GOOD = 30.0  # dB
PART_OF_FINAL = 0.9  # of the final PSNR
STALL = 0.5  # s
SECONDS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30)


@dataclass(frozen=True, eq=False)
class Streams:
    """Files of the subjects over all connections, measured once for both tables.

    Attributes:
        subjects: scenes and trees.
        folder: for files.
    """

    subjects: Callable[[], Sequence[Subject]]
    folder: Path

    def table(self) -> Rows:
        """Seconds from the click to pictures, by a clock of the replayed connection.

        The stream is that of `evogs encode` without options, with its packets in the order of the
        file, or level by level. The SPZ file is that of gsply, with SH rounded as SPZ's reference
        encoder rounds them, and comes in one request. The streamed SOG is a model: its layout is
        that of PlayCanvas, seven levels with half the splats each, every one of them a SOG set on
        its own; but the levels are those of our lifting instead of decimation, and the sets are
        written here, since splat-transform needs minutes for the SH of 40,000 splats. A client
        takes `lod-meta.json`, then the sets from the coarsest on, or the coarsest and the finest.
        Of a set with its seven or eight files it pays for one request. The scene playbot was itself
        decoded from SOG, so that a SOG of it is nearly exact. Requests go to the server of `evogs
        view`, and what comes is compared with the file; nobody waits for the clock. The client asks
        as `evogs-fetch` does: 64 kB with the directory first, then what comes in a second, one
        request ahead. A connection takes a round trip, and so does a request: 20 ms, 60 ms like
        LTE, and 200 ms. Like LTE: the rate wanders between 0.5 and 60 Mbit/s, around 12. Dropping:
        of each 5 s nothing comes for 3 s. Decoding and drawing are not in the times. PSNR is over 6
        views, against the scene: of the first splats, and after each of 39 equal parts of the other
        bytes, so that other times are up to 2.6 % of the bytes late. Stalls are the seconds after
        the first picture without a byte for more than 0.5 s.
        """
        return [_row(run) for run in self._measured]

    def curves(self) -> Rows:
        """PSNR so many seconds after the click. A cell is empty while there is no picture.

        What the table above sums up. The picture shows the last scene.
        """
        rows: Rows = []
        for run in self._measured:
            worth = [run.after(seconds) for seconds in SECONDS]
            cells = ["" if np.isnan(number) else f"{number:.2f}" for number in worth]
            row: dict[str, object] = {
                "scene": run.scene,
                "connection": run.arrival.trace.name,
                "file": run.file.name,
            }
            rows.append(row | dict(zip((f"{s:g} s" for s in SECONDS), cells, strict=True)))
        return rows

    @cached_property
    def _measured(self) -> list[_Run]:
        return [run for subject in self.subjects() for run in _runs(subject, self.folder)]


@dataclass(frozen=True, eq=False)
class _Run:
    """A file over a connection."""

    scene: str
    file: Fetched
    arrival: Arrival

    @cached_property
    def seconds(self) -> F64:
        """(n,) when each picture could be drawn."""
        return self.arrival.seconds(self.file.places)

    def until(self, decibels: float) -> float:
        """Seconds to a picture as good as this; NaN if there is none."""
        good = np.flatnonzero(self.file.decibels >= decibels)
        return float(self.seconds[good[0]]) if len(good) else float("nan")

    def after(self, seconds: float) -> float:
        """PSNR then; NaN while there is no picture."""
        n = int(np.searchsorted(self.seconds, seconds, side="right"))
        return float(self.file.decibels[n - 1]) if n else float("nan")


def _row(run: _Run) -> dict[str, object]:
    file, arrival = run.file, run.arrival
    n_bytes = int(arrival.starts[-1])

    def cell(seconds: float) -> str:
        return "" if np.isnan(seconds) else f"{seconds:.2f}"

    return {
        "scene": run.scene,
        "connection": arrival.trace.name,
        "file": file.name,
        "bytes": n_bytes,
        "first picture, s": cell(float(run.seconds[0])),
        "of the bytes, %": f"{100 * file.places[0] / n_bytes:.1f}",
        f"{GOOD:g} dB, s": cell(run.until(GOOD)),
        "90 % of the final PSNR, s": cell(run.until(PART_OF_FINAL * file.decibels[-1])),
        "all, s": cell(float(arrival.seconds(n_bytes))),
        "final, dB": f"{file.decibels[-1]:.2f}",
        "stalls, s": cell(arrival.stalls(int(file.places[0]), STALL)),
        "requests": arrival.n_requests,
    }


def _runs(subject: Subject, folder: Path) -> Iterator[_Run]:
    every = -(-len(subject.views.cameras) // VIEWS)
    views = replace(subject.views, cameras=subject.views.cameras[::every])
    for file in _files(subject, views, folder):
        with _server(file.path) as fetch:
            for trace in TRACES:
                run = _Run(subject.name, file, _replayed(trace, file, fetch))
                print(*_row(run).values(), sep=", ", file=sys.stderr, flush=True)
                yield run


def _replayed(trace: Trace, file: Fetched, fetch: Callable[[ByteRange], bytes]) -> Arrival:
    data = file.path.read_bytes()
    came = 0

    def checked(asked: ByteRange) -> None:
        nonlocal came
        if fetch(asked) != data[slice(*asked)]:
            raise RuntimeError(f"other bytes than those of {file.path}")
        came += asked[1] - asked[0]

    arrival = replay(trace, len(data), checked, first=file.first, requests=file.requests)
    if came != len(data):
        raise RuntimeError(f"{came} of {len(data)} bytes came")
    return arrival


@contextmanager
def _server(path: Path) -> Iterator[Callable[[ByteRange], bytes]]:
    """Asks the server of `evogs view` for a range of a file."""
    server = Server(("127.0.0.1", 0), {}, OneFile(path, "scene"))
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port)

    def fetch(asked: ByteRange) -> bytes:
        headers = {"Range": f"bytes={asked[0]}-{asked[1] - 1}"}
        connection.request("GET", "/scenes/scene", headers=headers)
        return connection.getresponse().read()

    try:
        yield fetch
    finally:
        connection.close()
        server.shutdown()
        thread.join()
        server.server_close()


# --- what is fetched ------------------------------------------------------------------------------


def _files(subject: Subject, views: Views, folder: Path) -> Iterator[Fetched]:
    data = encode_scene(subject.views.scene, up=subject.up)
    directory = read_directory(data)
    known: dict[tuple[bytes, int], float] = {}
    for name, order in (
        ("evogs", np.arange(len(directory.packets))),
        ("evogs, by level", by_level(directory)),
    ):
        path = folder / f"stream-{subject.name}-{name}"
        path.write_bytes(_in_order(data, directory, order))
        places, decibels = _pictures(data, directory, order, views, known)
        yield Fetched(name, path, FIRST, places, decibels)
    yield spz_file(subject, views, folder)
    yield from sog_files(subject, views, folder)


def _in_order(data: bytes, directory: Directory, order: I64) -> bytes:
    """Header, chunks, and the bytes of the packets in an order."""
    starts, sizes = directory.offsets, directory.packets["size"]
    packets = (data[starts[i] : starts[i] + int(sizes[i])] for i in order)
    return b"".join((data[: len(data) - int(sizes.sum())], *packets))


def _pictures(
    data: bytes,
    directory: Directory,
    order: I64,
    views: Views,
    known: dict[tuple[bytes, int], float],
) -> tuple[I64, F64]:
    """Numbers of bytes after which there is a better picture, and its PSNR."""
    packets = directory.packets
    sizes = packets["size"][order].astype(np.int64)
    ends = len(data) - int(sizes.sum()) + np.cumsum(sizes)
    adds = (packets["component"] == 0) & (packets["n_adds"] > 0)
    first = int(ends[np.flatnonzero(adds[order])[0]])
    wanted = np.linspace(first, len(data), PLACES)
    counts = np.unique(np.searchsorted(ends, wanted, side="right"))
    decibels = []
    for n in counts:
        cut = Cut.of_rows(directory, order[:n])
        key = cut.steps.tobytes(), cut.palette
        if key not in known:
            known[key] = views.psnr(decode(data, cut).leaves())
        decibels.append(known[key])
    return ends[counts - 1], np.array(decibels)
