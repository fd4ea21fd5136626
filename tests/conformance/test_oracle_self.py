"""The oracle against streams made by hand from spec/evogs.md, with results worked out by hand."""

import hashlib
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
import zstandard

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from conformance.decoders import oracle

SIGNATURE = b"\x89EVG\r\n\x1a\n"


def frame_of(content: bytes) -> bytes:
    compressor = zstandard.ZstdCompressor(
        level=3, write_content_size=True, write_checksum=False, write_dict_id=False
    )
    return compressor.compress(content)


def zigzag(q: int) -> int:
    return 2 * q if q >= 0 else -2 * q - 1


def planes_of(values: list[int], coding: int) -> list[bytes]:
    """The planes of a list (5.9), worked out value by value."""
    low, high = coding & 15, coding >> 4 & 3
    lows = [v & ((1 << low) - 1) for v in values]
    planes = [bytes(lows)] if low else []
    if low in (1, 2, 4):
        packed = sum(v << (i * low) for i, v in enumerate(lows))
        planes = [packed.to_bytes(-(-len(values) * low // 8), "little")]
    return planes + [bytes(v >> (low + 8 * k) & 255 for v in values) for k in range(high)]


LOW_8_HIGH_1, KINDS_CODING, INDEX_CODING = 0x18, 0x02, 0x04
N_SIDES = 7  # lists of core before psi: gaps, kinds, alpha indices of five groups


def payload(
    n_channels: int,
    *,
    gaps: list[int] | None = None,
    kinds: list[int] | None = None,
    indices: dict[int, list[int]] | None = None,
    psi: dict[int, list[int]] | None = None,
    adds: dict[int, list[int]] | None = None,
    flags: int = 0,
    delta: tuple[int, ...] = (),
    codings: dict[int, int] | None = None,
    frame: bytes | None = None,
) -> bytes:
    """A packet; psi and adds hold q by channel of the component, indices by group.

    `codings` overrides coding bytes by number of the list, after the planes were made.
    """
    psi, adds, indices = psi or {}, adds or {}, indices or {}
    lists: list[tuple[list[int], int]] = []
    if n_channels == 14:
        lists += [(gaps or [], LOW_8_HIGH_1), (kinds or [], KINDS_CODING)]
        lists += [(indices.get(group, []), INDEX_CODING) for group in range(5)]
    for values in (psi, adds):
        for c in range(n_channels):
            lists.append(([zigzag(q) for q in values.get(c, [])], LOW_8_HIGH_1))
    planes = [plane for values, coding in lists for plane in planes_of(values, coding) if values]
    coding_bytes = [coding if values else 0 for values, coding in lists]
    for c in delta:
        coding_bytes[c - n_channels] |= 64
    for number, byte in (codings or {}).items():
        coding_bytes[number] = byte
    if frame is None:
        frame = frame_of(b"".join(planes)) if planes else b""
    entry = struct.pack("<BI", len(planes), len(frame)) if planes else b""
    return bytes([flags, 1 if planes else 0, *coding_bytes]) + entry + frame


def chunk(kind: bytes, body: bytes) -> bytes:
    head = kind + struct.pack("<I", len(body))
    return head + struct.pack("<I", zlib.crc32(head + body)) + body


Row = tuple[int, int, tuple[int, int, int, int], bytes]  # component, level, counts, packet


def stream(rows: list[Row], **changes: Any) -> bytes:
    """One tile, box -1000..1000, two levels. Counts are adds, splits, refines, drops."""
    degree = changes.get("degree", 0)
    quantiser = [(1, 0)] * 4 + [(3, 1)] + [(2, 0)] * degree  # SH band 0: delta = 6 q, others 2 q
    quan = b"".join(struct.pack("<HB", *entry) for entry in quantiser * 3)
    alfa = struct.pack("<4B2h", 0, 0, 1, 1, 3, -1)  # level 0, position: 3/2 or -1/2
    alfa += struct.pack("<4B1h", 0, 4, 2, 0, 1)  # level 0, SH: 1/4
    tile = struct.pack("<3q6i", *changes.get("origin", (0, 0, 0)), *[-1000] * 3, *[1000] * 3)
    pack = b"".join(
        struct.pack("<IBBHI6I", 0, component, level, 0, len(body), *counts, 7, zlib.crc32(body))
        for component, level, counts, body in rows
    )
    tables = {b"QUAN": quan, b"ALFA": alfa, b"TILE": tile, b"PACK": pack}
    tables |= changes.get("tables", {})
    chunks = b"".join(chunk(kind, body) for kind, body in tables.items())
    data = b"".join(body for *_, body in rows)
    sizes = (changes.get("n_tiles", 1), len(rows), len(chunks), len(data))
    version, grid = changes.get("version", 1), (8, 0, 0, 0, 4)
    head = SIGNATURE + bytes([version, changes.get("minor", 0), 1, degree, 2])
    head += struct.pack("<5bH4B3IQ16x", *grid, changes.get("flags", 0), 9, 0, 0, 1, *sizes)
    return head + struct.pack("<I", zlib.crc32(head)) + chunks + data


TWO_ADDS = payload(
    14, adds={0: [100, -50], 10: [4, 5], 11: [1, 2], 12: [4, 0], 13: [6, 0]}, flags=2
)
# Slots 0 (split, alpha index 1) and 1 (refine).
SPLIT_REFINE = payload(
    14, gaps=[0, 0], kinds=[1, 0], indices={0: [1]}, psi={0: [7, -3], 1: [5, 0], 11: [-1, 0]}
)
DROP_ONE = payload(14, gaps=[1])
ROWS: list[Row] = [
    (0, 0, (2, 0, 0, 0), TWO_ADDS),
    (0, 0, (0, 1, 1, 0), SPLIT_REFINE),
    (0, 1, (0, 0, 0, 0), b""),
    (0, 1, (0, 0, 0, 1), DROP_ONE),
]


def fault(data: bytes, **options: Any) -> tuple[str, int]:
    with pytest.raises(oracle.FaultError) as caught:
        oracle.decode(data, **options)
    return caught.value.code, caught.value.offset


def payload_start(data: bytes) -> int:
    return int(64 + struct.unpack_from("<I", data, 32)[0])


def test_adds_splits_refines_and_drops_give_the_values_worked_out_by_hand() -> None:
    tile = oracle.decode(stream(ROWS)).tiles[0]
    # x: 100 + 7; dropped; second child 100 - RoundShift(-7, 1) = 100 + 3, by -1/2.
    assert tile.channels[0] == [107, 0, 103]
    # y: 5; second child 0 - RoundShift(-5, 1) = 2.
    assert tile.channels[1] == [5, 0, 2]
    assert tile.channels[10] == [4, 0, 4]
    # Y 1, Co 4, Cg 6: t = -2, g = 4, b = -4, r = 0; times 6. R: 0 - 6; 0 - RoundShift(-6, 2) = 1.
    assert tile.channels[11] == [-6, 0, 1]
    assert tile.channels[12] == [24, 0, 24]
    assert tile.channels[13] == [-24, 0, -24]
    assert tile.live == [True, False, True]
    assert tile.born_from == [None, None, 0]


def test_a_level_stops_before_the_first_step_with_a_larger_label() -> None:
    assert oracle.decode(stream(ROWS), level=0).tiles[0].channels[0] == [107, -53, 103]
    assert oracle.decode(stream(ROWS), cut=[[1]]).tiles[0].channels[0] == [100, -50]
    assert oracle.decode(stream(ROWS), level=-1).tiles[0].n_slots == 0


def test_delta_of_adds_comes_before_the_colour_transform() -> None:
    body = payload(14, adds={11: [1, 1], 12: [2, 2]}, flags=2, delta=(11, 12))
    tile = oracle.decode(stream([(0, 0, (2, 0, 0, 0), body)])).tiles[0]
    # (Y, Co, Cg) = (1, 2, 0) and (2, 4, 0): b = 0 and 0, r = 2 and 4, g = 1 and 2.
    assert [tile.channels[c] for c in (11, 12, 13)] == [[12, 24], [6, 12], [0, 0]]


def test_the_dump_is_the_header_and_the_channels_of_each_tile() -> None:
    dump = oracle.decode(stream(ROWS, origin=(5, -6, 7))).dump()
    assert dump[:16] == b"EVGD\x01\x00" + bytes([8, 0, 0, 0, 4, 0]) + struct.pack("<I", 1)
    assert dump[16:47] == struct.pack("<3qI", 5, -6, 7, 3) + bytes([1, 0, 1])
    assert struct.unpack("<3i", dump[47:59]) == (107, 0, 103)
    assert len(dump) == 47 + 4 * 14 * 3


def test_the_float_view_rounds_once_to_binary32_with_ties_to_even() -> None:
    view = oracle.decode(stream(ROWS, origin=((1 << 24) + 2 - 108, 0, 0))).float_view()
    assert len(view) == 2
    assert view[0][0] == (1 << 24) / 256  # 2^24 + 1 is a tie, and 2^24 is even
    assert view[0][12] == 1.5
    assert oracle.binary32((1 << 24) + 3, 0) == (1 << 24) + 4
    assert oracle.binary32(-((1 << 53) - 1), -16) == -float(1 << 69)


SH_ROWS: list[Row] = [
    (0, 0, (2, 0, 0, 0), payload(14, adds={0: [1, 2]})),
    (1, 0, (0, 0, 0, 0), payload(9, adds={0: [10, 20]})),
    (0, 0, (1, 1, 0, 1), payload(14, gaps=[0, 0], kinds=[1, 2], adds={0: [5]})),
    (1, 0, (0, 0, 0, 0), payload(9, psi={0: [3]}, adds={0: [7]})),
    (0, 1, (0, 0, 1, 0), payload(14, gaps=[2], psi={0: [1]})),
    (1, 0, (0, 0, 0, 0), b""),
]


def test_a_band_follows_the_records_of_its_core() -> None:
    tile = oracle.decode(stream(SH_ROWS, degree=1)).tiles[0]
    # 20 + 6; dropped; 20 - RoundShift(6, 2) = 18, for (6 + 2) >> 2 is 2; the add 14.
    assert tile.channels[14] == [26, 0, 18, 14]
    assert tile.cut == [3, 3]


def test_a_late_band_shows_the_coefficients_of_the_ancestor() -> None:
    late = oracle.decode(stream(SH_ROWS, degree=1), cut=[[3, 1]]).tiles[0]
    assert late.channels[14] == [20, 0, 20, 0]
    none = oracle.decode(stream(SH_ROWS, degree=1), cut=[[3, 0]]).tiles[0]
    assert none.channels[14] == [0, 0, 0, 0]


def test_a_cut_with_more_steps_of_a_band_than_of_core_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="cut"):
        oracle.decode(stream(SH_ROWS, degree=1), cut=[[1, 2]])


def test_digests_are_checked_on_request_and_only_within_the_cut() -> None:
    late = oracle.decode(stream(SH_ROWS, degree=1), cut=[[2, 1]])
    state = struct.pack("<I2i", 2, 20, 40)
    assert late.state_digest(0, 1) == hashlib.sha256(state + bytes(8 * 8)).digest()
    good = struct.pack("<IBI", 0, 1, 0) + late.state_digest(0, 1)
    wrong = struct.pack("<IBI", 0, 1, 2) + bytes(32)
    data = stream(SH_ROWS, degree=1, tables={b"dGST": good + wrong})
    oracle.decode(data)
    oracle.decode(data, cut=[[3, 2]], check_digests=True)
    assert fault(data, check_digests=True) == ("E_DIGEST", data.index(b"dGST"))


def test_every_prefix_after_the_chunks_decodes_to_its_complete_packets() -> None:
    data = stream(SH_ROWS, degree=1)
    start = payload_start(data)
    sizes = range(start, len(data) + 1)
    cuts = [tuple(oracle.decode_prefix(data[:size]).tiles[0].cut) for size in sizes]
    ordered = sorted(set(cuts))
    assert cuts == sorted(cuts)
    assert ordered == [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2), (3, 3)]
    with pytest.raises(oracle.FaultError) as caught:
        oracle.decode_prefix(data[: start - 1])
    assert (caught.value.code, caught.value.offset) == ("E_TRUNCATED", 64)


def test_a_scene_of_no_tiles_and_a_tile_of_no_packets_are_legal() -> None:
    assert oracle.decode(stream([])).tiles[0].n_slots == 0
    empty = oracle.decode(stream([], n_tiles=0, tables={b"TILE": b""}))
    assert empty.dump()[12:] == bytes(4)


def test_metadata_unknown_ancillary_chunks_and_unknown_registry_values_are_read() -> None:
    entry = struct.pack("<BH", 5, 2) + b"title" + "é".encode()
    scene = oracle.decode(stream(ROWS, minor=3, tables={b"mETa": entry, b"abCd": b"x"}))
    assert scene.metadata == {"title": "é"}
    assert (scene.header.coordinate_system, scene.header.colour_space) == (0, 1)
    repeated = stream(ROWS, tables={b"mETa": entry + entry})
    assert fault(repeated) == ("E_META", repeated.index(b"mETa"))


def test_faults_of_the_header_are_at_offset_0_and_the_signature_comes_first() -> None:
    data = stream(ROWS)
    assert fault(b"\x89EVX") == ("E_SIGNATURE", 0)
    assert fault(data[:63]) == ("E_TRUNCATED", 0)
    assert fault(b"") == ("E_TRUNCATED", 0)
    assert fault(data[:8] + b"\x02" + data[9:]) == ("E_VERSION", 0)
    assert fault(data[:10] + b"\x02" + data[11:]) == ("E_CRC", 0)
    assert fault(stream(ROWS, flags=512)) == ("E_RESERVED", 0)
    assert fault(stream(ROWS, flags=256)) == ("E_HEADER", 0)  # a palette without SH
    assert fault(stream(ROWS, degree=4)) == ("E_HEADER", 0)
    assert fault(stream(ROWS, n_tiles=65)) == ("E_TIER", 0)
    assert fault(data, limits={"n_packets": 3}) == ("E_LIMIT", 0)


def test_faults_of_chunks_are_at_the_chunk() -> None:
    data = stream(ROWS)
    assert fault(data[:100]) == ("E_TRUNCATED", 64)
    broken = bytearray(data)
    broken[data.index(b"TILE") + 12] ^= 1
    assert fault(bytes(broken)) == ("E_CRC", data.index(b"TILE"))
    unknown = stream(ROWS, tables={b"ABCD": b""})
    assert fault(unknown) == ("E_UNSUPPORTED", unknown.index(b"ABCD"))
    assert fault(stream(ROWS, tables={b"TILE": b""})) == ("E_CHUNK", data.index(b"TILE"))
    bad_alpha = stream(ROWS, tables={b"ALFA": struct.pack("<4Bh", 2, 0, 0, 0, 1)})
    assert fault(bad_alpha) == ("E_ALPHA", data.index(b"ALFA"))


@pytest.mark.parametrize(
    ("code", "row"),
    [
        ("E_CHAIN", (1, 0, (0, 0, 0, 0), b"")),
        ("E_CHAIN", (0, 2, (0, 0, 0, 0), b"")),
        ("E_COUNT", (0, 0, (0, 0, 1, 0), payload(14))),
        ("E_COUNT", (0, 0, (0, 0, 0, 0), payload(14))),
        ("E_COUNT", (0, 0, (1, 0, 0, 0), b"")),
        ("E_AMPLIFICATION", (0, 0, (16 * 37 + 1, 0, 0, 0), payload(14))),
    ],
)
def test_a_wrong_row_is_a_fault_of_the_packet_table(code: str, row: Row) -> None:
    data = stream([row])
    assert fault(data) == (code, data.index(b"PACK"))


# One refine, its psi of x packed in fours: the high half of the byte belongs to no value.
STRAY_FRAME = frame_of(b"\x12")
STRAY_BIT = bytes([0, 1, *[0] * N_SIDES, 0x04, *[0] * 27])
STRAY_BIT += struct.pack("<BI", 1, len(STRAY_FRAME)) + STRAY_FRAME


@pytest.mark.parametrize(
    ("code", "counts", "body"),
    [
        ("E_PACKET", (0, 0, 1, 0), payload(14)[:-1]),
        ("E_PACKET", (0, 0, 1, 0), payload(14, codings={N_SIDES + 3: 0x09})),
        ("E_PACKET", (0, 0, 1, 0), payload(14, codings={N_SIDES + 3: 0x58})),
        ("E_PACKET", (0, 0, 1, 0), payload(14, adds={0: [1]})),
        ("E_PACKET", (0, 0, 1, 0), payload(14, psi={0: [1]}, codings={N_SIDES: 0x10})),
        ("E_PACKET", (0, 0, 1, 0), payload(14, psi={0: [1]}) + b"x"),
        ("E_PACKET", (0, 0, 1, 0), payload(14, codings={N_SIDES + 3: 0x40})),
        ("E_PACKET", (0, 0, 1, 0), payload(14, codings={1: 0x02})),
        ("E_PACKET", (0, 0, 1, 0), payload(14, gaps=[1], codings={0: 0x58})),
        ("E_PACKET", (0, 0, 1, 0), STRAY_BIT),
        ("E_RESERVED", (0, 0, 1, 0), payload(14, flags=4)),
        ("E_RESERVED", (0, 0, 1, 0), payload(14, codings={N_SIDES + 3: 0x98})),
        ("E_FRAME", (0, 0, 1, 0), payload(14, psi={0: [1]}, frame=frame_of(b"abc"))),
        ("E_FRAME", (0, 0, 1, 0), payload(14, psi={0: [1]}, frame=frame_of(b"\1\0") + b"x")),
        ("E_FRAME", (0, 0, 1, 0), payload(14, psi={0: [1]}, frame=b"")),
        ("E_SLOT", (0, 0, 1, 0), payload(14, gaps=[2])),
        ("E_KIND", (0, 1, 1, 0), payload(14, gaps=[0, 0], kinds=[1, 1])),
        ("E_KIND", (0, 1, 1, 0), payload(14, gaps=[0, 0], kinds=[1, 3])),
        ("E_INDEX", (0, 1, 0, 0), payload(14, indices={0: [2]})),
        ("E_INDEX", (0, 1, 0, 0), payload(14, indices={1: [1]})),
        ("E_RANGE", (0, 0, 1, 0), payload(14, psi={0: [901]})),
    ],
)
def test_a_wrong_packet_is_a_fault_at_its_start(
    code: str, counts: tuple[int, int, int, int], body: bytes
) -> None:
    data = stream([ROWS[0], (0, 0, counts, body)])
    assert fault(data) == (code, len(data) - len(body))


def test_a_block_that_does_not_decompress_is_a_fault_of_the_library() -> None:
    frame = frame_of(bytes(2))[:6] + b"\x0d\x00\x00\xff"  # a last block of type 2, with size 1
    data = stream([ROWS[0], (0, 0, (0, 0, 1, 0), payload(14, psi={0: [1]}, frame=frame))])
    assert fault(data)[0] == "E_ZSTD"


def test_a_record_of_an_empty_slot_is_refused() -> None:
    data = stream([*ROWS, (0, 1, (0, 0, 1, 0), payload(14, gaps=[1]))])
    assert fault(data)[0] == "E_SLOT"


def test_missing_bytes_matter_only_within_the_cut_and_trailing_bytes_always() -> None:
    data = stream(ROWS)
    assert fault(data[:-1]) == ("E_TRUNCATED", len(data) - len(DROP_ONE))
    assert oracle.decode(data[:-1], level=0).tiles[0].n_slots == 3
    assert fault(data + b"x") == ("E_TRAILING", len(data))
    assert fault(data + b"x", level=0) == ("E_TRAILING", len(data))


def test_a_packet_outside_the_cut_is_not_examined() -> None:
    data = stream(ROWS)
    broken = data[:-1] + bytes([data[-1] ^ 1])
    assert fault(broken) == ("E_CRC", len(data) - len(DROP_ONE))
    assert oracle.decode(broken, level=0).tiles[0].cut == [2]


def test_the_trace_sees_each_packet_with_its_state() -> None:
    seen: list[tuple[int, int, int, int]] = []
    oracle.decode(
        stream(SH_ROWS, degree=1),
        trace=lambda t, step, component, state: seen.append((t, step, component, len(state))),
    )
    assert seen[:3] == [
        (0, 0, 0, 4 + 2 + 8 + 14 * 8),
        (0, 0, 1, 4 + 9 * 8),
        (0, 1, 0, 4 + 4 + 16 + 14 * 16),
    ]
