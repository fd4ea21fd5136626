"""The scripts of `evogs completion`, made from the options of all commands with shtab.

python -m tools.completions            # write them
python -m tools.completions --check    # fail if they are not those of the options
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import shtab

import evogs_codec.cli.completion
from evogs_codec.cli.argument_types import path_or_url
from evogs_codec.cli.commands import full_parser
from evogs_codec.cli.completion.command import SHELLS

FOLDER = Path(evogs_codec.cli.completion.__file__).parent / "scripts"


def main(arguments: list[str] | None = None) -> int:
    """Write the scripts, or check them; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.completions")
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args(arguments).check
    stale = 0
    for name, script in scripts().items():
        path = FOLDER / name
        if check and (not path.is_file() or path.read_text(encoding="utf-8") != script):
            print(f"{path} is stale: run python -m tools.completions", file=sys.stderr)
            stale = 1
        if not check:
            FOLDER.mkdir(exist_ok=True)
            path.write_text(script, encoding="utf-8")
    return stale


def scripts() -> dict[str, str]:
    """The script of each shell by the name of its file."""
    parser = full_parser()
    _complete_files(parser)
    return {f"evogs.{shell}": shtab.complete(parser, shell=shell) for shell in SHELLS}


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Say which arguments are files, also of sub-commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in {id(sub): sub for sub in action.choices.values()}.values():
                _complete_files(sub)
        elif action.type in (Path, path_or_url):
            kind = shtab.DIRECTORY if action.metavar in ("DIR", "FOLDER") else shtab.FILE
            action.complete = kind  # type: ignore[attr-defined]  # where shtab looks


if __name__ == "__main__":
    sys.exit(main())
