"""Differential fuzzing: `python -m conformance.fuzzing --count N [--seed S] [--jobs J]`.

Random streams, and copies of them with damage behind right checksums, are decoded by the reference
decoder, with and without its compiled loops, and by the oracle: whole, by level, under limits, and
in pieces that come in any order. They must agree on verdict, fault code, offset and dump, which in
pieces is that of the state beside the fault; the reference may raise nothing but `StreamError`,
must end in time, and must keep to the memory of spec 8.3. What breaks this is made smaller and
kept as a file.

Of ten streams one is as it was made, six are `damaged` anywhere, one in its `literals`, and two
have `late-faults`, in the last checks of a packet. One of a thousand is `costly` instead: 100,000
bytes that ask for as much time and memory as they can. The oracle would take hours for these, so
the reference decoder is held to itself (whole and in pieces), to the clock, and to the memory of
each of its results.
`--family` asks for one kind alone.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from random import Random
from types import FrameType
from typing import TypeVar

from conformance.decoders.outcomes import Outcome, Run, by_oracle
from conformance.decoders.reference import by_codec
from conformance.fuzzing import memory
from conformance.fuzzing.late_faults import late_fault, runs_beside_faults
from conformance.fuzzing.literals import damaged_literals
from conformance.generator.random_streams import random_stream
from conformance.generator.tampering import Parts, tampered

__all__ = ["Finding", "check", "fuzz", "main", "smaller"]

FAMILIES = ("plain", "damaged", "literals", "late-faults", "costly")
KINDS = ("plain", *["damaged"] * 6, "literals", *["late-faults"] * 2)  # of the streams from one
COSTLY = 1000  # one of so many streams is costly
VARIANTS = len(KINDS)
BATCH = 50  # random streams of a task of a worker
N_TO_COMPILE = 3  # streams: one may have no packet
SECONDS = 20  # of processor time that a decoder may take for a stream of a few kilobytes
COSTLY_SECONDS = 6  # the same for each result of a costly one: 2 on a machine of its own
LARGE, TIMES = 100, 40  # of so many random streams one has so many times the splats
MOST_MADE_SMALLER = 50_000  # bytes: only costly streams have more
MOST_SHOWN = 20  # findings; more have the same cause, most likely

T = TypeVar("T")


@dataclass(frozen=True)
class Finding:
    """A stream and a run in which something is wrong: `says` tells what."""

    data: bytes
    run: Run
    says: str


class TooLong(BaseException):
    """A decoder did not end in time; no Exception, so that nothing catches it."""


def fuzz(
    seed: int, first: int, count: int, family: str | None = None
) -> tuple[Counter[str], list[Finding]]:
    """Verdicts of streams number `first` and following, all of a family, and what is wrong."""
    verdicts, findings = Counter[str](), list[Finding]()
    for k in range(N_TO_COMPILE):  # before any clock runs: to compile takes a minute
        by_compiled(random_stream(Random(f"compile {k}"), 1), Run())
    for number in range(first, first + count):
        rng = Random(f"{seed}/{number // VARIANTS}")
        if number % VARIANTS == 0 or number == first:
            is_large = number // VARIANTS % LARGE == LARGE - 1
            base = random_stream(rng, TIMES if is_large else 1)
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


def costly(rng: Random) -> tuple[bytes, str, str]:
    """A costly stream, whether it is legal, and what is wrong with the reference, or ""."""
    from conformance.fuzzing.costly import (
        costly_stream,  # fresh vectors need this module, but no codec
    )
    from conformance.fuzzing.costly.trial import tried

    def within(call: Callable[[], T]) -> T:
        with _alarm(COSTLY_SECONDS):
            return call()

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
    from evogs_codec.decoding.compiled import (
        dispatch,  # fresh vectors need this module, but no codec
    )

    before, dispatch.MIN_COMPILED = dispatch.MIN_COMPILED, 0
    try:
        outcome = by_codec(data, run)
    finally:
        dispatch.MIN_COMPILED = before
    return outcome


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
        with _alarm(SECONDS):
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
        with _alarm(SECONDS):
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


class _alarm:  # noqa: N801 - a context manager
    """Raise `TooLong` in the main thread after some seconds of processor time."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        self.before = signal.signal(signal.SIGPROF, self.ring)
        signal.setitimer(signal.ITIMER_PROF, self.seconds)

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, self.before)

    @staticmethod
    def ring(signum: int, frame: FrameType | None) -> None:
        raise TooLong


# ---- findings ----


def smaller(finding: Finding, *, decode: Callable[[bytes, Run], Outcome] = by_codec) -> Finding:
    """The finding with as much left out as leaves something of the kind wrong."""
    kind = _kind(finding.says)

    def is_wrong(candidate: Finding) -> bool:
        try:
            _, says = check(candidate.data, candidate.run, decode=decode)
        except Exception:  # too damaged for the oracle
            return False
        return bool(says) and _kind(says) == kind

    changed = True
    while changed:
        changed = False
        for candidate in _less(finding):
            if is_wrong(candidate):
                _, says = check(candidate.data, candidate.run, decode=decode)
                finding, changed = replace(candidate, says=says), True
                break
    return finding


def _kind(says: str) -> str:
    """Findings of one kind have the same cause, most likely."""
    return says.split(":")[0]


def _less(finding: Finding) -> Iterator[Finding]:
    """The finding without one thing: an option, a piece, a packet, a chunk, the end."""
    data, run = finding.data, finding.run
    plainer = (
        *(replace(run, verify=False), replace(run, limits=None), replace(run, level=None)),
        replace(run, dump_on_fault=False),
    )
    for plain in plainer:
        if plain != run:
            yield replace(finding, run=plain)
    if run.arrival is not None:
        yield replace(finding, run=replace(run, arrival=None))
        for k in range(len(run.arrival)):
            kept = run.arrival[:k] + run.arrival[k + 1 :]
            yield replace(finding, run=replace(run, arrival=kept))
        return  # offsets of pieces would not fit another stream
    for cut in (2, 4, 16):
        yield replace(finding, data=data[: len(data) - len(data) // cut])
    try:
        n_packets, n_chunks = len(Parts.of(data).packets), len(Parts.of(data).chunks)
    except (IndexError, ValueError):
        return
    for k in reversed(range(n_packets)):
        parts = Parts.of(data)
        rows = parts.table()
        del parts.packets[k], rows[36 * k : 36 * k + 36]
        parts.header[24 + 4 : 24 + 8] = len(parts.packets).to_bytes(4, "little")
        parts.fit()
        yield replace(finding, data=parts.join())
    for k in range(n_chunks):
        parts = Parts.of(data)
        del parts.chunks[k]
        yield replace(finding, data=parts.join())


def keep(finding: Finding, folder: Path) -> Path:
    """Write a finding: the stream, and beside it the run and what is wrong."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{abs(hash((finding.data, finding.says))) % (1 << 40):010x}"
    path = folder / f"{name}.evogs"
    path.write_bytes(finding.data)
    about = {"says": finding.says, "run": asdict(finding.run)}
    path.with_suffix(".json").write_text(json.dumps(about, indent=1))
    return path


# ---- command ----


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz and print a summary; 1 if something is wrong."""
    parser = argparse.ArgumentParser(prog="python -m conformance.fuzzing", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="streams (default 10,000)")
    parser.add_argument("--first", type=int, default=0, help="number of the first stream")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--family", choices=FAMILIES, help="streams of one kind (default: of all)")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write findings here")
    args = parser.parse_args(arguments)
    started, verdicts, n_findings, size = time.monotonic(), Counter[str](), 0, BATCH * VARIANTS
    end = args.first + args.count
    tasks = [(at, min(size, end - at)) for at in range(args.first, end, size)]
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for k, (seen, found) in enumerate(pool.imap(partial(_task, args.seed, args.family), tasks)):
            verdicts += seen
            for finding in found[: max(0, MOST_SHOWN - n_findings)]:
                print(_shown(finding, args.keep), flush=True)
            n_findings += len(found)
            if k % 10 == 9:
                done = sum(n for _, n in tasks[: k + 1])
                rate = done / (time.monotonic() - started)
                print(f"{done:,} streams, {rate:.0f} per second, {n_findings} findings", flush=True)
    seconds = time.monotonic() - started
    print("\n".join(_summary(verdicts)))
    print(f"{args.count:,} streams in {seconds:.0f} s, {n_findings} findings")
    return bool(n_findings)


def _shown(finding: Finding, folder: Path | None) -> str:
    """A line about a finding, made as small as it gets, and kept; a costly one as it is."""
    if len(finding.data) > MOST_MADE_SMALLER:
        path = f" ({keep(finding, folder)})" if folder else ""
        return f"{len(finding.data)} bytes: {finding.says}{path}"
    is_compiled = not check(finding.data, finding.run)[1]
    small = smaller(finding, decode=by_compiled if is_compiled else by_codec)
    path = f" ({keep(small, folder)})" if folder else ""
    return f"{len(small.data)} bytes, {small.run}: {small.says}{path}"


def _task(
    seed: int, family: str | None, task: tuple[int, int]
) -> tuple[Counter[str], list[Finding]]:
    return fuzz(seed, *task, family)


def _summary(verdicts: Mapping[str, int]) -> list[str]:
    return [f"{n:9,}  {name}" for name, n in sorted(verdicts.items(), key=lambda i: -i[1])]
