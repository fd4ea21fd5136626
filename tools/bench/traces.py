"""Connections that are replayed: how fast bytes come, by a clock that nobody waits for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["TRACES", "Arrival", "ByteRange", "Trace", "replay"]

F64 = npt.NDArray[np.float64]
ByteRange = tuple[int, int]  # from, and behind the last

STEP = 0.1  # s
HORIZON = 600.0  # s that a trace lasts
MEGABIT = 1e6 / 8
SEED = 5

# As evogs-fetch asks: bytes of a second, within bounds, and one request ahead.
FIRST, LEAST, MOST = 65_536, 65_536, 4 << 20
AHEAD = 2


@dataclass(frozen=True, eq=False)
class Trace:
    """A connection.

    Attributes:
        name: in tables.
        round_trip: s from a request to its first byte.
        rates: bytes a second, of each `STEP`.
    """

    name: str
    round_trip: float
    rates: F64

    def capacity(self, seconds: float) -> float:
        """Bytes that the connection could carry until then."""
        return float(np.interp(seconds, self._edges, self._carried))

    def when(self, capacity: npt.ArrayLike) -> F64:
        """The inverse: when it could have carried so many."""
        return np.asarray(np.interp(np.asarray(capacity), self._carried, self._edges))

    @property
    def _edges(self) -> F64:
        return np.arange(len(self.rates) + 1, dtype=np.float64) * STEP

    @property
    def _carried(self) -> F64:
        # A byte a second where nothing comes, so that there is an inverse.
        return np.concatenate([[0.0], np.cumsum(np.maximum(self.rates, 1.0) * STEP)])


@dataclass(frozen=True, eq=False)
class Arrival:
    """When bytes came, in the order in which they were asked for.

    Attributes:
        trace: by which they came.
        starts: (r + 1,) bytes before each request, and all.
        capacities: (r,) of the trace when the first byte of each request came.
    """

    trace: Trace
    starts: npt.NDArray[np.int64]
    capacities: F64

    @property
    def n_requests(self) -> int:
        """That were sent."""
        return len(self.capacities)

    def seconds(self, n_bytes: npt.ArrayLike) -> F64:
        """When so many bytes, 1 or more, were there."""
        wanted = np.asarray(n_bytes, np.float64)
        request = np.searchsorted(self.starts, wanted, side="left") - 1
        return self.trace.when(self.capacities[request] + wanted - self.starts[request])

    def stalls(self, after: int, longest: float) -> float:
        """Seconds of the gaps longer than `longest`, from byte `after` to the last."""
        at = np.unique(np.append(np.arange(after, self.starts[-1], 500), self.starts[-1]))
        gaps = np.diff(self.seconds(at))
        return float(gaps[gaps > longest].sum())


def replay(
    trace: Trace,
    size: int,
    fetch: Callable[[ByteRange], object],
    *,
    first: int = FIRST,
    requests: Sequence[int] = (),
) -> Arrival:
    """Ask for a file in requests one after the other, and say when its bytes came.

    A connection takes a round trip, and so does a request. The second request waits for the first
    one, which has the directory. Later ones are sent as the last but one ends.

    Args:
        trace: the connection.
        size: of the file.
        fetch: called with the range of each request.
        first: bytes of the first request.
        requests: bytes of each request, if they are known: all of the file together. Otherwise,
            after the first, what comes in a second.

    Raises:
        ValueError: the requests are not for the whole file.
    """
    if requests and sum(requests) != size:
        raise ValueError(f"requests of {sum(requests)} bytes for {size}")
    starts: list[int] = [0]
    capacities: list[float] = []
    ends: list[float] = []
    most = first
    while starts[-1] < size:
        k, start = len(ends), starts[-1]
        most = requests[k] if requests else most
        sent = ends[max(0, k - AHEAD)] if k else trace.round_trip
        begin = max(sent + trace.round_trip, ends[-1] if k else 0)
        end = min(start + most, size)
        fetch((start, end))
        starts.append(end)
        capacities.append(trace.capacity(begin))
        ends.append(float(trace.when(capacities[-1] + end - start)))
        rate = end / max(ends[-1] - 2 * trace.round_trip, 1e-3)  # as a client measures it
        most = int(min(MOST, max(LEAST, rate)))
    return Arrival(trace, np.array(starts), np.array(capacities))


def _constant(megabits: float, round_trip: float, name: str = "") -> Trace:
    rates = np.full(round(HORIZON / STEP), megabits * MEGABIT)
    return Trace(name or f"{megabits:g} Mbit/s", round_trip, rates)


def _dropping() -> Trace:
    """10 Mbit/s, of which nothing is left from 0.2 to 3.2 s, and from 5.2 to 8.2 s, and on."""
    trace = _constant(10, 0.02, "10 Mbit/s, dropping to 0")
    at = STEP * np.arange(len(trace.rates))
    return Trace(trace.name, trace.round_trip, np.where((at - 0.2) % 5 < 3 - 1e-9, 0, trace.rates))


def _like_lte() -> Trace:
    """The logarithm of the rate wanders around that of 12 Mbit/s; 60 ms of round trip."""
    rng = np.random.default_rng(SEED)
    wander, logs = 0.0, []
    for _ in range(round(HORIZON / STEP)):
        wander = 0.95 * wander + 0.25 * rng.normal()
        logs.append(wander)
    rates = 12 * MEGABIT * np.exp(np.array(logs))
    return Trace("like LTE", 0.06, np.clip(rates, 0.5 * MEGABIT, 60 * MEGABIT))


TRACES = (
    _constant(2, 0.02),
    _constant(10, 0.02),
    _constant(50, 0.02),
    _like_lte(),
    _dropping(),
    _constant(10, 0.2, "10 Mbit/s, 200 ms"),
)
