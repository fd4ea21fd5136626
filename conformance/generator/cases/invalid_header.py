"""Faults of the file header, one each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import Packet, Stream, Tile, build, patched
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import SMALL, numbers

FAMILY = "invalid-header"
TWIN = "core-kinds-of-one-step"  # SMALL


def fields() -> Iterator[Case]:
    """A field outside its domain, the checksum right."""
    rows: list[tuple[str, dict[str, int | bytes], str, str, str, str]] = [
        ("tier-0", {"tier": 0}, "R-5.1-4", "E_HEADER", "tier 0", "takes no limits from tier 0"),
        ("tier-4", {"tier": 4}, "R-5.1-4", "E_HEADER", "tier 4", "reads past the table of limits"),
        ("degree-4", {"sh_degree": 4}, "R-5.1-5", "E_HEADER", "SH degree 4", "makes 86 channels"),
        ("levels-0", {"n_levels": 0}, "R-5.1-6", "E_HEADER", "no level", "accepts a row of QUAN"),
        ("grid-17-below", {"grid_exponents": b"\xef\0\0\0\0"}, "R-5.1-7", "E_HEADER",
         "the grid exponent of position is -17", "checks the upper bound only"),
        ("grid-41", {"grid_exponents": b"\0\0\0\0\x29"}, "R-5.1-7", "E_HEADER",
         "the grid exponent of SH is 41", "checks the exponent of position only"),
        ("grid-128-below", {"grid_exponents": b"\0\x80\0\0\0"}, "R-5.1-7", "E_HEADER",
         "the grid exponent of rotation is -128", "takes exponents for unsigned bytes"),
        ("version-0", {"version_major": 0}, "R-5.1-2", "E_VERSION", "major version 0",
         "refuses only versions above its own"),
        ("version-2", {"version_major": 2}, "R-5.1-2", "E_VERSION", "major version 2",
         "reads a later major version as if it were 1"),
        ("flag-9", {"flags": 1 << 9}, "R-4.4-1", "E_RESERVED", "the lowest reserved flag is set",
         "ignores reserved flags like unused ones"),
        ("flag-15", {"flags": 1 << 15}, "R-4.4-1", "E_RESERVED", "the highest reserved flag is set",
         "masks the flags with 0x7FFF"),
        ("reserved-first", {"reserved": b"\x01" + bytes(15)}, "R-4.4-1", "E_RESERVED",
         "the first reserved byte is 1", "skips the reserved bytes"),
        ("reserved-last", {"reserved": bytes(15) + b"\x80"}, "R-4.4-1", "E_RESERVED",
         "the last reserved byte is 128", "checks the first reserved bytes only"),
        ("data-size-more", {"data_size": 300}, "R-5.1-8", "E_HEADER",
         "`data_size` is more than the packets", "takes the packets from the file's end"),
        ("data-size-plus-2-to-32", {"data_size": (1 << 32) + 186}, "R-5.1-8", "E_HEADER",
         "the low 32 bits of `data_size` are right", "keeps `data_size` in 32 bits"),
    ]  # fmt: skip
    size = int.from_bytes(build(SMALL)[36:44], "little")
    for name, header, rule, code, tests, faulty in rows:
        if name == "data-size-more":
            header = {"data_size": size + 1}
        elif name == "data-size-plus-2-to-32":
            header = {"data_size": (1 << 32) + size}
        stream = replace(SMALL, header=header)
        yield case(name, stream, rule, tests, faulty, code, TWIN, runs=(FILE, PROGRESSIVE))


def signatures() -> Iterator[Case]:
    """Bytes that are not the signature."""
    data = build(SMALL)
    rows = [
        ("signature-other-letter", b"H", 3, "the name is EVH", "compares the first byte only"),
        ]  # fmt: skip
    for name, new, at, tests, faulty in rows:
        stream = replace(SMALL, header={"signature": patched(data[:8], at, new)})
        yield case(name, stream, "R-5.1-1", tests, faulty, "E_SIGNATURE", TWIN)
    yield case(
        "signature-wrong-in-7-bytes",
        b"\x89EVG\r\n\x00",
        "R-5.1-1 R-6.1-1",
        "seven bytes, the last of them not of the signature",
        "reports a truncated file although it is none of ours",
        "E_SIGNATURE",
        TWIN,
        runs=(FILE, PROGRESSIVE),
    )


def truncated() -> Iterator[Case]:
    """Files that end within the header."""
    data = build(SMALL)
    rows = [(0, "no byte at all"), (63, "a header that lacks its last byte")]
    for size, tests in rows:
        yield case(
            f"truncated-{size}",
            data[:size],
            "R-6.2-2 R-6.4-3 6.2",
            f"the file is {tests}",
            "reads past the end, or takes missing bytes for zeros",
            "E_TRUNCATED",
            TWIN,
            runs=(FILE, PROGRESSIVE),
        )


def checksums() -> Iterator[Case]:
    """The checksum of the header."""
    data = build(SMALL)
    yield case(
        "crc-one-bit",
        patched(data, 63, bytes([data[63] ^ 0x80])),
        "R-6.3-1 6.3",
        "the highest bit of the checksum of the header is wrong",
        "does not check it, or compares 31 bits",
        "E_CRC",
        TWIN,
    )
    yield case(
        "field-changed-without-crc",
        patched(data, 20, b"\x03"),
        "R-6.3-1 6.3",
        "a field without a rule changed, the checksum did not",
        "does not check the checksum of the header",
        "E_CRC",
        TWIN,
    )


def limits_of_tiers() -> Iterator[Case]:
    """Counts above the tier that the header states, and the same counts in a higher tier."""
    add = Packet(adds=numbers(1))
    levels = Stream([add], n_levels=65)
    yield case(
        "levels-65",
        replace(levels, tier=3),
        "R-8.2-1 R-5.1-6 8.2",
        "65 levels, more than any tier has",
        "takes `n_levels` for a u8 without a limit",
        "E_TIER",
        "levels-64",
    )
    yield case(
        "levels-64",
        Stream([add], n_levels=64),
        "R-8.2-1 R-5.1-6 8.2",
        "64 levels, as many as tier 1 has",
        "bounds the levels by less",
        runs=(FILE,),
    )
    tiles = [Tile((i, -i, 3 * i)) for i in range(65)]
    yield case(
        "tiles-65-of-tier-1",
        Stream([add], tiles=tiles),
        "R-8.2-1 8.2",
        "65 tiles in tier 1",
        "does not check the limits of the stated tier",
        "E_TIER",
        "tiles-65-of-tier-2",
    )
    yield case(
        "tiles-65-of-tier-2",
        Stream([add], tiles=tiles, tier=2),
        "R-5.1-4 R-8.2-1 8.2",
        "65 tiles in tier 2",
        "checks the limits of tier 1 whatever the header says",
    )
    yield case(
        "tiles-64",
        Stream([replace(add, tile=63)], tiles=tiles[:64]),
        "R-8.2-1 R-5.6-1 8.2",
        "64 tiles in tier 1, the last of them with a splat",
        "counts tiles from 1",
    )
    many = {"n_packets": 16385}
    yield case(
        "packets-16385",
        replace(SMALL, header=many),
        "R-8.2-1 8.2",
        "16385 packets announced in tier 1",
        "looks at the table before the limit",
        "E_TIER",
        TWIN,
    )
    yield case(
        "packets-16384-of-2",
        replace(SMALL, header={"n_packets": 16384}),
        "R-5.2-5 R-8.2-1",
        "16384 packets announced, within the tier; the table has two",
        "allocates for what the header announces",
        "E_CHUNK",
        TWIN,
    )
    yield case(
        "chunks-of-1048577",
        replace(SMALL, header={"chunks_size": 1048577}),
        "R-8.2-1 8.2",
        "a byte more of chunks than tier 1 allows, and none of them there",
        "reports missing bytes before the limit",
        "E_TIER",
        TWIN,
        runs=(FILE, PROGRESSIVE),
    )
    yield case(
        "chunks-of-1048576",
        replace(SMALL, header={"chunks_size": 1048576}),
        "R-6.2-2 R-8.2-1",
        "as many bytes of chunks as tier 1 allows, most of them missing",
        "allocates them, or reports E_TIER",
        "E_TRUNCATED",
        TWIN,
        runs=(FILE, PROGRESSIVE),
    )


RECIPES: tuple[Recipe, ...] = (fields, signatures, truncated, checksums, limits_of_tiers)
