"""The scratch folder of a run: made, or found as an earlier run of the same files left it."""

from __future__ import annotations

import hashlib
import json
import shutil
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evogs_codec.common.progress import Progress
from evogs_codec.common.version import __version__
from evogs_codec.errors import InputError
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.distinct import Distinct
from evogs_codec.jobs.engines import Call, Engine, run_jobs
from evogs_codec.jobs.partition import Partition, Tree, partition

__all__ = ["begin", "do_missing", "identity_of", "partitioned"]

MARK = "evogs-scratch.json"  # a folder that has it is ours to delete


def begin(folder: Path, identity: str, *, resume: bool) -> None:
    """Make the scratch folder, or find it there.

    Args:
        folder: where it is.
        identity: of the run.
        resume: what is there may be used.

    Raises:
        InputError: the folder is not ours, or is to be used and of another run.
    """
    mark = folder / MARK
    ours = {"run": identity, "evogs": __version__}
    if folder.exists() and any(folder.iterdir()):
        if not mark.exists():
            raise InputError(f"{folder}: is not empty and not a scratch folder of evogs")
        if resume and json.loads(mark.read_text()) != ours:
            raise InputError(
                f"{folder}: is of other files, options or another version: without"
                " --resume it is made anew"
            )
        if not resume:
            shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    mark.write_text(json.dumps(ours))


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
    engine: Engine,
    function: Callable[..., Any],
    calls: Sequence[Call],
    report: Progress,
    stage: str,
) -> int | None:
    """Run the jobs whose files, their last arguments, are not there.

    Returns:
        The first of their results that is not None.
    """
    todo = [call for call in calls if not Path(call[-1]).exists()]
    done = len(calls) - len(todo)
    for _, found in run_jobs(engine, function, todo):
        if found is not None:
            return int(found)
        done += 1
        report(stage, done / len(calls))
    return None


def identity_of(paths: Sequence[Path], *options: object) -> str:
    """Of the files and options of a run."""
    files = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
    said = json.dumps([sorted(files), *options])
    return hashlib.sha256(said.encode()).hexdigest()


def _write_partition(path: Path, made: Partition) -> None:
    tree = made.tree
    temporary = path.with_suffix(".tmp.npz")
    np.savez(
        temporary,
        axis=tree.axis,
        value=tree.value,
        child=tree.child,
        origins=tree.origins,
        blocks=tree.blocks,
        counts=made.counts,
        largest=made.largest,
        sizes=made.sizes,
        n_vectors=made.n_vectors,
    )
    temporary.replace(path)


def _read_partition(folder: Path, path: Path, sh_degree: int) -> Partition:
    with np.load(path) as found:
        tree = Tree(
            found["axis"], found["value"], found["child"], found["origins"], found["blocks"]
        )
        tallied = found["counts"], found["largest"], found["sizes"]
        return Partition(folder, tree, sh_degree, *tallied, int(found["n_vectors"]))
