"""What the two producers of goldens make of a run: the oracle (or a mutant of it) and the codec.

A run is one call of a decoder as the command-line contract has it; an outcome is what it must give.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Any

from conformance import oracle

if TYPE_CHECKING:
    from evogs_codec import Cut, Directory

__all__ = ["EXITS", "Outcome", "Run", "by_codec", "by_oracle"]

ACCEPTED, REJECTED, INCOMPLETE, OVER_LIMIT, NOT_SUPPORTED = 0, 1, 3, 4, 127
EXITS = {"E_LIMIT": OVER_LIMIT, "E_UNSUPPORTED": NOT_SUPPORTED}  # all other faults: REJECTED


@dataclass(frozen=True)
class Run:
    """One call of a decoder.

    Attributes:
        mode: "file", or "progressive": the bytes are whatever came, and no more come.
        level: cut by this level; None for all packets.
        limits: the decoder's own limits by name (spec 8.3).
        verify: digests are checked.
        arrival: progressive: (offset, size) of the ranges that came, in order; None: all of it.
    """

    mode: str = "file"
    level: int | None = None
    limits: Mapping[str, int] | None = None
    verify: bool = False
    arrival: tuple[tuple[int, int], ...] | None = None


@dataclass(frozen=True)
class Outcome:
    """`exit` of the contract, fault code and offset if there is one, the dump if there is one."""

    exit: int
    code: str | None = None
    offset: int | None = None
    dump: bytes | None = None


def by_oracle(data: bytes, run: Run, module: ModuleType = oracle) -> Outcome:
    """The outcome by the oracle, or by a mutant of it.

    Raises:
        Exception: a mutant may raise anything else than its `Reject`.
    """
    decoder: Any = module
    limits = dict(run.limits or {})
    try:
        if run.mode == "file":
            scene = decoder.decode(data, level=run.level, check_digests=run.verify, limits=limits)
            return Outcome(ACCEPTED, dump=scene.dump())
        arrival = [(0, len(data))] if run.arrival is None else list(run.arrival)
        scene = decoder.decode_pieces(data, arrival, limits=limits)
    except decoder.Reject as fault:
        return _refused(run, fault.code, fault.offset)
    n_applied = sum(sum(tile.cut) for tile in scene.tiles)
    is_whole = n_applied == len(scene.packets)
    return Outcome(ACCEPTED if is_whole else INCOMPLETE, dump=scene.dump())


def by_codec(data: bytes, run: Run) -> Outcome:
    """The outcome by the reference decoder."""
    from evogs_codec import StreamError, decode

    try:
        if run.mode == "progressive":
            return _fed(data, run)
        decoded = decode(data, partial(_cut, run.level), verify=run.verify, limits=run.limits)
    except StreamError as error:
        return _refused(run, error.fault.name, error.offset)
    return Outcome(ACCEPTED, dump=decoded.dump())


def _cut(level: int | None, directory: Directory) -> Cut:
    from evogs_codec import Cut

    return Cut.full(directory) if level is None else Cut.of_level(directory, level)


def _fed(data: bytes, run: Run) -> Outcome:
    """All that came is fed, and the first fault but a missing packet is raised."""
    from evogs_codec import Decoder, Fault, StreamError
    from evogs_codec.decode import Decoded

    decoder = Decoder(limits=run.limits)
    for offset, size in ((0, len(data)),) if run.arrival is None else run.arrival:
        decoder.feed(data[offset : offset + size], offset)
    # Of packets that could be decoded; a fault behind a missing packet was not raised by feed.
    faults = sorted(decoder._faults.items())
    if faults:
        raise faults[0][1]
    try:
        decoder.close()
    except StreamError as error:
        if error.fault is not Fault.E_TRUNCATED:
            raise
        if decoder.directory is None:
            return _refused(run, "E_TRUNCATED", error.offset)
        if decoder._trailing:
            raise StreamError(Fault.E_TRAILING, "", decoder.directory.size) from None
    assert decoder.directory is not None
    exit_code = ACCEPTED if decoder._done.all() else INCOMPLETE
    decoded = Decoded(decoder.directory, decoder.cut, tuple(decoder._tiles), memoryview(data))
    return Outcome(exit_code, dump=decoded.dump())


def _refused(run: Run, code: str, offset: int) -> Outcome:
    if run.mode == "progressive" and code == "E_TRUNCATED":  # missing bytes are no fault there
        return Outcome(INCOMPLETE)
    return Outcome(EXITS.get(code, REJECTED), code, offset)
