"""Canaries: two streams made anew for each report, so that no decoder can know their answers.

An unknown critical chunk must be answered 127, the same chunk as an ancillary one must change
nothing. A wrapper that says 127 to all, or looks answers up, does not pass both.
"""

from __future__ import annotations

import random
import string
import struct
import zlib
from dataclasses import replace

from conformance.harness.manifest import Case, Suite, SuiteError

__all__ = ["canaries"]

HEADER_SIZE, CHUNKS_SIZE_AT, CRC_AT = 64, 32, 60
KNOWN = {"QUAN", "ALFA", "TILE", "PACK", "dGST", "mETa"}


def canaries(suite: Suite, seed: int) -> list[Case]:
    """The two canaries, made of the smallest accepted vector.

    Raises:
        SuiteError: the suite has none.
    """
    candidates = [
        (vector.size, vector.id, vector, run)
        for vector in suite.vectors
        for run in vector.runs
        if run.mode == "file" and run.exit == 0 and run.level is None
        if not (run.limits or run.verify)
    ]
    if not candidates:
        raise SuiteError("no vector is accepted as a whole: canaries cannot be made")
    *_, vector, accepted = min(candidates, key=lambda item: item[:2])
    data, choice = suite.read(vector), random.Random(seed)
    unsupported = replace(accepted, exit=127, code="E_UNSUPPORTED", offset=HEADER_SIZE, dump=None)
    cases = []
    for name, run, says in (
        ("critical", unsupported, "an unknown critical chunk is refused with 127"),
        ("ancillary", accepted, "an unknown ancillary chunk changes nothing"),
    ):
        kind = _unknown_type(choice, critical=name == "critical")
        body = choice.randbytes(choice.randrange(4, 40))
        made = replace(
            vector,
            id=f"canary-{name}",
            family="canary",
            tests=says,
            faulty="does not look at chunk types, or knows its answers by heart",
            requirements=("R-8.1-1",) if name == "critical" else ("R-8.1-2",),
            runs=(run,),
            provenance=f"conformance.harness.judging.canary, seed {seed}, of {vector.id}",
        )
        cases.append(Case(f"{made.id}#0", made, run, _with_chunk(data, kind, body)))
    return cases


def _unknown_type(choice: random.Random, *, critical: bool) -> bytes:
    while True:
        letters = [choice.choice(string.ascii_letters) for _ in range(4)]
        letters[0] = letters[0].upper() if critical else letters[0].lower()
        letters[2] = letters[2].upper()
        if "".join(letters) not in KNOWN:
            return "".join(letters).encode()


def _with_chunk(data: bytes, kind: bytes, body: bytes) -> bytes:
    """`data` with one more chunk in front of the others (spec 5.1, 5.2)."""
    head = kind + struct.pack("<I", len(body))
    chunk = head + struct.pack("<I", zlib.crc32(head + body)) + body
    header = bytearray(data[:HEADER_SIZE])
    (size,) = struct.unpack_from("<I", header, CHUNKS_SIZE_AT)
    struct.pack_into("<I", header, CHUNKS_SIZE_AT, size + len(chunk))
    struct.pack_into("<I", header, CRC_AT, zlib.crc32(header[:CRC_AT]))
    return bytes(header) + chunk + data[HEADER_SIZE:]
