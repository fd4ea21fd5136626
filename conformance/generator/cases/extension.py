"""What a later version or another program may put into a stream, and a 1.0 decoder ignores."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import Chunk, Packet, Stream
from conformance.generator.cases.case import FILE, Case, Recipe, case
from conformance.generator.cases.edits import behind
from conformance.generator.cases.scenes import SMALL

FAMILY = "extension"


def chunk_types() -> Iterator[Case]:
    """Ancillary chunks."""
    rows = [
        (b"exTe", "registered, safe to copy"),
        (b"exTE", "registered, unsafe to copy"),
        (b"eXTe", "of a second letter that is a capital"),
        (b"qUAN", "QUAN but for the case of its first letter"),
        (b"dGSt", "dGST but for the case of its last letter"),
    ]
    for kind, tests in rows:
        name = kind.decode()
        yield case(
            f"chunk-{name}-{''.join('c' if letter.isupper() else 's' for letter in name)}",
            replace(SMALL, chunks=behind(Chunk(kind, b"\0\xff body"))),
            "R-8.1-2 8.1",
            f"an unknown ancillary chunk: {tests}",
            "refuses it, or takes it for the chunk whose letters it has",
            runs=(FILE,),
        )


def chunk_places() -> Iterator[Case]:
    """Where and how often."""
    note = Chunk(b"noTe", b"1")
    rows = [
        ("empty", lambda c: [*c, Chunk(b"noTe")], "an unknown chunk without a body"),
        ("repeated", lambda c: [*[note] * 20, *c, *[note] * 20], "an unknown chunk forty times"),
        (
            "holding-a-chunk",
            lambda c: [Chunk(b"noTe", bytes(c[0])), *c],
            "a QUAN within an unknown chunk",
        ),
    ]
    for name, edit, tests in rows:
        yield case(
            f"chunk-{name}",
            replace(SMALL, chunks=edit),
            "R-8.1-2 R-5.2-1 5.2",
            tests,
            "searches for types or signatures instead of going from chunk to chunk",
            runs=(FILE,),
        )


def header() -> Iterator[Case]:
    """Unused flags and minor versions."""
    yield case(
        "flags-all-unused",
        replace(SMALL, header={"flags": 0xFF}),
        "R-4.4-2 5.1",
        "all flags but the reserved ones",
        "refuses some",
        runs=(FILE,),
    )
    for minor in (255,):
        yield case(
            f"minor-version-{minor}",
            replace(SMALL, header={"version_minor": minor}),
            "R-5.1-3 5.1",
            f"minor version {minor}",
            "refuses versions above its own, or reads 1.255 as 2",
            runs=(FILE,),
        )
    yield case(
        "later-version-with-everything",
        replace(
            SMALL,
            header={"version_minor": 7, "flags": 0x82, "unit": 200},
            chunks=lambda c: [Chunk(b"neWw", b"?"), *c, Chunk(b"neWw", b"?")],
        ),
        "R-5.1-3 R-4.4-2 R-8.1-2 8.1",
        "minor version, unused flags, unknown chunks and registry values at once",
        "supports each of them alone",
        runs=(FILE,),
    )


def empty_tables() -> Iterator[Case]:
    """Known chunks without rows."""
    scene = Stream([Packet(n_adds=1)], alphas={}, digests={}, metadata={})
    yield case(
        "alfa-empty",
        replace(scene, digests=None, metadata=None),
        "R-5.4-3 5.2",
        "ALFA without tables",
        "wants a table",
    )
    yield case(
        "dgst-empty",
        replace(scene, alphas=None, metadata=None),
        "R-5.2-5 R-5.7-4 5.2",
        "dGST without rows",
        "wants a row",
        runs=(FILE, replace(FILE, verify=True)),
    )
    yield case(
        "meta-empty",
        replace(scene, alphas=None, digests=None),
        "R-5.8-1 5.2",
        "mETa without entries",
        "wants an entry",
    )


RECIPES: tuple[Recipe, ...] = (chunk_types, chunk_places, header, empty_tables)
