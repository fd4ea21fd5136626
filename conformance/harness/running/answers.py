"""What a decoder answered to one run, and the form that answers have (conformance/README.md)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conformance.harness.running.plain import plain, read_json

__all__ = ["EXITS", "Answer", "AnswerError", "Parcel", "read_entry", "read_fault"]

EXITS = (0, 1, 3, 4, 127)
MAX_OFFSET = 1 << 63
MAX_CODE = 40  # characters


class AnswerError(Exception):
    """A line of a decoder that is not what the contract allows."""


@dataclass(frozen=True)
class Answer:
    """The answer to a run.

    Attributes:
        exit: exit status, or that of the batch answer; None: there was none.
        output: the bytes of OUT; None: there is no such file.
        code, offset: of the fault, if the decoder says; plain text, cut to a length.
        trouble: why there is no answer to judge: "crash", "timeout", "memory", "output",
            "noise", "protocol"; "" if there is one.
        detail: the trouble in words.
        seconds, peak: wall time, and bytes of memory of the process so far.
    """

    exit: int | None
    output: bytes | None = None
    code: str | None = None
    offset: int | None = None
    trouble: str = ""
    detail: str = ""
    seconds: float = 0.0
    peak: int = 0

    def same_as(self, other: Answer) -> bool:
        """Whether all that is judged is the same."""
        return (self.exit, self.output or b"", self.code, self.offset, self.trouble) == (
            *(other.exit, other.output or b"", other.code, other.offset, other.trouble),
        )


@dataclass(frozen=True)
class Parcel:
    """The files of one run, under names that say nothing, and the options to go with them.

    `home` is an empty folder, where a process of this run starts.
    """

    home: Path
    source: Path
    target: Path
    mode: str
    level: int | None
    verify: bool
    limits: Path | None
    arrival: Path | None
    dump_on_fault: bool

    @property
    def folders(self) -> tuple[Path, Path]:
        """Where a decoder may write in this run."""
        return self.home, self.target.parent

    def arguments(self) -> list[str]:
        """As options of a command."""
        words = ["--in", str(self.source), "--out", str(self.target), "--mode", self.mode]
        words += [] if self.level is None else ["--level", str(self.level)]
        words += [] if self.limits is None else ["--limits", str(self.limits)]
        words += ["--verify"] if self.verify else []
        words += [] if self.arrival is None else ["--arrival", str(self.arrival)]
        words += ["--dump-on-fault"] if self.dump_on_fault else []
        return words

    def request(self, number: int) -> bytes:
        """As a line of the batch protocol."""
        entry: dict[str, Any] = {
            "id": number,
            "in": str(self.source),
            "out": str(self.target),
            "mode": self.mode,
        }
        entry |= {} if self.level is None else {"level": self.level}
        entry |= {} if self.limits is None else {"limits": str(self.limits)}
        entry |= {"verify": True} if self.verify else {}
        entry |= {} if self.arrival is None else {"arrival": str(self.arrival)}
        entry |= {"dump_on_fault": True} if self.dump_on_fault else {}
        return json.dumps(entry).encode() + b"\n"


def read_fault(said: bytes) -> tuple[str | None, int | None]:
    """(code, offset) of a line on standard output.

    Raises:
        AnswerError: it is not what the contract allows.
    """
    if b"\n" in said.rstrip(b"\n") or not said.strip():
        raise AnswerError("not one line")
    return _fault(_object(said))


def read_entry(line: bytes, number: int) -> tuple[int, str | None, int | None]:
    """(exit, code, offset) of a line of the batch protocol, which must answer this request.

    Raises:
        AnswerError: it is not what the contract allows.
    """
    entry = _object(line)
    answered, status = entry.pop("id", None), entry.pop("exit", None)
    if type(answered) is not int or answered != number:
        raise AnswerError(f"the answer is for id {_shown(answered)}, not {number}")
    if type(status) is not int or status not in EXITS:
        raise AnswerError(f"exit {_shown(status)} means nothing")
    return status, *_fault(entry)


def _object(raw: bytes) -> dict[str, Any]:
    try:
        entry = read_json(raw)
    except ValueError as error:
        raise AnswerError(str(error)) from None
    if not isinstance(entry, dict):
        raise AnswerError("not an object")
    return entry


def _fault(entry: dict[str, Any]) -> tuple[str | None, int | None]:
    code, offset = entry.pop("code", None), entry.pop("offset", None)
    if entry:
        raise AnswerError(f"unknown keys {plain(', '.join(sorted(entry)))}")
    if not isinstance(code, str | None) or type(offset) not in (int, type(None)):
        raise AnswerError("code is a string and offset an integer")
    if offset is not None and not 0 <= offset < MAX_OFFSET:
        raise AnswerError(f"offset {_shown(offset)} is not in 0..2^63 - 1")
    return None if code is None else plain(code, MAX_CODE), offset


def _shown(value: object) -> str:
    """A value of JSON; what it holds is not looked at."""
    if isinstance(value, dict | list):
        return "[...]" if isinstance(value, list) else "{...}"
    return plain(json.dumps(value))
