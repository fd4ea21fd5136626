"""`python -m conformance.renders run | generate | mutants | reference`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from conformance.harness.manifest import SuiteError
from conformance.harness.reporting.usage import (
    USAGE,
    UsageError,
    check_reports,
    check_sizes,
    command_of,
    write_reports,
)
from conformance.harness.running.plain import MOST_OF_LINE, plain, plain_lines, say
from conformance.harness.running.process import Bounds
from conformance.harness.trial import FAILED, INCOMPLETE, PASSED
from conformance.renders import reference
from conformance.renders.candidate import Renderer, ask_all
from conformance.renders.fingerprints import likenesses, read_fingerprints
from conformance.renders.manifest import FOLDER, load
from conformance.renders.report import Run, as_html, as_json, as_text, write_pictures

__all__ = ["add_run", "main"]

Commands = Any  # argparse's sub-parsers have no public type
MIB = 1 << 20


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m conformance.renders",
        description="Test any renderer of EvoGS streams against golden views.",
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    add_run(commands, "run")
    _add_generate(commands)
    _add_mutants(commands)
    help_ = "the reference renderer behind the command of a renderer under test"
    child = commands.add_parser("reference", help=help_, description=help_)
    child.set_defaults(run=reference.run_reference)
    reference.add_options(child)
    args = parser.parse_args(arguments)
    return int(args.run(args))


def add_run(commands: Commands, name: str) -> None:
    """Add the command that judges a renderer; `name`: what it is called there."""
    parser = commands.add_parser(
        name,
        help="test a renderer on all golden views",
        description="Run a renderer on all scenes and check its views: docs/render-conformance.md.",
        epilog="exit codes: 0 passed; 1 failed; 2 usage error; 3 incomplete, no verdict",
    )
    parser.set_defaults(run=run_run)
    parser.add_argument(
        "--renderer", required=True, metavar='"CMD"', help="command of the renderer"
    )
    parser.add_argument("--suite", type=Path, default=FOLDER, metavar="DIR")
    parser.add_argument(
        "--id", action="append", default=[], metavar="GLOB", help="run only these ids"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument("--timeout", type=float, default=60.0, metavar="S", help="per image")
    parser.add_argument("--memory", type=int, default=4096, metavar="MiB", help="per process")
    parser.add_argument(
        "--env", action="append", default=[], metavar="NAME", help="pass this variable on"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write a report")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a report")
    parser.add_argument(
        "--report",
        type=Path,
        default=Path("render-report"),
        metavar="DIR",
        help="where pictures of differences go, if any (default: render-report)",
    )


def run_run(args: argparse.Namespace) -> int:
    """`run`; what cannot be asked or written is told before anything is asked."""
    try:
        command = command_of("--renderer", args.renderer)
        check_sizes(args, "jobs", "timeout", "memory")
        check_reports(args, "json", "html")
    except UsageError as error:
        print(f"render: {plain(str(error), MOST_OF_LINE)}", file=sys.stderr)
        return USAGE
    try:
        suite = load(args.suite)
    except SuiteError as error:
        say(plain_lines(f"INCOMPLETE: {error}"))
        return INCOMPLETE
    globs = args.id or ["*"]
    images = [i for i in suite.images if any(fnmatchcase(i.id, glob) for glob in globs)]
    renderer = Renderer(command, Bounds(args.timeout, args.memory * MIB), tuple(args.env))
    results = []
    for result in ask_all(suite, images, renderer, jobs=args.jobs):
        results.append(result)
        if sys.stderr.isatty():
            end = "\n" if len(results) == len(images) else ""
            print(f"\r{len(results)} of {len(images)} images", end=end, file=sys.stderr)
    alike = likenesses(results, read_fingerprints(suite, args.suite))
    run = Run(suite, renderer.command, results, alike, len(images) == len(suite.images))
    say(as_text(run))
    reports = ((args.json, as_json), (args.html, as_html))
    is_written = write_reports((path, partial(text_of, run)) for path, text_of in reports)
    try:
        for path in write_pictures(run, args.report):
            say(plain(f"    {path}", MOST_OF_LINE))
    except OSError as error:
        is_written = False
        print(f"no pictures: {plain(str(error), MOST_OF_LINE)}", file=sys.stderr)
    return run.exit if is_written else run.exit or INCOMPLETE


def run_generate(args: argparse.Namespace) -> int:
    """`generate`."""
    # The recipes need the encoder and numba; judging needs neither.
    from conformance.renders.generate import check, write

    different = check(args.suite) if args.check else write(args.suite)
    for name in different:
        print(name)
    print(f"{len(different)} files {'differ' if args.check else 'written or removed'}")
    return FAILED if args.check and different else PASSED


def run_mutants(args: argparse.Namespace) -> int:
    """`mutants`."""
    from conformance.renders.trial import try_all

    code = PASSED
    for line in try_all(load(), args.names):
        print(line, flush=True)
        code = FAILED
    return code


def _add_generate(commands: Commands) -> None:
    help_ = "make streams, goldens and manifest anew"
    parser = commands.add_parser("generate", help=help_, description=help_)
    parser.set_defaults(run=run_generate)
    parser.add_argument("--check", action="store_true", help="only say what would change")
    parser.add_argument("--suite", type=Path, default=FOLDER, metavar="DIR")


def _add_mutants(commands: Commands) -> None:
    help_ = "judge wrong renderers; write their fingerprints and their table (minutes)"
    parser = commands.add_parser("mutants", help=help_, description=help_)
    parser.set_defaults(run=run_mutants)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these")
