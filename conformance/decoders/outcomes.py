"""What the two producers of goldens make of a run: the oracle (or a mutant of it) and the codec.

A run is one call of a decoder as the command-line contract has it; an outcome is what it must give.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from conformance.decoders import oracle

__all__ = [
    "ACCEPTED",
    "EXITS",
    "INCOMPLETE",
    "OVER_LIMIT",
    "Outcome",
    "Run",
    "by_oracle",
    "refused",
]

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
        dump_on_fault: progressive: the dump of the state is given beside a fault too.
    """

    mode: str = "file"
    level: int | None = None
    limits: Mapping[str, int] | None = None
    verify: bool = False
    arrival: tuple[tuple[int, int], ...] | None = None
    dump_on_fault: bool = False


@dataclass(frozen=True)
class Outcome:
    """`exit` of the contract, fault code and offset if there is one, the dump if there is one."""

    exit: int
    code: str | None = None
    offset: int | None = None
    dump: bytes | None = None

    def fault(self) -> dict[str, Any]:
        """The fault as the contract reports it; empty if there is none."""
        return {} if self.code is None else {"code": self.code, "offset": self.offset}


def by_oracle(data: bytes, run: Run, module: ModuleType = oracle) -> Outcome:
    """The outcome by the oracle, or by a mutant of it.

    Raises:
        Exception: a mutant may raise anything else than its `FaultError`.
    """
    decoder: Any = module
    limits = dict(run.limits or {})
    try:
        if run.mode == "file":
            scene = decoder.decode(data, level=run.level, check_digests=run.verify, limits=limits)
            return Outcome(ACCEPTED, dump=scene.dump())
        arrival = [(0, len(data))] if run.arrival is None else list(run.arrival)
        scene = decoder.decode_what_came(data, arrival, check_digests=run.verify, limits=limits)
    except decoder.FaultError as fault:
        return refused(run, fault.code, fault.offset)
    if scene.faults:
        first, dump = scene.faults[0], scene.dump() if run.dump_on_fault else None
        return refused(run, first.code, first.offset, dump)
    n_applied = sum(sum(tile.cut) for tile in scene.tiles)
    is_whole = n_applied == len(scene.packets)
    return Outcome(ACCEPTED if is_whole else INCOMPLETE, dump=scene.dump())


def refused(run: Run, code: str, offset: int, dump: bytes | None = None) -> Outcome:
    """The outcome of a fault; `dump` is that of the state beside it, if there is one."""
    if run.mode == "progressive" and code == "E_TRUNCATED":  # missing bytes are no fault there
        return Outcome(INCOMPLETE)
    return Outcome(EXITS.get(code, REJECTED), code, offset, dump)
