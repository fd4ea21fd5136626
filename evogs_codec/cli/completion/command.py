"""`evogs completion`: print the script that makes a shell complete commands and options."""

from __future__ import annotations

import argparse
from importlib.resources import files

from evogs_codec.cli.options import Commands, command_parser

__all__ = ["SHELLS", "add_completion", "run_completion"]

SHELLS = ("bash", "zsh", "fish")


def add_completion(commands: Commands) -> None:
    """`evogs completion`."""
    parser = command_parser(
        commands,
        "completion",
        run_completion,
        "Print a script that completes commands, options and files of `evogs` in a shell.",
        "  evogs completion bash > ~/.local/share/bash-completion/completions/evogs\n"
        '  evogs completion zsh > "${fpath[1]}/_evogs"\n'
        "  evogs completion fish > ~/.config/fish/completions/evogs.fish",
    )
    parser.add_argument("shell", choices=SHELLS, help="the shell")


def run_completion(args: argparse.Namespace) -> None:
    """`evogs completion`."""
    script = files(__package__).joinpath("scripts", f"evogs.{args.shell}")
    print(script.read_text(encoding="utf-8"), end="")
