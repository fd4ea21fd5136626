"""`evogs conformance run | selftest | explain | decoder | render`, for the command line."""

from __future__ import annotations

import argparse
from typing import Any

from conformance.harness.cli import add_commands
from conformance.renders.cli import add_run

__all__ = ["register"]

Commands = Any  # argparse's sub-parsers have no public type


def register(commands: Commands) -> None:
    """Add the commands to `evogs` (entry point of the group `evogs.commands`)."""
    parser = commands.add_parser(
        "conformance",
        help="Test any decoder or renderer, and explain what is wrong with it.",
        description="Test any decoder or renderer of EvoGS streams, and explain what is wrong.",
    )
    parts = parser.add_subparsers(metavar="COMMAND", required=True)
    add_commands(parts)
    _add_decoder(parts)
    add_run(parts, "render")


def _add_decoder(commands: Commands) -> None:
    from conformance.decoders.contract import add_options
    from conformance.decoders.reference import run_command

    parser: argparse.ArgumentParser = commands.add_parser(
        "decoder",
        help="run the reference decoder as a decoder under test",
        description="Run the reference decoder with the command line of a decoder under test"
        " (conformance/README.md). `python -m conformance.decoders.reference` is the same, and"
        " starts faster.",
    )
    parser.set_defaults(run=run_command)
    add_options(parser)
