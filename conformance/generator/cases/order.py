"""Two faults each: the report names the one that comes first in the order of checks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import DROP, REFINE, SPLIT, Chunk, Packet, Stream, Tile, build
from conformance.generator.cases.case import FILE, VERIFY, Case, Recipe, case
from conformance.generator.cases.edits import Edit
from conformance.generator.cases.scenes import numbers

FAMILY = "order"
ADD = Packet(adds=numbers(3))
MIXED = Packet(records={0: SPLIT, 1: REFINE, 2: DROP}, psi=numbers(2, seed=1), level=1)
BASE = Stream(
    [ADD, MIXED],
    n_levels=2,
    alphas={(0, 0): (0, [1])},
    metadata={"a": "1"},
    digests={(0, 0, 0): None},
)
BAD_META, BAD_DIGESTS = Chunk(b"mETa", b"\0\0\0"), Chunk(b"dGST", b"\0")
Row = tuple[str, Stream | bytes, str, str]


def with_header(**fields: int | bytes) -> Stream:
    """BASE with other fields of the header."""
    return replace(BASE, header=fields)


def with_chunks(edit: Edit) -> Stream:
    """BASE with other chunks: QUAN, ALFA, TILE, PACK, mETa, dGST."""
    return replace(BASE, chunks=edit)


def with_packets(*packets: Packet) -> Stream:
    """BASE with other packets, without digests."""
    return replace(BASE, packets=packets, digests=None)


def zero_step(chunks: list[Chunk]) -> Chunk:
    """QUAN of zeros."""
    return Chunk(b"QUAN", bytes(len(chunks[0].body)))


def cases_of(rows: list[Row], section: str, run: Run = FILE) -> Iterator[Case]:
    """A case of each (name, stream, first fault, what is wrong)."""
    for name, stream, code, tests in rows:
        yield case(
            name,
            stream,
            f"R-6.1-1 {section}",
            f"{tests}: {code} is the first",
            "checks in another order and reports the other fault",
            code,
            "legal",
            runs=(run,),
        )


def legal() -> Iterator[Case]:
    """What the faults are made from."""
    yield case("legal", BASE, "R-6.1-1 6.1", "no fault", "reports one", runs=(FILE, VERIFY))


def headers() -> Iterator[Case]:
    """Step 1."""
    data = build(BASE)
    rows: list[Row] = [
        (
            "signature-and-version",
            with_header(signature=b"\x89EVH\r\n\x1a\n", version_major=2),
            "E_SIGNATURE",
            "signature and version are wrong",
        ),
        (
            "truncated-and-version",
            build(with_header(version_major=2))[:63],
            "E_TRUNCATED",
            "63 bytes of a header of another version",
        ),
        (
            "version-and-crc",
            with_header(version_major=2, crc=0),
            "E_VERSION",
            "version and crc are wrong",
        ),
        (
            "crc-and-reserved",
            with_header(crc=0, flags=0x8000),
            "E_CRC",
            "crc wrong, a reserved flag set",
        ),
        ("crc-and-tier", with_header(crc=0, tier=9), "E_CRC", "crc and tier are wrong"),
        (
            "reserved-and-tier",
            with_header(tier=0, reserved=b"\1" * 16),
            "E_RESERVED",
            "reserved bytes set, tier 0",
        ),
        (
            "levels-0-and-tiles",
            with_header(n_levels=0, n_tiles=65),
            "E_HEADER",
            "no level, 65 tiles",
        ),
        (
            "grid-and-tiles",
            with_header(grid_exponents=b"\x7f" * 5, n_tiles=65),
            "E_HEADER",
            "grid exponents of 127, 65 tiles",
        ),
        (
            "tier-and-data-size",
            with_header(n_packets=16385, data_size=0),
            "E_TIER",
            "16385 packets, `data_size` 0",
        ),
        (
            "tier-and-truncated-chunks",
            build(with_header(n_tiles=65))[:100],
            "E_TIER",
            "65 tiles, the chunks are cut",
        ),
        (
            "truncated-chunks-and-chunk",
            data[: 64 + 11],
            "E_TRUNCATED",
            "the file ends in the first chunk header",
        ),
    ]
    yield from cases_of(rows, "R-6.3-2 6.1")
    limited: list[Row] = [
        (
            "own-levels-and-tiles",
            with_header(n_tiles=65),
            "E_LIMIT",
            "levels over the decoder's own limit, 65 tiles",
        ),
        (
            "tier-levels-and-own",
            with_header(n_levels=65),
            "E_TIER",
            "65 levels, also over the decoder's own limit",
        ),
    ]
    yield from cases_of(limited, "R-8.3-1 R-8.2-1", Run(limits={"n_levels": 1}))


def chunks() -> Iterator[Case]:
    """Steps 2 and 3."""
    rows: list[Row] = [
        (
            "fit-and-crc",
            with_chunks(lambda x: [*x[:-1], replace(x[-1], size=999, crc=0)]),
            "E_CHUNK",
            "a chunk does not fit, its crc is wrong",
        ),
        (
            "crc-and-type",
            with_chunks(lambda x: [*x, Chunk(b"1234", crc=1)]),
            "E_CRC",
            "a type of digits, its crc wrong",
        ),
        (
            "crc-and-repeated",
            with_chunks(lambda x: [x[0], replace(x[0], crc=1), *x[1:]]),
            "E_CRC",
            "a second QUAN, its crc wrong",
        ),
        (
            "type-and-unsupported",
            with_chunks(lambda x: [*x, Chunk(b"QUuX")]),
            "E_CHUNK",
            "a critical type with a small third letter",
        ),
        (
            "unsupported-and-later-crc",
            with_chunks(lambda x: [Chunk(b"QUUX"), replace(x[0], crc=1), *x[1:]]),
            "E_UNSUPPORTED",
            "an unknown critical chunk, then a wrong crc",
        ),
        (
            "crc-and-later-unsupported",
            with_chunks(lambda x: [replace(x[0], crc=1), Chunk(b"QUUX"), *x[1:]]),
            "E_CRC",
            "a wrong crc, then an unknown critical chunk",
        ),
        (
            "unsupported-and-missing",
            with_chunks(lambda x: [*x[:3], Chunk(b"QUUX")]),
            "E_UNSUPPORTED",
            "an unknown critical chunk, PACK is missing",
        ),
        (
            "missing-and-step",
            with_chunks(lambda x: [zero_step(x), *x[1:3]]),
            "E_CHUNK",
            "M of 0, PACK is missing",
        ),
        (
            "order-and-step",
            with_chunks(lambda x: [x[1], zero_step(x), *x[2:]]),
            "E_CHUNK",
            "M of 0, QUAN behind ALFA",
        ),
        (
            "meta-in-front-and-step",
            with_chunks(lambda x: [BAD_META, zero_step(x), *x[1:4]]),
            "E_STEP",
            "an empty key in mETa, which is first in the file, and M of 0",
        ),
        (
            "digests-in-front-and-pack",
            with_chunks(lambda x: [BAD_DIGESTS, *x[:3], Chunk(b"PACK", b"\xff" * 72)]),
            "E_RESERVED",
            "dGST, first in the file, of a wrong size, and reserved bytes in PACK",
        ),
        (
            "meta-before-digests",
            with_chunks(lambda x: [*x[:4], BAD_META, BAD_DIGESTS]),
            "E_CHUNK",
            "mETa and, behind it, dGST faulty",
        ),
        (
            "step-size-and-step",
            with_chunks(lambda x: [Chunk(b"QUAN", bytes(3)), *x[1:]]),
            "E_CHUNK",
            "QUAN of one entry, which has M of 0",
        ),
        (
            "step-and-alpha",
            with_chunks(lambda x: [zero_step(x), Chunk(b"ALFA", b"\0"), *x[2:]]),
            "E_STEP",
            "M of 0, ALFA of one byte",
        ),
        (
            "alpha-and-tile",
            with_chunks(lambda x: [x[0], Chunk(b"ALFA", b"\0\7\0\0\0\0"), Chunk(b"TILE"), *x[3:]]),
            "E_ALPHA",
            "group 7, TILE is empty",
        ),
        (
            "tile-and-pack",
            replace(
                BASE, tiles=[Tile((1 << 60, 0, 0))], packets=[replace(ADD, tile=5)], digests=None
            ),
            "E_TILE",
            "an origin of 2^60, a packet of tile 5",
        ),
        (
            "alpha-domain-and-entries",
            with_chunks(lambda x: [x[0], Chunk(b"ALFA", b"\0\0\x0d\xff"), *x[2:]]),
            "E_ALPHA",
            "K of 13, and no entries",
        ),
        (
            "meta-size-and-key",
            with_chunks(lambda x: [*x[:4], Chunk(b"mETa", b"\0\5\0")]),
            "E_META",
            "an empty key, and a value past the chunk",
        ),
        (
            "pack-and-data-size",
            replace(BASE, packets=[replace(ADD, tile=1)], digests=None, header={"data_size": 1}),
            "E_CHAIN",
            "a packet of a tile that is none, and a wrong `data_size`",
        ),
        (
            "data-size-and-digests",
            replace(with_chunks(lambda x: [*x[:4], BAD_DIGESTS]), header={"data_size": 1}),
            "E_HEADER",
            "`data_size` is wrong, dGST too",
        ),
        (
            "data-size-and-packet",
            replace(
                BASE,
                packets=[replace(ADD, row={"crc": 1}), MIXED],
                header={"data_size": 1},
                digests=None,
            ),
            "E_HEADER",
            "`data_size` and the crc of a packet are wrong",
        ),
        (
            "meta-and-packet",
            replace(
                BASE,
                packets=[replace(ADD, row={"crc": 1}), MIXED],
                digests=None,
                chunks=lambda x: [*x[:4], BAD_META],
            ),
            "E_META",
            "mETa and a packet are faulty",
        ),
    ]
    yield from cases_of(rows, "5.2 6.1")


RECIPES: tuple[Recipe, ...] = (
    legal,
    headers,
    chunks,
)
