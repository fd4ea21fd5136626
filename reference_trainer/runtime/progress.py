"""What a run says while it goes: a bar on the terminal, rows of a CSV file."""

from __future__ import annotations

import csv
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from tqdm import tqdm

from evogs_codec import InputError
from evogs_codec.io.files import FileKind
from reference_trainer.methods.base import Done, Plan
from reference_trainer.methods.refines_first import are_kept
from reference_trainer.models.backends import Backend
from reference_trainer.train import Training

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["LOG", "Progress"]

SECONDS_OF_A_LINE = 60  # where the bar is no bar: in a log
ROW_EVERY = 100  # iterations between two rows
N_LOOKED_AT = 4  # held-out views of a row's PSNR: all of them would cost more than training
COLUMNS = ("stage", "level", "iteration", "loss", "splats", "psnr", "seconds")
LOG = FileKind("log of a run", (",".join(COLUMNS).encode(),))


class Progress:
    """Says nothing by itself.

    Attributes:
        log: CSV file that gets a row every `ROW_EVERY` iterations, or None.
        shows_bar: whether there is a bar.
        refines_save: as of `Done`, when the run is over.
    """

    refines_save: float | None = None

    def __init__(self, log: Path | None = None, *, shows_bar: bool = False) -> None:
        self._log, self._shows_bar = log, shows_bar
        self._bar: tqdm | None = None
        self._before, self._began = 0.0, time.perf_counter()

    @property
    def seconds(self) -> float:
        """Since the run began, without what lay between an interruption and its resumption."""
        return self._before + time.perf_counter() - self._began

    def resume(self, stage: int, iteration: int) -> None:
        """The run goes on from here: later rows of an earlier attempt go.

        Raises:
            InputError: what is there is no log.
        """
        if self._log is None:
            return
        is_new = (stage, iteration) == (0, 0)
        rows = [] if is_new or not self._log.exists() else _rows_of(self._log)
        kept = [row for row in rows if (int(row[0]), int(row[2])) <= (stage, iteration)]
        self._before = float(kept[-1][-1]) if kept else 0.0
        self._write("w", [COLUMNS, *kept])

    def begin(self, stage: int, plan: Plan, data: Dataset, backend: Backend) -> None:
        """A stage begins."""
        self._stage, self._plan, self._data, self._backend = stage, plan, data, backend
        views = (data.test or data.train)[:N_LOOKED_AT]
        self._looked_at = [(view, backend.photograph(view.image)) for view in views]
        self._losses: list[float] = []
        if self._shows_bar:
            name = f"L{plan.level}" if plan.level >= 0 else "first"
            name += " without refines" if plan.without_refines else ""
            name += " in integers" if plan.in_integers else ""
            every = 0.1 if sys.stderr.isatty() else SECONDS_OF_A_LINE
            self._bar = tqdm(
                total=plan.iterations,
                desc=name,
                unit="it",
                dynamic_ncols=True,
                mininterval=every,
                maxinterval=every,
            )

    def each(self, training: Training) -> None:
        """An iteration is over."""
        self._losses.append(training.loss)
        if self._bar is not None:
            self._bar.update(training.iteration - self._bar.n)
        if self._log is None and self._bar is None:
            return
        if training.iteration % ROW_EVERY and training.iteration != self._plan.iterations:
            return
        n, found = training.model.n_splats, self._psnr(training)
        if self._bar is not None:
            self._bar.set_postfix_str(f"{found:.2f} dB, {n:,} splats")
        loss = float(np.mean(self._losses))
        self._losses.clear()
        level, done = self._plan.level, training.iteration
        figures = (f"{loss:.6g}", n, f"{found:.3f}", f"{self.seconds:.1f}")
        self._write("a", [(self._stage, level, done, *figures)])

    def end(self, done: Done) -> None:
        """The stage is over."""
        if self._bar is None:
            return
        self._bar.close()
        if self._plan.without_refines and done.refines_save is not None:
            have = "all levels have them" if are_kept(done.refines_save) else "no level has them"
            saved = f"{done.refines_save:.1%} of the bits of level {self._plan.level}"
            print(f"refines before splits save {saved}: {have}", file=sys.stderr)

    def finish(self, done: Done) -> None:
        """The run is over."""
        self.refines_save = done.refines_save

    def _psnr(self, training: Training) -> float:
        """Mean over a few held-out views; of training views where none is held out."""
        backend, background = self._backend, self._data.background
        with torch.no_grad():
            splats = training.model.splats(training.iteration)
            screen = backend.screen(splats)
            errors = []
            for view, photograph in self._looked_at:
                image = backend.render(splats, view.camera, background, screen).clamp(0, 1)
                assert image.shape == photograph.shape
                errors.append(float((image.double() - photograph).square().mean()))
        return float(np.mean([-10 * math.log10(error) if error else math.inf for error in errors]))

    def _write(self, mode: str, rows: list[Sequence[object]]) -> None:
        if self._log is None:
            return
        with self._log.open(mode, newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(rows)


def _rows_of(log: Path) -> list[list[str]]:
    """Rows of a log; a last one that an interruption cut short is left out.

    Raises:
        InputError: it is no log.
    """
    wrong = f"{log}: is no log of a run; delete it, or name another --checkpoint"
    try:
        if not log.is_file():
            raise InputError(wrong)
        with log.open(newline="", encoding="utf-8") as file:
            head, *rows = list(csv.reader(file)) or [list(COLUMNS)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(wrong) from error
    whole = [_is_whole(row) for row in rows]
    if head != list(COLUMNS) or not all(whole[:-1]):
        raise InputError(wrong)
    return rows if all(whole) else rows[:-1]


def _is_whole(row: list[str]) -> bool:
    kinds = (int, int, int, float, int, float, float)
    try:
        numbers = [kind(text) for kind, text in zip(kinds, row, strict=True)]
    except ValueError:
        return False
    return math.isfinite(numbers[-1])
