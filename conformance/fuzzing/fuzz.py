"""Differential fuzzing: streams of every kind, and what is wrong with their decoders.

`cli` says what the streams are and what they must do.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from random import Random
from typing import TypeVar

from conformance.decoders.outcomes import Outcome, Run, by_oracle
from conformance.decoders.reference import by_codec
from conformance.fuzzing import memory
from conformance.fuzzing.clock import Alarm, TooLong
from conformance.fuzzing.late_faults import late_fault, runs_beside_faults
from conformance.fuzzing.literals import damaged_literals
from conformance.generator.random_streams import random_stream
from conformance.generator.tampering import tampered

__all__ = ["FAMILIES", "VARIANTS", "Finding", "by_compiled", "check", "costly", "fuzz", "runs_of"]

FAMILIES = ("plain", "damaged", "literals", "late-faults", "costly")
KINDS = ("plain", *["damaged"] * 6, "literals", *["late-faults"] * 2)  # of the streams from one
COSTLY = 1000  # one of so many streams is costly
VARIANTS = len(KINDS)
N_TO_COMPILE = 3  # streams of a kind: one may have no packet
SHORT = 6000  # bytes of a costly stream that is decoded only to compile
SECONDS = 20  # of processor time that a decoder may take for a stream of a few kilobytes
COSTLY_SECONDS = 6  # the same for each result of a costly one: 2 on a machine of its own
LARGE_EVERY, LARGE_TIMES = 100, 40  # of so many random streams one has so many times the splats

T = TypeVar("T")


@dataclass(frozen=True)
class Finding:
    """A stream and a run in which something is wrong: `says` tells what."""

    data: bytes
    run: Run
    says: str


def fuzz(
    seed: int, first: int, count: int, family: str | None = None
) -> tuple[Counter[str], list[Finding]]:
    """Verdicts of streams number `first` and following, all of a family, and what is wrong."""
    verdicts, findings = Counter[str](), list[Finding]()
    compile_first()
    for number in range(first, first + count):
        rng = Random(f"{seed}/{number // VARIANTS}")
        if number % VARIANTS == 0 or number == first:
            is_large = number // VARIANTS % LARGE_EVERY == LARGE_EVERY - 1
            base = random_stream(rng, LARGE_TIMES if is_large else 1)
        rng = Random(f"{seed}/{number}/damage")
        if family == "costly" or (family is None and number % COSTLY == COSTLY - 1):
            data, verdict, says = costly(rng)
            verdicts[f"costly {verdict}"] += 1
            if says:
                findings.append(Finding(data, Run(), says))
            continue
        kind = family or KINDS[number % VARIANTS]
        data, runs = _made(kind, rng, base)
        for run in runs:
            is_late = kind == "late-faults"
            right = _right(data, run)
            if isinstance(right, str):
                verdict, says = "oracle", right
            else:
                verdict = _verdict(right)
                measures = not is_late or run.arrival is None
                says = _wrong(data, run, right, by_plain, measures=measures)
                is_main = run.mode == "file" and run.level is None
                if not says and (is_main or is_late):
                    says = _wrong(data, run, right, by_compiled)
            name = {"late-faults": "late fault", "literals": "literals"}.get(kind, run.mode)
            verdicts[f"{name} {verdict}"] += 1
            if says:
                findings.append(Finding(data, run, says))
    return verdicts, findings


@cache
def compile_first() -> None:
    """Decode streams of each kind before any clock runs, as to compile takes a minute.

    Once in a process. What is wrong with them is no finding: they are not of those asked for.
    """
    from conformance.fuzzing.costly import random_shape, stream_of  # as in `costly`
    from conformance.fuzzing.costly.trial import tried

    rng = Random("compile")
    with always_compiled():
        for _ in range(N_TO_COMPILE):
            base = random_stream(rng)
            for family in FAMILIES[:-1]:
                data, runs = _made(family, rng, base)
                for run in runs:
                    with suppress(Exception):
                        by_codec(data, run)
            with suppress(Exception):
                tried(stream_of(random_shape(rng), SHORT), lambda call: call())


def costly(rng: Random) -> tuple[bytes, str, str]:
    """A costly stream, whether it is legal, and what is wrong with the reference, or ""."""
    from conformance.fuzzing.costly import (
        costly_stream,  # fresh vectors need this module, but no codec
    )
    from conformance.fuzzing.costly.trial import tried

    def within(call: Callable[[], T]) -> T:
        with Alarm(COSTLY_SECONDS):
            return call()

    compile_first()
    data = costly_stream(rng)
    try:
        verdict, says = tried(data, within)
    except TooLong:
        return data, "", f"no end within {COSTLY_SECONDS} s"
    except Exception as error:
        return data, "", f"{type(error).__name__}: {error}"
    return data, verdict.split(" ")[0] if " at " in verdict else "0", says


def _made(family: str, rng: Random, base: bytes) -> tuple[bytes, Sequence[Run]]:
    """A stream of a family, made of another, and its runs."""
    if family == "late-faults":
        data = late_fault(rng, base)
        return data, runs_beside_faults(rng, data)
    if family == "literals":
        return damaged_literals(rng), [Run(), Run("progressive", dump_on_fault=True)]
    data = base if family == "plain" else tampered(rng, base)
    runs = runs_of(rng, data)
    return data, [replace(run, dump_on_fault=run.mode == "progressive") for run in runs]


def by_plain(data: bytes, run: Run) -> Outcome:
    """The outcome by the reference decoder without compiled loops, also where numba is loaded."""
    from evogs_codec.format import frames  # fresh vectors need this module, but no codec

    before, frames.MAY_COMPILE = frames.MAY_COMPILE, False
    try:
        outcome = by_codec(data, run)
    finally:
        frames.MAY_COMPILE = before
    return outcome


def by_compiled(data: bytes, run: Run) -> Outcome:
    """The outcome by the reference decoder with its compiled loops, however small the stream."""
    with always_compiled():
        return by_codec(data, run)


@contextmanager
def always_compiled() -> Iterator[None]:
    """The reference decoder uses its compiled loops, however small the stream."""
    from evogs_codec.decoding.compiled import (
        dispatch,  # fresh vectors need this module, but no codec
    )

    before, dispatch.MIN_COMPILED = dispatch.MIN_COMPILED, 0
    try:
        yield
    finally:
        dispatch.MIN_COMPILED = before


def runs_of(rng: Random, data: bytes) -> Iterator[Run]:
    """The runs of a stream: whole with digests, a level or limits, and in pieces."""
    yield Run(verify=True)
    level = rng.randrange(max(1, data[12])) if len(data) > 12 else 0
    names = ("n_tiles", "n_packets", "n_levels", "chunks_size", "tile_steps", "tile_slots", "slots")
    limits = {rng.choice(names): rng.choice((0, 1, 2, 3, 10, 300, 1000))}
    yield rng.choice((Run(level=level), Run(level=level, verify=True), Run(limits=limits)))
    arrival = rng.choice((None, _pieces(rng, len(data)), _pieces(rng, len(data), whole=True)))
    yield Run("progressive", arrival=arrival, limits=rng.choice((None, None, limits)))


def _pieces(rng: Random, size: int, *, whole: bool = False) -> tuple[tuple[int, int], ...]:
    """Ranges in random order, some overlapping; unless `whole`, some do not come."""
    cuts = sorted({0, size, *(rng.randrange(size + 1) for _ in range(rng.choice((0, 2, 5, 20))))})
    ranges = [
        (max(0, a - rng.choice((0, 0, 5))), b + rng.choice((0, 0, 5))) for a, b in pairwise(cuts)
    ]
    rng.shuffle(ranges)
    if not whole:
        del ranges[: rng.choice((0, 1, 1, 2))]
    if rng.random() < 0.5:  # mostly the head comes first, or little is decoded
        ranges.insert(0, (0, min(size, 64 + rng.randrange(1000))))
    return tuple((a, min(b, size) - a) for a, b in ranges)


def check(
    data: bytes,
    run: Run,
    *,
    measures: bool = False,
    decode: Callable[[bytes, Run], Outcome] = by_codec,
) -> tuple[str, str]:
    """(verdict of the oracle, what is wrong with the reference, or "")."""
    right = _right(data, run)
    if isinstance(right, str):
        return "oracle", right
    return _verdict(right), _wrong(data, run, right, decode, measures=measures)


def _verdict(outcome: Outcome) -> str:
    return f"{outcome.exit} {outcome.code or ''}".strip()


def _right(data: bytes, run: Run) -> Outcome | str:
    """The outcome by the oracle, or what is wrong with it."""
    try:
        with Alarm(SECONDS):
            return by_oracle(data, run)
    except (Exception, TooLong) as error:
        return f"oracle: {type(error).__name__}: {error}"


def _wrong(
    data: bytes,
    run: Run,
    right: Outcome,
    decode: Callable[[bytes, Run], Outcome],
    *,
    measures: bool = False,
) -> str:
    """What is wrong with a decoder whose outcome should be `right`, or ""."""
    came: list[Outcome] = []

    def call() -> None:
        came.append(decode(data, run))

    allowed, peak = _allowed(data, run, right), 0
    try:
        with Alarm(SECONDS):
            if measures:
                peak = memory.peak(call, allowed)
            else:
                call()
    except TooLong:
        return f"no end within {SECONDS} s"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    if came[0] != right:
        return f"reference: {_said(came[0])}; oracle: {_said(right)}"
    if peak > allowed:
        return f"{peak:,} bytes of memory, more than {allowed:,}"
    return ""


def _allowed(data: bytes, run: Run, outcome: Outcome) -> int:
    """Bytes of memory that a run may take."""
    dump = len(outcome.dump or b"")
    return memory.bound(data, grows=run.mode == "progressive", dump=dump)


def _said(outcome: Outcome) -> str:
    dump = ""
    if outcome.dump is not None:
        digest = hashlib.sha256(outcome.dump).hexdigest()
        dump = f", dump {digest[:8]} of {len(outcome.dump)} bytes"
    return f"exit {outcome.exit} {outcome.code} at {outcome.offset}{dump}"
