"""The scratch folder of a run: made, or found as an earlier run of the same files left it.

One run at a time has it. What is deleted there is what runs make, and nothing else.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from evogs_codec.common.progress import Progress
from evogs_codec.common.version import __version__
from evogs_codec.encoding.grids import TooFineError
from evogs_codec.errors import InputError
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.distinct import Distinct
from evogs_codec.jobs.engines import Call, Workers
from evogs_codec.jobs.partition import Partition, partition, rows_of, stand_ins_of
from evogs_codec.jobs.scratch_files import arrays_of, of_scratch
from evogs_codec.jobs.tile_tree import Tree

__all__ = ["do_missing", "identity_of", "partitioned", "scratch_folder"]

MARK, LOCK = "evogs-scratch.json", "evogs-scratch.lock"  # a folder with the mark is ours
# All that runs make there: of tiles by their numbers, of nodes of tilesets, and of all.
MADE = re.compile(
    r"\d{6}\..+|.+\.made|\.[0-9a-f]{8}\.tmp|partition\.npz|vectors\.npz|entries\.npz|tileset|streams"
)


@contextlib.contextmanager
def scratch_folder(
    folder: Path, identity: str, *, resume: bool, outside: Sequence[Path]
) -> Iterator[None]:
    """Make the scratch folder, or find it there; at the end of the run it is deleted.

    Args:
        folder: where it is.
        identity: of the run.
        resume: what is there may be used.
        outside: the output and the inputs, which must not be in it.

    Raises:
        InputError: another run uses the folder, it has files of others, or it is to be used and of
            another run.
    """
    inner = Path(os.path.realpath(folder))
    for path in outside:
        place = Path(os.path.realpath(path))
        if inner in (place, *place.parents):
            raise InputError(f"{path}: is in the folder {folder}: name another one for --scratch")
    there = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    if there - {LOCK} and MARK not in there:
        raise InputError(f"{folder}: is not empty and not a scratch folder of evogs")
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        _check_ours(folder)
        mark, ours = folder / MARK, {"run": identity, "evogs": __version__}
        if resume and mark.exists():
            with of_scratch(mark):
                said = json.loads(mark.read_text())
            if said != ours:
                raise InputError(
                    f"{folder}: is of other files, options or another version: without"
                    " --resume it is made anew"
                )
        else:
            _clear(folder)
            write_atomic(mark, json.dumps(ours).encode())
        yield
        _clear(folder)
    (folder / LOCK).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # of a link, or where we are, the emptied folder stays
        folder.rmdir()


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """While no other run has the folder, where the system has locks of files.

    Raises:
        InputError: another run has it.
    """
    with (folder / LOCK).open("ab") as file:
        if find_spec("fcntl") is not None:
            import fcntl

            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:  # others are of file systems that have no locks
                if isinstance(error, BlockingIOError):
                    said = "another run uses it: wait until it ends, or name another --scratch"
                    raise InputError(f"{folder}: {said}") from error
        yield


def _check_ours(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        if path.name not in (MARK, LOCK) and not MADE.fullmatch(path.name):
            said = f"{path.name} is there, which no run has made: name another --scratch"
            raise InputError(f"{folder}: {said}")


def _clear(folder: Path) -> None:
    """Delete what runs have made; the mark last, so that the folder is known until then."""
    for path in folder.iterdir():
        if not MADE.fullmatch(path.name):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    (folder / MARK).unlink(missing_ok=True)


def partitioned(
    files: SplatFiles,
    folder: Path,
    report: Progress,
    per_tile: int,
    distinct: Distinct | None = None,
) -> Partition:
    """The partition of the files in a scratch folder: made, or read if an earlier run made it.

    Args:
        files: of the splats.
        folder: the scratch folder.
        report: called with a stage and the part of it that is done.
        per_tile: splats of a tile, about.
        distinct: as of `partition`.

    Raises:
        InputError, OSError: as `partition`.
    """
    found = folder / "partition.npz"
    if found.exists():
        return _read_partition(folder, found, files.sh_degree)
    made = partition(files, folder, report, per_tile, distinct)
    if files.n_opaque:
        warnings.warn(
            f"{files.n_opaque:,} splats have an infinite opacity: a finite one is taken,"
            " which renders the same",
            stacklevel=4,
        )
    if files.n_invalid:
        warnings.warn(
            f"{files.n_invalid:,} splats with NaN or infinite numbers left out",
            stacklevel=4,
        )
    _write_partition(found, made)
    return made


def do_missing(
    workers: Workers,
    function: Callable[..., Any],
    calls: Sequence[Call],
    report: Progress,
    stage: str,
) -> TooFineError | None:
    """Run the jobs whose files, their last arguments, are not there.

    Returns:
        The `TooFineError` of the first of the calls that returns one, whichever ends first.
    """
    todo = [call for call in calls if not Path(call[-1]).exists()]
    done = len(calls) - len(todo)
    left, errors = set(range(len(todo))), dict[int, TooFineError]()
    for number, found in workers.run(function, todo):
        left.remove(number)
        if isinstance(found, TooFineError):
            errors[number] = found
        if errors and min(errors) < min(left, default=len(todo)):
            return errors[min(errors)]
        done += 1
        report(stage, done / len(calls))
    return None


def identity_of(paths: Sequence[Path], *options: object) -> str:
    """Of the files and options of a run."""
    files = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
    said = json.dumps([sorted(files), *options])
    return hashlib.sha256(said.encode()).hexdigest()


def _write_partition(path: Path, made: Partition) -> None:
    tree, files = made.tree, _files_of_tiles(path.parent, made.tree.n_tiles)
    for file in files:  # they are on the disk before it is said that they are whole
        with file.open("rb") as rows:
            os.fsync(rows.fileno())

    def fill(out: BinaryIO) -> None:
        np.savez(
            out,
            axis=tree.axis,
            value=tree.value,
            child=tree.child,
            origins=tree.origins,
            blocks=tree.blocks,
            counts=made.counts,
            largest=made.largest,
            sizes=made.sizes,
            n_vectors=made.n_vectors,
            n_bytes=[file.stat().st_size for file in files],
        )

    write_atomic(path, fill)


def _read_partition(folder: Path, path: Path, sh_degree: int) -> Partition:
    with arrays_of(path) as found:
        tree = Tree(
            found["axis"], found["value"], found["child"], found["origins"], found["blocks"]
        )
        tallied = found["counts"], found["largest"], found["sizes"]
        made = Partition(folder, tree, sh_degree, *tallied, int(found["n_vectors"]))
        n_bytes = found["n_bytes"].tolist()
    for file, n in zip(_files_of_tiles(folder, tree.n_tiles), n_bytes, strict=True):
        with of_scratch(file):
            if not file.exists() or file.stat().st_size != n:
                raise ValueError(f"not {n} bytes")
    return made


def _files_of_tiles(folder: Path, n_tiles: int) -> list[Path]:
    return [of(folder, tile) for tile in range(n_tiles) for of in (rows_of, stand_ins_of)]
