"""The command line: `evogs encode`, `decode`, `info`, `view` and the others.

Other packages add commands through the entry-point group `evogs.commands`; each entry is a
function that takes the sub-parsers. Exit codes: 0 done, 1 the input is bad or a file cannot be
used, 2 usage, 130 interrupted, 141 nobody reads what is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path

from evogs_codec.cli import options
from evogs_codec.cli.comparing import add_compare
from evogs_codec.cli.completion import add_completion
from evogs_codec.cli.converting import run_convert
from evogs_codec.cli.editing import add_edit
from evogs_codec.cli.encode_and_lift import run_encode, run_lift
from evogs_codec.cli.many_files import asks_for_folder, run_many
from evogs_codec.cli.remote_files import remote_files, say_fetched
from evogs_codec.cli.reports import info_of, info_to_write, print_info
from evogs_codec.cli.standard_streams import standard_streams
from evogs_codec.cli.streams import (
    cut_of,
    describe_levels,
    describe_part,
    limits_of,
    located,
    open_stream,
    part_there,
    sh_degree_of,
    warn_of_float32,
)
from evogs_codec.cli.terminal import (
    complain,
    escape_what_cannot_be_encoded,
    plain_warnings,
    progress_bar,
)
from evogs_codec.cli.tilesets import (
    add_tileset,
    decode_tileset,
    info_tileset,
    is_tileset,
    validate_tileset,
)
from evogs_codec.cli.viewer.command import add_export, add_view
from evogs_codec.common.printable import shown
from evogs_codec.common.version import __version__
from evogs_codec.decoding.decode import decode, decode_leaves
from evogs_codec.editing.byte_stats import bytes_by_group, levels
from evogs_codec.editing.extract import choose_cut, extract
from evogs_codec.editing.omissions import omissions
from evogs_codec.editing.presence import level_presence
from evogs_codec.encoding.grids import NotRepresentableError
from evogs_codec.errors import Fault, InputError, StreamError
from evogs_codec.format.directory import read_directory
from evogs_codec.io.files import check_target, write_atomic
from evogs_codec.io.interchange.scene_files import write_scene
from evogs_codec.stores.remote_file import RemoteFile
from evogs_codec.stores.sources import bytes_of

__all__ = ["full_parser", "main", "parse", "run"]

STAGES = {"decode": "validate"}  # for those who validate
BENCH = "benchmarks work in a checkout: python -m tools.bench, python -m tools.bench.paper"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    return run(parse(arguments))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of a command; one that is not here is looked for in other packages.

    Raises:
        SystemExit: they were misused, or asked for help.
    """
    escape_what_cannot_be_encoded()
    words = sys.argv[1:] if arguments is None else list(arguments)
    return _parser(words[0] if words else "", many=asks_for_folder(words)).parse_args(words)


def run(args: argparse.Namespace) -> int:
    """Run the command of these options; returns the exit code."""
    try:
        if getattr(args, "out_dir", None) is not None:
            return run_many(args, run)
        ranged = args.run in (run_decode, run_info, run_validate, run_extract)
        with plain_warnings(), standard_streams(args), remote_files(args, keeps_input=ranged):
            _check_output(args)
            code = int(args.run(args) or 0)
            sys.stdout.flush()
            return code
    except StreamError as error:
        could_be_partial = error.fault is Fault.E_TRUNCATED and not getattr(args, "partial", True)
        return _fail(args, f"{error}; --partial takes what is there" if could_be_partial else error)
    except NotRepresentableError as error:
        return _fail(args, error)
    except InputError as error:
        complain(error)
        return 1
    except BrokenPipeError:
        # Nobody reads what is printed any more; Python would say so once more as it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # 128 + SIGPIPE, as shells have it
    except OSError as error:
        return _fail(args, error.strerror or error, path=error.filename)
    except ValueError as error:
        return _fail(args, error)
    except MemoryError:
        return _fail(args, "not enough memory")
    except KeyboardInterrupt:
        complain("interrupted")
        return 130  # 128 + SIGINT, as shells have it


def full_parser() -> argparse.ArgumentParser:
    """The options of all commands, those of other packages too."""
    return _parser()


def _parser(asked: str = "", *, many: bool = False) -> argparse.ArgumentParser:
    """The options of all commands, or at least of the one asked for; `many` with `--out-dir`."""
    parser = argparse.ArgumentParser(
        prog="evogs",
        description="Progressive streams of 3D Gaussian Splatting scenes.",
        epilog="Each command has examples: evogs encode --help",
    )
    parser.add_argument("--version", action="version", version=f"evogs {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    options.add_encode(commands, run_encode, many=many)
    options.add_decode(commands, run_decode, many=many)
    options.add_convert(commands, run_convert, many=many)
    options.add_lift(commands, run_lift)
    options.add_info(commands, run_info)
    options.add_validate(commands, run_validate)
    options.add_extract(commands, run_extract)
    add_edit(commands)
    add_tileset(commands)
    add_compare(commands)
    add_view(commands)
    add_export(commands)
    add_completion(commands, full_parser)
    others = () if asked in commands.choices else entry_points(group="evogs.commands")
    for entry in others:  # importing them takes longer than many commands do
        try:
            register = entry.load()
        except (ImportError, AttributeError) as error:  # of a package that was updated or removed
            complain(f"no command {entry.name}, install its package again: {error}")
            continue
        register(commands)
    bench = commands.add_parser("bench", description=BENCH)  # without help=: it is not listed
    bench.add_argument("_", nargs=argparse.REMAINDER)
    bench.set_defaults(run=run_bench)
    for command in commands.choices.values():
        command._negative_number_matcher = options.NO_OPTION
    return parser


def _check_output(args: argparse.Namespace) -> None:
    """Refuse outputs that must not be written; every other path of the command is a source."""
    if getattr(args, "to", None) is not None and "inputs" not in vars(args):
        raise InputError("--to: goes with --out-dir; the ending of an output says its format")
    targets = [name for name in ("output", "page") if getattr(args, name, None) is not None]
    sources = [path for name in set(vars(args)) - {*targets} for path in _paths(vars(args)[name])]
    for name in targets:
        target = getattr(args, name)
        kind, force = getattr(args, f"{name}_kind", None), getattr(args, "force", False)
        if callable(kind):  # the name of the output says it, if it may be an output
            check_target(target, command=args.command, sources=sources)
            kind = kind(target)
        check_target(target, kind, command=args.command, sources=sources, force=force)
    if len(targets) == 2 and _same_name(args.output, args.page):
        raise InputError(f"{args.page}: the output and the page need two names")


def _paths(value: object) -> list[Path]:
    """The paths that an option was given."""
    values = value if isinstance(value, list) else [value]
    return [path for path in values if isinstance(path, Path)]


def _same_name(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def _fail(args: argparse.Namespace, message: object, *, path: object = None) -> int:
    """Say it in one line, after the file that it is about, which is the input if none is named."""
    of = path or getattr(args, "input", None)
    complain(message if of is None else f"{of}: {message}")
    return 1


# --- commands ------------------------------------------------------------------------------------


def run_decode(args: argparse.Namespace) -> None:
    """`evogs decode`."""
    if is_tileset(args.input):
        decode_tileset(args)
        return
    if args.max_splats is not None:
        raise InputError("--max-splats is for a tileset: of a stream take a --level")
    source, directory = open_stream(args.input, limits_of(args))
    cut, part = cut_of(directory, args), ""
    if args.partial:
        cut = part_there(directory, source.size, cut, args.input)
        part = f", from {describe_part(directory, source.size)}"
    with progress_bar() as progress:
        splats = decode_leaves(
            source,
            cut,
            sh_degree=sh_degree_of(directory, args),
            directory=directory,
            verify=args.verify,
            progress=progress,
        )
    say_fetched(source)
    warn_of_float32(args.input, directory, splats)
    degree = write_scene(args.output, splats, info_to_write(directory), made_by=args.command)
    print(f"{shown(args.output)}: {len(splats):,} splats, SH degree {degree}{part}")


def run_info(args: argparse.Namespace) -> None:
    """`evogs info`."""
    if is_tileset(args.input):
        info_tileset(args)
        return
    source, directory = open_stream(args.input, limits_of(args))
    # Bytes by group need all packets, so they are not said of a URL.
    remote = source if isinstance(source, RemoteFile) else None
    whole = source.size >= directory.size and remote is None
    data = bytes_of(source) if whole else memoryview(b"")
    groups = bytes_by_group(directory, data) if whole else {}
    left_out = omissions(directory, data) if whole else []
    info = info_of(directory, source.size, groups, left_out)
    if remote is not None:
        info |= {"bytes_fetched": remote.n_fetched, "requests": remote.n_requests}
    if args.json:
        print(json.dumps(info, indent=2))
    else:
        print_info(directory, info, groups)


def run_validate(args: argparse.Namespace) -> int:
    """`evogs validate`."""
    if is_tileset(args.input):
        return validate_tileset(args)
    try:
        source, limits = located(args.input), limits_of(args)
        with progress_bar() as progress:
            decoded = decode(
                source,
                verify=True,
                limits=limits,
                progress=lambda stage, part: progress(STAGES.get(stage, stage), part),
            )
        say_fetched(source)
    except StreamError as error:
        if not args.json:
            raise
        report = {
            "valid": False,
            "fault": error.fault.name,
            "offset": error.offset,
            "section": error.section,
            "detail": error.detail,
        }
        print(json.dumps(report))
        return 1
    n_digests = len(decoded.directory.digests)
    if args.json:
        print(json.dumps({"valid": True, "splats": decoded.n_leaves, "digests": n_digests}))
    else:
        checked = f"{n_digests} digests match" if n_digests else "it has no digests to check"
        print(f"{shown(args.input)}: valid, {decoded.n_leaves:,} splats, {checked}")
    return 0


def run_extract(args: argparse.Namespace) -> None:
    """`evogs extract`."""
    source, directory = open_stream(args.input, limits_of(args))
    if directory.has_palette and 0 < (args.sh_degree or 0) < directory.sh_degree:
        said = "the entries of a palette have all SH bands: only --sh-degree 0 leaves packets out"
        warnings.warn(said, stacklevel=1)
    cut = cut_of(directory, args)
    with progress_bar() as progress:
        smaller = extract(source, cut, box=args.box, directory=directory, progress=progress)
    say_fetched(source)
    write_atomic(args.output, smaller)
    # Levels are counted against all levels of the tiles and SH bands that were asked for.
    whole = choose_cut(directory, sh_degree=sh_degree_of(directory, args), box=args.box)
    kept = describe_levels(level_presence(directory, cut, whole))
    n_kept, n_splats = (levels(of)[-1].n_leaves for of in (read_directory(smaller), directory))
    print(
        f"{shown(args.output)}: {kept}, {n_kept:,} of {n_splats:,} splats,"
        f" SH degree {cut.sh_degree(directory)} of {directory.sh_degree},"
        f" {len(smaller):,} of {directory.size:,} bytes"
    )


def run_bench(args: argparse.Namespace) -> None:
    """`evogs bench`: say where the benchmarks are, which the wheel does not install.

    Raises:
        InputError: always.
    """
    raise InputError(BENCH)


if __name__ == "__main__":
    sys.exit(main())
