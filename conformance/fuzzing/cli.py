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
import multiprocessing
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from conformance.decoders.reference import by_codec
from conformance.fuzzing.fuzz import FAMILIES, VARIANTS, Finding, by_compiled, check, fuzz
from conformance.fuzzing.smaller import keep, smaller

__all__ = ["main"]

BATCH = 50  # random streams of a task of a worker
MOST_MADE_SMALLER = 50_000  # bytes: only costly streams have more
MAX_SHOWN = 20  # findings; more have the same cause, most likely


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
            for finding in found[: max(0, MAX_SHOWN - n_findings)]:
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
