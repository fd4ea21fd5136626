"""Checkpoints: all that a run needs to go on to the same bytes, in one file, replaced whole."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from evogs_codec import InputError, SplatParams
from evogs_codec.files import write_atomic
from evogs_codec.tree import Step
from reference_trainer.config import Config
from reference_trainer.methods import Done
from reference_trainer.optim import Arrays

__all__ = ["FILE", "Checkpoint", "run_identity"]

FILE = "checkpoint.npz"
_STEP = ("slots", "kinds", "psi", "alpha", "adds")
_SPLATS = ("means", "quats", "log_scales", "opacity_logits", "sh")


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
        head = {
            "run": self.run,
            "stage": self.stage,
            "iteration": self.iteration,
            "sh_degree": self.done.sh_degree,
            "levels": [step.level for step in self.done.steps],
            "quanta": self.done.quanta,
        }
        arrays: dict[str, npt.NDArray[Any]] = {"head": np.array(json.dumps(head, sort_keys=True))}
        for k, step in enumerate(self.done.steps):
            arrays |= {f"step{k}.{name}": getattr(step, name) for name in _STEP}
        if self.done.spare is not None:
            arrays |= {f"spare.{name}": getattr(self.done.spare, name) for name in _SPLATS}
        arrays |= {f"model.{name}": array for name, array in self.model.items()}
        arrays |= {f"scores.{name}": array for name, array in self.scores.items()}

        def save(stream: BinaryIO) -> None:
            np.savez(stream, allow_pickle=False, **arrays)

        write_atomic(folder / FILE, save)

    @staticmethod
    def read(folder: Path) -> Checkpoint | None:
        """The checkpoint in `folder`, if there is one.

        Raises:
            InputError: it is damaged.
        """
        path = folder / FILE
        if not path.exists():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            head = json.loads(str(arrays["head"]))
            steps = tuple(
                Step(level, *(arrays[f"step{k}.{name}"] for name in _STEP))
                for k, level in enumerate(head["levels"])
            )
            spare = None
            if "spare.means" in arrays:
                spare = SplatParams(*(arrays[f"spare.{name}"] for name in _SPLATS))
            return Checkpoint(
                head["run"],
                head["stage"],
                Done(head["sh_degree"], steps, spare, tuple(map(tuple, head.get("quanta", ())))),
                head["iteration"],
                _named(arrays, "model."),
                _named(arrays, "scores."),
            )
        except (OSError, ValueError, KeyError, EOFError) as error:
            raise InputError(f"{path}: is no checkpoint: {error}") from error


def run_identity(config: Config, data: dict[str, Any]) -> dict[str, Any]:
    """What two runs must share to be one: JSON-able."""
    identity: dict[str, Any] = json.loads(json.dumps({"config": config.as_dict(), "data": data}))
    del identity["config"]["checkpoint_every"]  # when it stops does not change where it goes
    return identity


def _named(arrays: Arrays, prefix: str) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
