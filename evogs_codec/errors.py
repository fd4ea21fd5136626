"""Errors at the border: `StreamError` for bad streams, `InputError` for what else was asked for.

Caller mistakes raise plain `ValueError` or `TypeError`; anything else that escapes is our bug.
"""

from __future__ import annotations

from evogs_codec._generated.faults import Fault

__all__ = ["EvogsError", "Fault", "InputError", "StreamError"]


class EvogsError(Exception):
    """The base of all errors of the codec."""


class InputError(EvogsError, ValueError):
    """A file that cannot be used, or a target that cannot be met: one line that says what to do."""


class StreamError(EvogsError):
    """The only error that the bytes of a stream can cause (spec 9).

    Attributes:
        fault: the fault code of `spec/faults.csv`.
        detail: what was found, in one line.
        offset: file offset in bytes of the structure at fault.
        section: section of `spec/evogs.md` that states the broken rule.
    """

    def __init__(self, fault: Fault, detail: str, offset: int, section: str | None = None) -> None:
        """`section` is that of the rule where it is not the one that the fault names."""
        self.fault = fault
        self.detail = detail
        self.offset = offset
        self.section = section or fault.section
        super().__init__(f"{fault.name} at byte {offset}: {detail} (spec {self.section})")
