"""The process in which a checkout of the codec is measured."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

__all__ = ["Codec", "Measure"]

PROGRAM = Path(__file__).with_name("commands.py")


class Measure(NamedTuple):
    """What a command takes: seconds of the processor with start and imports, peak bytes above them.

    `ended` is "well", or says how else.
    """

    seconds: float
    peak: int
    ended: str


class Codec:
    """The codec of a checkout, in a process of its own that copies itself for each command."""

    def __init__(self, checkout: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.read_text(encoding="utf-8")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout)},
        )
        started = self._answer()
        self.start: float = started["seconds"]
        self._base: int = started["peak"]

    def __enter__(self) -> Codec:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.communicate()  # which closes its input

    def measure(self, command: str, stream: Path, turns: int = 1) -> Measure:
        """The least of some turns: a busy machine only adds."""
        found = [self._once(command, stream) for _ in range(turns)]
        return min(found, key=lambda one: one.seconds)._replace(peak=min(m.peak for m in found))

    def _once(self, command: str, stream: Path) -> Measure:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([command, str(stream)]) + "\n")
        self._process.stdin.flush()
        found = self._answer()
        seconds, peak = self.start + found["seconds"], max(0, found["peak"] - self._base)
        return Measure(seconds, peak, found["ended"])

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        return dict(json.loads(self._process.stdout.readline()))
