"""Vectors made anew: `python -m conformance.fuzzing.fresh --seed S --count N --out DIR`.

Nobody can memorise their answers. DIR gets a manifest of the schema of the committed vectors, the
files and the goldens. The oracle says what is right; where the reference decoder is installed, it
must agree. Half of the streams are legal, and unlike what an encoder writes; the others have a
fault behind right checksums.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from random import Random

from conformance.fuzzing.fuzz import runs_of
from conformance.generator.cases.case import Case
from conformance.generator.random_streams import random_stream
from conformance.generator.suite import DisagreementError, Vector, agreed, write_suite
from conformance.generator.tampering import tampered

__all__ = ["fresh", "main"]

TRIES = 50  # to find a stream of the verdict wanted


def fresh(seed: int, number: int) -> Vector:
    """The vector of this seed and number: legal if the number is even.

    Raises:
        DisagreementError: the reference decoder is installed and does not agree with the oracle.
    """
    rng = Random(f"fresh {seed} {number}")
    is_legal = number % 2 == 0
    has_codec = find_spec("evogs_codec") is not None
    for _ in range(TRIES):
        data = random_stream(rng)
        data = data if is_legal else tampered(rng, data)
        runs = tuple(runs_of(rng, data))
        runs += tuple(replace(r, dump_on_fault=True) for r in runs if r.mode == "progressive")
        outcomes = tuple(agreed(data, run, has_codec=has_codec) for run in runs)
        if (outcomes[0].exit == 0) == is_legal:
            break
    fault = outcomes[0].code
    case = Case(
        f"{seed}-{number}",
        data,
        f"a random stream, {fault or 'legal'}",
        "fails on what its maker did not think of",
        ("R-4.1-2",) if fault is None else ("R-4.1-1",),
        fault,
        runs=runs,
    )
    provenance = f"conformance.fuzzing.fresh:fresh {seed} {number}"
    return Vector(f"fresh-{case.name}", "fresh", provenance, case, outcomes)


def main(argv: Sequence[str] | None = None) -> None:
    """Write a folder of fresh vectors."""
    parser = argparse.ArgumentParser(
        prog="python -m conformance.fuzzing.fresh", description=__doc__
    )
    parser.add_argument("--seed", type=int, required=True, metavar="S")
    parser.add_argument("--count", type=int, required=True, metavar="N")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    args = parser.parse_args(argv)
    try:
        vectors = [fresh(args.seed, number) for number in range(args.count)]
    except DisagreementError as finding:
        sys.exit(f"oracle and reference decoder do not agree: {finding}")
    write_suite(vectors, args.out)


if __name__ == "__main__":
    main()
