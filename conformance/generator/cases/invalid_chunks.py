"""Faults of the row of chunks, one each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from conformance.generator.builder import SPLIT, Chunk, Packet, Stream
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.edits import Edit, behind, changed, picked
from conformance.generator.cases.scenes import numbers

FAMILY = "invalid-chunks"
TWIN = "all-chunks"
ALL = Stream(
    [Packet(adds=numbers(2)), Packet(records={1: SPLIT}, psi=numbers(1))],
    alphas={(0, 2): (1, [3])},
    metadata={"title": "all"},
    digests={(0, 0, 1): None},
)
QUAN, ALFA, TILE, PACK, META, DIGESTS = range(6)  # in the list that is edited


def edited(edit: Edit) -> Stream:
    """ALL with another list of chunks."""
    return replace(ALL, chunks=edit)


def legal() -> Iterator[Case]:
    """What the faults are made from."""
    yield case(
        "all-chunks",
        ALL,
        "R-5.2-1 R-5.2-2 R-5.2-3 R-5.2-4 R-5.2-5",
        "all six chunks",
        "expects another number of chunks",
        runs=(FILE, replace(FILE, verify=True)),
    )


def extents() -> Iterator[Case]:
    """Chunks that do not fill their bytes."""
    for n in (11,):
        yield case(
            f"header-of-{n}-bytes",
            edited(behind(_Raw(bytes(n)))),
            "R-5.2-1",
            f"{n} bytes of 0 follow the last chunk within `chunks_size`",
            "ends when a chunk header does not fit, or reads it from the packets",
            "E_CHUNK",
            TWIN,
        )
    rows = [
        ("last-reaches-too-far", DIGESTS, 42, "the last chunk says a byte more than is left"),
        ("size-wraps", QUAN, 0xFFFFFFF4, "size and header of a chunk sum to 2^32"),
    ]
    for name, at, size, tests in rows:
        yield case(
            name,
            edited(changed(at, partial(replace, size=size))),
            "R-5.2-1",
            tests,
            "reads into the packets or past the file, or adds in 32 bits",
            "E_CHUNK",
            TWIN,
        )
    yield case(
        "none",
        edited(lambda _: []),
        "R-5.2-3",
        "no chunk at all",
        "decodes without tables",
        "E_CHUNK",
        TWIN,
        runs=(FILE, PROGRESSIVE),
    )
    bare = replace(ALL, packets=[], digests=None, chunks=behind(_Raw(b"teXt\0\0\0\0\0\0\0")))
    yield case(
        "header-cut-where-the-file-ends",
        bare,
        "R-5.2-1",
        "the file ends with eleven of the twelve bytes of a chunk header",
        "reads past the end of the file",
        "E_CHUNK",
        TWIN,
    )


def checksums() -> Iterator[Case]:
    """Checksums of chunks."""
    for at, name in ((QUAN, "step"), (PACK, "pack"), (META, "meta")):
        yield case(
            f"crc-of-{name}",
            edited(changed(at, partial(replace, crc=0x12345678))),
            "R-6.3-1 5.2",
            f"the checksum of {c_name(at)} is wrong",
            "checks the checksums of other chunks only",
            "E_CRC",
            TWIN,
        )
    yield case(
        "crc-of-unknown",
        edited(behind(Chunk(b"zzZz", b"abc", crc=0))),
        "R-6.3-1 R-8.1-2",
        "the checksum of an unknown ancillary chunk is wrong",
        "skips unknown chunks without a look at them",
        "E_CRC",
        "unknown-with-crc",
    )
    yield case(
        "unknown-with-crc",
        edited(behind(Chunk(b"zzZz", b"abc"))),
        "R-6.3-1 R-8.1-2",
        "an unknown ancillary chunk",
        "refuses it",
        runs=(FILE,),
    )


def c_name(at: int) -> str:
    """Type of a chunk of ALL."""
    return ("QUAN", "ALFA", "TILE", "PACK", "mETa", "dGST")[at]


def types() -> Iterator[Case]:
    """Chunk types that are none."""
    rows = [
        (b"z3Zz", "a digit for its second letter", "digit"),
        (b"zz3z", "a digit for its third letter", "digit-third"),
        (b"zzzz", "a small third letter", "third-small"),
        (b"z[Zz", "a character just above Z", "above-Z"),
        (b"z\xe4Zz", "a letter that is not of ASCII", "latin-letter"),
    ]
    for kind, tests, name in rows:
        yield case(
            f"type-{name}",
            edited(behind(Chunk(kind))),
            "R-5.2-2",
            f"a chunk type with {tests}",
            "looks only at the case bits, or asks a locale what a letter is",
            "E_CHUNK",
            "unknown-with-crc",
        )


def presence() -> Iterator[Case]:
    """Chunks that are missing, repeated or out of order."""
    for at, name in ((QUAN, "step"), (TILE, "tile"), (PACK, "pack")):
        yield case(
            f"without-{name}",
            edited(picked(*(k for k in range(6) if k != at))),
            "R-5.2-3",
            f"{c_name(at)} is missing",
            "takes a table for it that is empty, or fails without a verdict",
            "E_CHUNK",
            TWIN,
        )
    for at in (ALFA, PACK, META, DIGESTS):
        rule = "R-5.2-3" if at <= PACK else "R-5.2-4"
        yield case(
            f"two-{c_name(at).lower()}",
            edited(picked(*range(at), at, *range(at, 6))),
            rule,
            f"{c_name(at)} twice",
            "uses the first or the last of the two",
            "E_CHUNK",
            TWIN,
        )
    orders = [
        ("alfa-before-step", (ALFA, QUAN, TILE, PACK, META, DIGESTS)),
        ("pack-before-tile", (QUAN, ALFA, PACK, TILE, META, DIGESTS)),
        ("step-last", (META, ALFA, TILE, PACK, DIGESTS, QUAN)),
    ]
    for name, order in orders:
        yield case(
            name,
            edited(picked(*order)),
            "R-5.2-3",
            "critical chunks in the order " + " ".join(map(c_name, order)),
            "finds chunks by type and does not mind their order",
            "E_CHUNK",
            TWIN,
        )
    yield case(
        "alfa-again-at-the-end",
        edited(picked(*range(6), ALFA)),
        "R-5.2-3",
        "ALFA a second time, behind PACK",
        "minds only chunks that stand side by side",
        "E_CHUNK",
        TWIN,
    )
    yield case(
        "meta-again-far-away",
        edited(picked(META, *range(6))),
        "R-5.2-4",
        "mETa at the beginning and at the end",
        "minds only chunks that stand side by side",
        "E_CHUNK",
        TWIN,
    )


def unknown_critical() -> Iterator[Case]:
    """Critical chunks that no decoder of 1.0 knows."""
    rows = [
        (b"QUUX", "registered"), (b"QuUX", "private"),
        (b"STEp", "like-step"),
    ]  # fmt: skip
    for kind, name in rows:
        yield case(
            f"critical-{name}",
            edited(behind(Chunk(kind, b"?"))),
            "R-8.1-1 8.1",
            f"a critical chunk {kind.decode()}",
            "skips it like an ancillary one, or compares types without regard to case",
            "E_UNSUPPORTED",
            "unknown-with-crc",
            runs=(FILE, PROGRESSIVE),
        )


def sizes() -> Iterator[Case]:
    """Tables that are not as long as their rows."""
    rows: list[tuple[str, int, Callable[[bytes], bytes], str]] = [
        ("step-longer", QUAN, lambda body: body + b"\x01\0\0", "QUAN has an entry too many"),
        ("step-shorter", QUAN, lambda body: body[:-1], "QUAN lacks its last byte"),
        ("tile-longer", TILE, lambda body: body * 2, "TILE has two rows for one tile"),
        ("pack-shorter", PACK, lambda body: body[:-36], "PACK lacks its last row"),
        ("dgst-shorter", DIGESTS, lambda body: body[:-1], "dGST lacks its last byte"),
    ]
    for name, at, change, tests in rows:
        yield case(
            name,
            edited(changed(at, partial(_with, change))),
            "R-5.2-5",
            tests,
            "takes the number of rows from the size, or reads what is there",
            "E_CHUNK",
            TWIN,
        )


def _with(change: Callable[[bytes], bytes], chunk: Chunk) -> Chunk:
    return Chunk(chunk.kind, change(chunk.body))


class _Raw(Chunk):
    """Bytes that are no chunk."""

    def __bytes__(self) -> bytes:
        return self.kind


RECIPES: tuple[Recipe, ...] = (
    legal, extents, checksums, types, presence, unknown_critical, sizes,
)  # fmt: skip
