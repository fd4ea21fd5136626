"""`evogs conformance run | selftest | explain`, also as `python -m conformance.harness`."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from conformance.harness.manifest import SuiteError
from conformance.harness.reporting.explain import explain
from conformance.harness.reporting.junit import as_junit
from conformance.harness.reporting.page import as_html
from conformance.harness.reporting.report import as_json
from conformance.harness.reporting.table import print_report
from conformance.harness.reporting.usage import (
    USAGE,
    UsageError,
    check_reports,
    check_sizes,
    command_of,
    write_reports,
)
from conformance.harness.runner import Options
from conformance.harness.running.plain import MOST_OF_LINE, plain, plain_lines, say
from conformance.harness.running.process import Bounds
from conformance.harness.selftest import self_test
from conformance.harness.trial import FAILED, INCOMPLETE, PASSED, Choice, draw_seed, families, hold

__all__ = ["add_commands", "main"]

Commands = Any  # argparse's sub-parsers have no public type
VECTORS = Path(__file__).resolve().parent.parent / "vectors"
MIB = 1 << 20


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m conformance.harness",
        description="Test any decoder of EvoGS streams, and explain what is wrong with it.",
    )
    add_commands(parser.add_subparsers(metavar="COMMAND", required=True))
    args = parser.parse_args(arguments)
    return int(args.run(args))


def add_commands(commands: Commands) -> None:
    """Add the commands to a parser."""
    _add_run(commands)
    _add_selftest(commands)
    _add_explain(commands)


def run_run(args: argparse.Namespace) -> int:
    """`run`; what cannot be asked or written is told before anything is asked."""
    try:
        command = command_of("--decoder", args.decoder)
        check_sizes(args, "jobs", "timeout", "memory")
        check_reports(args, "json", "junit", "html")
        _check_families(args)
    except UsageError as error:
        print(f"run: {plain(str(error), MOST_OF_LINE)}", file=sys.stderr)
        return USAGE
    options = Options(
        command=command,
        bounds=Bounds(args.timeout, args.memory * MIB),
        jobs=args.jobs,
        batch=not args.no_batch,
        seed=draw_seed() if args.seed is None else args.seed,
        passed=args.env,
        n_again=args.again,
    )
    choice = Choice(args.vectors, args.family, args.id, args.fresh, args.quick)
    trial = hold(choice, options, _progress)
    print_report(trial)
    reports = ((args.json, as_json), (args.junit, as_junit), (args.html, as_html))
    is_written = write_reports((path, partial(text_of, trial)) for path, text_of in reports)
    return trial.exit if is_written else trial.exit or INCOMPLETE


def _check_families(args: argparse.Namespace) -> None:
    """Each family asked for must be in the suite.

    Raises:
        UsageError: one is not.
    """
    try:
        known = families(args.vectors) if args.family else set()
    except SuiteError:  # told by the trial
        return
    unknown = [family for family in args.family if family not in known]
    if unknown:
        names = ", ".join(sorted(known))
        raise UsageError(f"--family: no {', '.join(unknown)} among {names}")


def run_selftest(args: argparse.Namespace) -> int:
    """`selftest`."""
    n, wrong, started = 0, 0, time.monotonic()
    try:
        for judged in self_test(args.vectors, names=args.names, jobs=args.jobs):
            n, wrong = n + 1, wrong + bool(judged.problems)
            state = "NOT AS WRITTEN" if judged.problems else "as written"
            say(f"{state:14}  {judged.seconds:5.1f} s  {judged.name}: {judged.says}")
            for problem in judged.problems:
                say(plain_lines(f"                    {problem}"))
    except SuiteError as error:
        say(plain_lines(f"INCOMPLETE: {error}"))
        return INCOMPLETE
    print(f"{n - wrong} of {n} judged as written in {time.monotonic() - started:.1f} s")
    return FAILED if wrong else PASSED


def run_explain(args: argparse.Namespace) -> int:
    """`explain`."""
    try:
        say(plain_lines(explain(args.vectors, args.id)))
    except SuiteError as error:
        print(f"explain: {plain(str(error))}", file=sys.stderr)
        return FAILED
    except BrokenPipeError:  # the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return PASSED


def _progress(done: int, all_: int) -> None:
    if sys.stderr.isatty() and (done % 50 == 0 or done == all_):
        print(f"\r{done} of {all_} runs", end="\n" if done == all_ else "", file=sys.stderr)


def _add_explain(commands: Commands) -> None:
    parser = commands.add_parser(
        "explain",
        help="show a test vector byte by byte",
        description="Show what a test vector tests, what is expected, and each of its bytes.",
    )
    parser.set_defaults(run=run_explain)
    parser.add_argument(
        "id", metavar="ID", help="a vector, or a case: every-prefix-of-core-two-tiles@371"
    )
    _add_vectors(parser)


def _add_vectors(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--vectors", type=Path, default=VECTORS, metavar="DIR", help="folder of the vectors"
    )


def _add_jobs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes"
    )


def _add_selftest(commands: Commands) -> None:
    parser = commands.add_parser(
        "selftest",
        help="test the harness on decoders that are wrong on purpose",
        description="Test decoders that are wrong on purpose; each must get its expected verdict.",
        epilog="exit codes: 0 all as expected; 1 some not; 2 usage error; 3 incomplete, no verdict",
    )
    parser.set_defaults(run=run_selftest)
    parser.add_argument("names", nargs="*", metavar="NAME", help="test only these decoders")
    _add_vectors(parser)
    _add_jobs(parser)


def _add_run(commands: Commands) -> None:
    parser = commands.add_parser(
        "run",
        help="test a decoder on all vectors",
        description="Run a decoder on all test vectors and check its answers.",
        epilog="exit codes: 0 passed; 1 failed; 2 usage error; 3 incomplete, no verdict",
    )
    parser.set_defaults(run=run_run)
    parser.add_argument("--decoder", required=True, metavar='"CMD"', help="command of the decoder")
    _add_vectors(parser)
    parser.add_argument(
        "--family", action="append", default=[], metavar="F", help="run only this family"
    )
    parser.add_argument(
        "--id", action="append", default=[], metavar="GLOB", help="run only these ids"
    )
    parser.add_argument(
        "--quick", action="store_true", help="skip prefixes, bit flips and fresh vectors"
    )
    parser.add_argument(
        "--fresh", type=int, metavar="N", help="number of new random vectors (default: 25)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="S", help="seed of fresh vectors (default: random, reported)"
    )
    _add_jobs(parser)
    parser.add_argument("--no-batch", action="store_true", help="start a process for each run")
    parser.add_argument(
        "--timeout", type=float, default=20.0, metavar="S", help="seconds per run (default: 20)"
    )
    parser.add_argument(
        "--memory",
        type=int,
        default=1024,
        metavar="MiB",
        help="memory of all its processes (default: 1024)",
    )
    parser.add_argument(
        "--again", type=int, default=12, metavar="N", help="runs to repeat (default: 12)"
    )
    parser.add_argument(
        "--env",
        action="append",
        default=[],
        metavar="NAME",
        help="pass on this environment variable",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write a JSON report")
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write a JUnit report")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write an HTML report")
