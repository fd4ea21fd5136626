"""Checkpoints: all that a run needs to go on to the same bytes, in one file, replaced whole.

The file is a `.npz` whose comment, at its end, is a seal: the SHA-256 of what comes before. The
seal is checked before anything is read from the file, so a checkpoint that was damaged is refused,
never gone on from.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
import numpy.typing as npt

from evogs_codec import InputError, SplatParams
from evogs_codec.common.printable import MAX_LINE, shown
from evogs_codec.io.files import FileKind, write_atomic
from evogs_codec.io.safe_npz import Npz
from evogs_codec.model.channels import N_GROUPS, n_channels
from evogs_codec.model.tree import Step
from reference_trainer.config import Config
from reference_trainer.methods.base import Done, Plan
from reference_trainer.models.saved import Arrays, taken

__all__ = ["FILE", "KIND", "Checkpoint", "refuse", "run_identity"]

FILE = "checkpoint.npz"
KIND = FileKind("checkpoint", (b"PK\x03\x04",), frozenset({"head.npy"}))
SEAL = b"SHA-256 "
SEAL_SIZE = len(SEAL) + 64 + 1  # in hexadecimal, and the end of the line
COMMENT = struct.Struct("<H")  # the last field of a zip: how long its comment is
BLOCK = 1 << 20
SCHEDULE = 2  # of training: one more where the same configuration trains otherwise than before
_SPLATS = ("means", "quats", "log_scales", "opacity_logits", "sh")
# What the head has besides the run, and of which type.
_HEAD = {"run": dict, "stage": int, "iteration": int, "sh_degree": int, "levels": list,
         "quanta": list, "rival_levels": list, "rival_quanta": list,
         "refines_save": list}  # fmt: skip


@dataclass(frozen=True)
class Checkpoint:
    """A run, stopped.

    Attributes:
        run: what must be the same to go on: configuration and data.
        stage: index of the stage under way.
        done: what the stages before it left.
        iteration: iterations of the stage that are done.
        model, scores: of the stage under way, empty at its beginning.
    """

    run: dict[str, Any]
    stage: int
    done: Done
    iteration: int
    model: Arrays
    scores: Arrays

    def write(self, folder: Path) -> None:
        """Replace the checkpoint in `folder`."""
        rival = self.done.rival or Done(self.done.sh_degree)
        head = {
            "run": self.run,
            "stage": self.stage,
            "iteration": self.iteration,
            "sh_degree": self.done.sh_degree,
            "levels": [step.level for step in self.done.steps],
            "quanta": self.done.quanta,
            "rival_levels": [step.level for step in rival.steps],
            "rival_quanta": rival.quanta,
            "refines_save": [x for x in (self.done.refines_save,) if x is not None],
        }
        text = json.dumps(head, sort_keys=True).encode()
        arrays: dict[str, npt.NDArray[Any]] = {"head": np.frombuffer(text, np.uint8)}
        for owner, steps in (("", self.done.steps), ("rival.", rival.steps)):
            for k, step in enumerate(steps):
                own = {f"{owner}step{k}.{name}": getattr(step, name) for name in _step_shapes(0)}
                arrays |= own
        if self.done.spare is not None:
            arrays |= {f"spare.{name}": getattr(self.done.spare, name) for name in _SPLATS}
        arrays |= {f"model.{name}": array for name, array in self.model.items()}
        arrays |= {f"scores.{name}": array for name, array in self.scores.items()}

        def save(stream: BinaryIO) -> None:
            np.savez(stream, allow_pickle=False, **dict(sorted(arrays.items())))
            stream.seek(-COMMENT.size, os.SEEK_END)
            stream.write(COMMENT.pack(SEAL_SIZE))
            stream.flush()
            stream.write(_seal(Path(stream.name), stream.tell()))

        write_atomic(folder / FILE, save)

    @staticmethod
    def read(folder: Path) -> Checkpoint | None:
        """The checkpoint in `folder`, if there is one.

        Raises:
            InputError: it is damaged, or not a checkpoint.
        """
        path = folder / FILE
        if not _is_sealed(path):
            return None
        arrays = _arrays(path)
        try:
            head = _head(arrays)
            degree = head["sh_degree"]
            rival = None
            if head["rival_levels"]:
                steps = _steps(arrays, "rival.", degree, head["rival_levels"])
                rival = Done(degree, steps, quanta=tuple(map(tuple, head["rival_quanta"])))
                _ = rival.tree  # says what is wrong with its steps
            done = Done(
                degree,
                _steps(arrays, "", degree, head["levels"]),
                _spare(arrays, degree),
                tuple(map(tuple, head["quanta"])),
                rival,
                *head["refines_save"],
            )
            _ = done.tree  # as above
        except ValueError as error:
            refuse(folder, error)
        model, scores = _named(arrays, "model."), _named(arrays, "scores.")
        return Checkpoint(head["run"], head["stage"], done, head["iteration"], model, scores)

    def check(self, folder: Path, identity: dict[str, Any], plans: Sequence[Plan]) -> None:
        """Refuse to go on with a run that this is not a checkpoint of.

        Args:
            folder: where it is.
            identity: of the run.
            plans: its stages.

        Raises:
            InputError: it is of another run, or no state that this run can be in.
        """
        if self.run != identity:
            raise InputError(
                f"{folder}: the checkpoint there is of another configuration or data;"
                " give the same ones, or another --checkpoint"
            )
        try:
            self._check_state(plans, identity["config"]["sh_degree"])
        except InputError as error:
            refuse(folder, error)

    def _check_state(self, plans: Sequence[Plan], sh_degree: int) -> None:
        if not 0 <= self.stage <= len(plans):
            raise InputError(f"stage is {self.stage}, expected 0 to {len(plans)}")
        most = plans[self.stage].iterations if self.stage < len(plans) else 0
        if not 0 <= self.iteration <= most:
            raise InputError(f"iteration is {self.iteration}, expected 0 to {most}")
        if bool(self.model) != bool(self.iteration) or bool(self.scores) != bool(self.iteration):
            raise InputError(f"what belongs to iteration {self.iteration} is not there, or is over")
        if self.done.sh_degree != sh_degree:
            raise InputError(f"SH degree is {self.done.sh_degree}, expected {sh_degree}")
        # What the finished stages leave.
        over = list(plans[: self.stage])
        again = self.stage < len(plans) and plans[self.stage].without_refines
        if again:
            level = plans[self.stage].level
            over = [plan for plan in over if plan.level != level or plan.without_refines]
            self._check_rival(level)
        elif self.done.rival is not None:
            raise InputError("there is a first attempt at a level, and no second one")
        is_decided = not again and any(plan.without_refines for plan in over)
        if (self.done.refines_save is not None) != is_decided:
            raise InputError("what refines save is missing, or is known already")
        last = max((plan.level for plan in over), default=-1)
        if self.done.tree.n_levels != last + 1:
            raise InputError(f"{self.done.tree.n_levels} levels are over, expected {last + 1}")
        if (self.done.spare is not None) != any(plan.level < 0 for plan in over):
            raise InputError("splats to spare are missing, or there are some")
        n_rounded = len({plan.level for plan in over if plan.in_integers})
        expected = 1 + n_rounded if n_rounded else 0
        if len(self.done.quanta) != expected:
            raise InputError(f"quanta have {len(self.done.quanta)} rows, expected {expected}")

    def _check_rival(self, level: int) -> None:
        """What the first attempt at a level left is a tree up to there, on the same levels."""
        done, rival = self.done, self.done.rival
        n_levels = 0 if rival is None else rival.tree.n_levels
        if rival is None or n_levels != level + 1 or len(rival.quanta) != 1 + n_levels:
            raise InputError(f"the first attempt at level {level} is not there, or is another one")
        before = [[step for step in of.steps if step.level < level] for of in (done, rival)]
        same = len(before[0]) == len(before[1]) and all(
            np.array_equal(getattr(a, name), getattr(b, name))
            for a, b in zip(*before, strict=True)
            for name in _step_shapes(0)
        )
        if not same or done.quanta != rival.quanta[: len(done.quanta)]:
            raise InputError(f"the first attempt at level {level} is on other levels")


def refuse(folder: Path, error: Exception) -> NoReturn:
    """Raise the error of a checkpoint that cannot be gone on from.

    Raises:
        InputError: always.
    """
    raise InputError(
        f"{folder / FILE}: is no checkpoint that can be gone on from: {error};"
        " delete it and start again"
    ) from error


def run_identity(config: Config, data: dict[str, Any]) -> dict[str, Any]:
    """What two runs must share to be one: JSON-able."""
    found = {"config": config.as_dict(), "data": data, "schedule": SCHEDULE}
    identity: dict[str, Any] = json.loads(json.dumps(found))
    del identity["config"]["checkpoint_every"]  # when it stops does not change where it goes
    return identity


class _Arrays(Npz):
    """Arrays of any type, of a file whose seal is right."""

    def array(self, key: str) -> npt.NDArray[Any]:
        """The array, whose size is checked before it is allocated."""
        self._entry(key)
        return self._read(key)


def _arrays(path: Path) -> Arrays:
    try:
        file = _Arrays(path)
        with file:
            return {name: file.array(name) for name in file.names}
    except InputError as error:
        raise InputError(f"{shown(error, MAX_LINE)}; delete it and start again") from error


def _is_sealed(path: Path) -> bool:
    """Whether there is a checkpoint.

    Raises:
        InputError: what is there has not the seal that belongs to it.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path}: is not a file; a checkpoint is one")
        size = found.st_size - SEAL_SIZE
        with path.open("rb") as file:
            file.seek(max(size, 0))
            fits = size >= 0 and file.read() == _seal(path, size)
    except FileNotFoundError:
        return False
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not fits:
        raise InputError(
            f"{path}: is no checkpoint that is whole, or is of an older version: it does not end"
            " with its SHA-256; delete it and start again"
        )
    return True


def _seal(path: Path, size: int) -> bytes:
    """What belongs behind the first `size` bytes of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while size > 0 and (block := file.read(min(size, BLOCK))):
            digest.update(block)
            size -= len(block)
    return SEAL + digest.hexdigest().encode() + b"\n"


def _head(arrays: Arrays) -> dict[str, Any]:
    text = taken(arrays, "head", np.uint8, None).tobytes()
    try:
        head = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"its head is not JSON: {shown(error)}") from error
    if not isinstance(head, dict) or set(head) != set(_HEAD):
        raise InputError(f"its head does not have {', '.join(_HEAD)}, and nothing else")
    for name, kind in _HEAD.items():
        if type(head[name]) is not kind:
            raise InputError(f"{name} is no {kind.__name__}")
    degree = head["sh_degree"]
    if not 0 <= degree <= 3:
        raise InputError(f"SH degree is {degree}, expected 0 to 3")
    saved = head["refines_save"]
    if len(saved) > 1 or not all(type(x) is float and math.isfinite(x) for x in saved):
        raise InputError("refines_save is no list of one finite number, or none")
    levels = (*head["levels"], *head["rival_levels"])
    if not all(type(level) is int and level >= 0 for level in levels):
        raise InputError("levels are no whole numbers of 0 or more")
    for row in (*head["quanta"], *head["rival_quanta"]):
        if not isinstance(row, list) or len(row) != N_GROUPS + degree:
            raise InputError(f"a row of quanta is no {N_GROUPS + degree} numbers")
        if not all(type(x) is float and 0 < x < math.inf for x in row):
            raise InputError("quanta are no finite numbers above 0")
    return head


def _steps(arrays: Arrays, owner: str, sh_degree: int, levels: list[int]) -> tuple[Step, ...]:
    """The steps of these levels, by the arrays whose names begin with `owner`."""
    shapes = _step_shapes(sh_degree)
    return tuple(
        Step(level, *(taken(arrays, f"{owner}step{k}.{name}", *shapes[name]) for name in shapes))
        for k, level in enumerate(levels)
    )


def _step_shapes(sh_degree: int) -> dict[str, tuple[npt.DTypeLike, *tuple[int | None, ...]]]:
    """Type and shape of each array of a step."""
    d = n_channels(sh_degree)
    return {
        "slots": (np.int32, None),
        "kinds": (np.uint8, None),
        "psi": (np.float32, d, None),
        "alpha": (np.float32, N_GROUPS, None),
        "adds": (np.float32, d, None),
    }


def _spare(arrays: Arrays, sh_degree: int) -> SplatParams | None:
    if "spare.means" not in arrays:
        return None
    sides = {"means": (3,), "quats": (4,), "log_scales": (3,), "opacity_logits": (),
             "sh": ((sh_degree + 1) ** 2, 3)}  # fmt: skip
    n = len(np.atleast_1d(arrays["spare.means"]))
    return SplatParams(
        *(taken(arrays, f"spare.{name}", np.float32, n, *sides[name]) for name in _SPLATS)
    )


def _named(arrays: Arrays, prefix: str) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
