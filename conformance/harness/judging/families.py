"""Families of cases too many to be files: every prefix and every flipped bit of a vector.

An entry of `families` in the manifest has `name`, `rule`, `of` (the id of an accepted vector),
`tests`, `faulty`, `requirements`, and what its rule needs:

- `every-prefix`: `dumps`, the hash of the dump with 0, 1, ... packets. In file mode every prefix
  is E_TRUNCATED; in progressive mode it is not complete and shows the packets that are.
- `every-bit-flip`: `exceptions`, numbers of the bits whose flip changes nothing. Every other flip
  is rejected.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from conformance.harness.manifest import Case, Run, Suite, SuiteError, Vector

__all__ = ["expand"]

HEADER_SIZE, PACKET_ROW = 64, 36
KEYS = {"name", "rule", "of", "tests", "faulty", "requirements"}


def expand(suite: Suite) -> Iterator[Case]:
    """The cases of all families.

    Raises:
        SuiteError: an entry is not of the form above.
    """
    by_id = {vector.id: vector for vector in suite.vectors}
    for entry in suite.families:
        rule = entry.get("rule")
        if rule not in RULES:
            raise SuiteError(f"families: the rule {rule!r} is not known")
        own, make = RULES[rule]
        if set(entry) != KEYS | {own}:
            raise SuiteError(f"families: {entry.get('name')}: keys unknown or missing")
        base = by_id.get(entry["of"])
        if base is None or not any(run.exit == 0 for run in base.runs):
            raise SuiteError(f"families: {entry['name']}: {entry['of']} is no accepted vector")
        vector = replace(
            base,
            id=entry["name"],
            family=rule,
            tests=entry["tests"],
            faulty=entry["faulty"],
            requirements=tuple(entry["requirements"]),
            near_miss_of=base.id,
            provenance=f"conformance.harness.judging.families, of {base.id}",
            kills=(),
        )
        yield from make(suite, vector, suite.read(base), entry)


def _prefixes(
    suite: Suite, vector: Vector, data: bytes, entry: Mapping[str, Any]
) -> Iterator[Case]:
    layout = _Layout.of(data)
    dumps = entry["dumps"]
    if len(dumps) != len(layout.ends) + 1:
        raise SuiteError(f"families: {vector.id}: a dump for each number of packets is needed")
    for dump in dumps:
        suite.golden(dump)
    for size in range(len(data) + 1):
        n_packets = sum(end <= size for end in layout.ends)
        is_whole, prefix = n_packets == len(layout.ends), data[:size]
        if size < len(data):
            run = Run(
                mode="file",
                level=None,
                limits=None,
                verify=False,
                arrival=None,
                exit=1,
                code="E_TRUNCATED",
                offset=layout.structure_at(size),
                dump=None,
            )
            yield Case(f"{vector.id}@{size}#0", vector, run, prefix)
        run = Run(
            mode="progressive",
            level=None,
            limits=None,
            verify=False,
            arrival=None,
            exit=0 if is_whole and size >= layout.data_at else 3,
            code=None,
            offset=None,
            dump=dumps[n_packets] if size >= layout.data_at else None,
        )
        yield Case(f"{vector.id}@{size}#1", vector, run, prefix)


def _flips(suite: Suite, vector: Vector, data: bytes, entry: Mapping[str, Any]) -> Iterator[Case]:
    accepted = next(run for run in vector.runs if run.exit == 0 and run.level is None)
    exceptions = set(entry["exceptions"])
    rejected = replace(accepted, exit=1, dump=None)
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit >> 3] ^= 1 << (bit & 7)
        run = accepted if bit in exceptions else rejected
        yield Case(f"{vector.id}@{bit}#0", vector, run, bytes(flipped))


RULES = {"every-prefix": ("dumps", _prefixes), "every-bit-flip": ("exceptions", _flips)}


@dataclass(frozen=True)
class _Layout:
    """Where the packets of a legal stream begin, and where each ends."""

    data_at: int
    ends: tuple[int, ...]

    @staticmethod
    def of(data: bytes) -> _Layout:
        data_at = HEADER_SIZE + struct.unpack_from("<I", data, 32)[0]
        at = HEADER_SIZE
        while data[at : at + 4] != b"PACK":
            at += 12 + struct.unpack_from("<I", data, at + 4)[0]
        (size,) = struct.unpack_from("<I", data, at + 4)
        ends, end = [], data_at
        for row in range(at + 12, at + 12 + size, PACKET_ROW):
            end += struct.unpack_from("<I", data, row + 8)[0]
            ends.append(end)
        return _Layout(data_at, tuple(ends))

    def structure_at(self, size: int) -> int:
        """Offset of what is cut short in a prefix of this size (spec 6.2)."""
        if size < HEADER_SIZE:
            return 0
        if size < self.data_at:
            return HEADER_SIZE
        starts = (self.data_at, *self.ends)
        return next(start for start, end in zip(starts, self.ends, strict=False) if end > size)
