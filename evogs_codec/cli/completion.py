"""`evogs completion`: print the script that makes a shell complete commands and options."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from evogs_codec.cli.argument_types import path_or_url
from evogs_codec.cli.options import Commands, command_parser
from evogs_codec.errors import InputError

__all__ = ["SHELLS", "add_completion"]

SHELLS = ("bash", "zsh", "fish")
FOLDERS = ("DIR", "FOLDER")  # names of arguments that are folders


def add_completion(commands: Commands, every: Callable[[], argparse.ArgumentParser]) -> None:
    """`evogs completion`, of the options that `every` gives."""
    parser = command_parser(
        commands,
        "completion",
        lambda args: print(_script(every(), args.shell), end=""),
        "Print a script that completes commands, options and files of `evogs` in a shell.",
        "  evogs completion bash > ~/.local/share/bash-completion/completions/evogs\n"
        '  evogs completion zsh > "${fpath[1]}/_evogs"\n'
        "  evogs completion fish > ~/.config/fish/completions/evogs.fish",
    )
    parser.add_argument("shell", choices=SHELLS, help="the shell")


def _script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script of a shell.

    Raises:
        InputError: shtab, which makes it, is missing.
    """
    try:
        import shtab
    except ImportError:
        raise InputError("scripts are made by shtab: pip install shtab") from None
    _say_which_are_files(parser, shtab.FILE, shtab.DIRECTORY)
    script: str = shtab.complete(parser, shell=shell)
    return script


def _say_which_are_files(
    parser: argparse.ArgumentParser, file: dict[str, str], folder: dict[str, str]
) -> None:
    """Mark the arguments that are files or folders for shtab, also those of sub-commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in {id(sub): sub for sub in action.choices.values()}.values():
                _say_which_are_files(sub, file, folder)
        elif action.type in (Path, path_or_url):
            action.complete = folder if action.metavar in FOLDERS else file  # type: ignore[attr-defined]  # where shtab looks
