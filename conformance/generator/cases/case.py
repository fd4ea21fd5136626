"""A case: the bytes of a vector, what it tests, and what its maker expects of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from conformance.decoders.outcomes import Run
from conformance.generator.builder import Stream, build

__all__ = ["FILE", "PROGRESSIVE", "VERIFY", "Case", "Recipe", "case"]

FILE, PROGRESSIVE, VERIFY = Run(), Run("progressive"), Run(verify=True)


@dataclass(frozen=True)
class Case:
    """A vector before its goldens.

    Attributes:
        name: id without the family.
        data: the file.
        tests: what it tests, a sentence.
        faulty: what a faulty decoder would do, a sentence.
        rules: requirement ids, and sections whose rules have no id of their own ("4.2").
        expect: fault code of the first run; None: accepted, or incomplete.
        twin: of a refused stream, the legal one from which only the fault tells it apart.
        runs: by default the file by each level and whole; of a refused one, the file.
    """

    name: str
    data: bytes
    tests: str
    faulty: str
    rules: tuple[str, ...]
    expect: str | None = None
    twin: str | None = None
    runs: tuple[Run, ...] = ()


Recipe = Callable[[], Iterator[Case]]


def case(
    name: str,
    stream: Stream | bytes,
    rules: str,
    tests: str,
    faulty: str,
    expect: str | None = None,
    twin: str | None = None,
    runs: tuple[Run, ...] = (),
) -> Case:
    """A case of a stream or of bytes; `rules` are separated by spaces."""
    data = build(stream) if isinstance(stream, Stream) else stream
    if not runs:
        runs = (FILE,)
        if expect is None and data[12] <= 4:
            runs += tuple(Run(level=level) for level in range(data[12] - 1))
    return Case(name, data, tests, faulty, tuple(rules.split()), expect, twin, runs)
