"""Files of other formats as a client fetches them: after which bytes there is a better picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import gsply
import numpy as np
import numpy.typing as npt

from evogs_codec.render.views import Views
from tools.bench.peers import from_gsply, with_fewer_sh_bits, write_spz
from tools.bench.streamed_sog import SogStream, stream_levels
from tools.bench.subjects import Subject

__all__ = ["Fetched", "sog_files", "spz_file"]

I64 = npt.NDArray[np.int64]
F64 = npt.NDArray[np.float64]

SOG_CHUNK = 512 * 1024  # splats of a set, the default of splat-transform


@dataclass(frozen=True, eq=False)
class Fetched:
    """What is fetched.

    Attributes:
        name: in tables.
        path: of the file.
        first: bytes of the first request.
        places: (n,) numbers of bytes, rising, after which there is a better picture.
        decibels: (n,) of these pictures.
        requests: bytes of each request, if the client does not choose them.
    """

    name: str
    path: Path
    first: int
    places: I64
    decibels: F64
    requests: tuple[int, ...] = ()


def spz_file(subject: Subject, views: Views, folder: Path) -> Fetched:
    """An SPZ file: all or nothing."""
    splats = subject.views.scene
    spz = write_spz(with_fewer_sh_bits(splats), folder / f"stream-{subject.name}.spz")
    size = spz.stat().st_size
    worth = views.psnr(from_gsply(gsply.read_spz(spz), splats))
    return Fetched("SPZ 4", spz, size, np.array([size]), np.array([worth]))


def sog_files(subject: Subject, views: Views, folder: Path) -> Iterator[Fetched]:
    """A streamed SOG as two clients fetch it."""
    name = f"stream-{subject.name}-sog"
    levels = stream_levels(subject.views.scene)
    stream = SogStream.of(levels, SOG_CHUNK, folder / name)
    every = range(len(stream.sets))
    ends = [i for i in every if stream.sets[i].level in (0, len(levels) - 1)]
    known: dict[tuple[int, ...], float] = {}
    for policy, order in (("every level", every), ("coarsest, finest", ends)):
        requests = [len(stream.manifest), *(len(stream.sets[i].data) for i in order)]
        path = folder / f"{name}-{len(order)}.bin"
        path.write_bytes(b"".join([stream.manifest, *(stream.sets[i].data for i in order)]))
        decibels = []
        coarsest = sum(stream.sets[i].level == 0 for i in order)
        for n in range(coarsest, len(order) + 1):
            there = tuple(order[:n])
            if there not in known:
                known[there] = views.psnr(stream.shown(there))
            decibels.append(known[there])
        places = np.cumsum(requests)[coarsest:]
        first = requests[0]
        yield Fetched(
            f"streamed SOG, {policy}", path, first, places, np.array(decibels), tuple(requests)
        )
