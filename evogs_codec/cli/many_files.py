"""`--out-dir`: a command on many inputs, each of which becomes an output of its own."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from evogs_codec.cli.argument_types import path_or_url
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.files import same_file
from evogs_codec.stores.urls import Url

__all__ = ["add_many", "asks_for_folder", "run_many", "stem_of"]

OPTION = "--out-dir"
DOUBLE_ENDINGS = (".compressed.ply", ".tree.npz")
OF_ONE = {"page": "--report", "scratch": "--scratch"}  # options that one run alone may have
STOPS = (130, 141)  # exit codes after which nothing more is done

Place: TypeAlias = Path | Url


def asks_for_folder(words: Sequence[str]) -> bool:
    """Whether the words of a command line have `--out-dir`, so that all its files are inputs."""
    names = (word.partition("=")[0] for word in words)
    return any(len(name) > 3 and OPTION.startswith(name) for name in names)


def add_many(parser: argparse.ArgumentParser, to: Sequence[str]) -> None:
    """`--out-dir`, and `--to` where there is a choice of formats."""
    parser.add_argument(
        OPTION,
        type=_folder,
        metavar="DIR",
        help="all files are inputs, and each becomes a file of its own in this folder, named after"
        " it; one that fails does not stop the others",
    )
    if len(to) > 1:
        parser.add_argument(
            "--to", choices=to, help=f"with {OPTION}: the format (default: {to[0]})"
        )
    parser.set_defaults(default_ending=to[0])


def _folder(text: str) -> Place:
    """An argparse type: as `path_or_url`, of a folder that is named.

    Raises:
        argparse.ArgumentTypeError: the text is empty, as of a variable that is not set, or as of
            `path_or_url`.
    """
    if not text:
        raise argparse.ArgumentTypeError("is empty: name a folder, or . for this one")
    return path_or_url(text)


def run_many(args: argparse.Namespace, run_one: Callable[[argparse.Namespace], int]) -> int:
    """Run the command on each of `args.inputs`.

    Args:
        args: of the command, with `inputs` and `out_dir`.
        run_one: runs it on one input, says what went wrong in one line, returns the exit code.

    Returns:
        0 if all went well, 1 if some failed, or the code of what stopped it.

    Raises:
        InputError: nothing was done: outputs would be one file, or inputs, or have no name.
        OSError: the folder cannot be made.
    """
    for name, option in OF_ONE.items():
        if getattr(args, name, None) is not None:
            raise InputError(f"{option} is for one output: it does not go with {OPTION}")
    outputs = _outputs(args)
    made = isinstance(args.out_dir, Path) and not args.out_dir.exists()
    if isinstance(args.out_dir, Path):
        if args.out_dir.exists() and not args.out_dir.is_dir():
            raise InputError(f"{args.out_dir}: exists and is no folder")
        args.out_dir.mkdir(exist_ok=True)
    on_disk = [path for path in args.inputs if isinstance(path, Path)]
    n_failed = 0
    try:
        for source, output in outputs.items():
            own = {"input": source, "output": output, "others": [], "inputs": on_disk}
            code = run_one(argparse.Namespace(**{**vars(args), **own, "out_dir": None}))
            if code in STOPS:
                return code
            n_failed += code != 0
    finally:
        if made:
            with contextlib.suppress(OSError):  # it is not empty
                args.out_dir.rmdir()
    failed = f", {n_failed} failed" if n_failed else ""
    said = f"{len(outputs) - n_failed} of {len(outputs)} written to {shown(args.out_dir)}{failed}"
    print(said, file=sys.stderr if getattr(args, "json", False) else sys.stdout)
    return 1 if n_failed else 0


def _outputs(args: argparse.Namespace) -> dict[Place, Place]:
    """The output of each input.

    Raises:
        InputError: two inputs have the same, or one is an input.
    """
    ending = getattr(args, "to", None) or args.default_ending
    outputs: dict[Place, Place] = {}
    sources: dict[str, Place] = {}
    for source in args.inputs:
        name = f"{stem_of(source)}.{ending}"
        if name in sources:
            raise InputError(
                f"{source}: its output {name} is also that of {sources[name]}; nothing is written"
            )
        sources[name] = source
        output = _within(args.out_dir, name)
        for other in args.inputs:
            if isinstance(output, Path) and isinstance(other, Path) and same_file(output, other):
                raise InputError(f"{output}: is an input of the command; nothing is written")
        outputs[source] = output
    return outputs


def stem_of(source: Place) -> str:
    """The name of an input without its ending.

    Raises:
        InputError: it has none.
    """
    if source == Path("-"):
        raise InputError("-: standard input has no name for the output: name a file")
    if isinstance(source, Path) and source.name == "meta.json":  # of a .sog that is unpacked
        source = source.parent
    if isinstance(source, Path) and source.name in ("", ".."):
        source = source.resolve()
    name = source.name
    for ending in DOUBLE_ENDINGS:
        if name.lower().endswith(ending) and len(name) > len(ending):
            return name[: -len(ending)]
    return Path(name).stem


def _within(folder: Place, name: str) -> Place:
    if isinstance(folder, Url):
        return replace(folder, path=f"{folder.path}/{name}")
    return folder / name
