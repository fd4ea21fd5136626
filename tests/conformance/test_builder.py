"""The builder of streams: what it works out, and that all of it can be overridden."""

import hashlib
import struct
import zlib

import pytest
import zstandard

from conformance.decoders import oracle
from conformance.decoders.outcomes import Run, by_oracle
from conformance.decoders.reference import by_codec
from conformance.generator.builder import (
    ADDS_YCOCG,
    DELTA,
    DROP,
    MAX_X,
    OF_CHANGED,
    RAW,
    REFINE,
    RLE,
    SPLIT,
    Chunk,
    Packet,
    Stream,
    Tile,
    X,
    Y,
    build,
    coding_for,
    compressed,
    frame,
    patched,
    places,
    planes_of,
    raw,
    repaired,
    runs,
)

CONTENT = b"aaaaaabcd" * 40


def test_a_stream_says_what_it_was_told():
    stream = Stream(
        [
            Packet(adds={X: [5, -3, 8]}),
            Packet(records={0: SPLIT, 1: DROP, 2: REFINE}, psi={X: [2, 7]}, level=1),
        ],
        n_levels=2,
        quantisers={(2, 0): (3, 1)},
        tiles=[Tile((1, 2, 3), (-100,) * 3, (100,) * 3)],
        metadata={"title": "t"},
    )
    scene = oracle.decode(build(stream))
    tile = scene.tiles[0]
    assert tile.channels[X] == [5 + 12, 0, 8 + 42, 5 - 12]
    assert (tile.origin, tile.live) == ((1, 2, 3), [True, False, True, True])
    assert scene.metadata == {"title": "t"}
    assert oracle.decode(build(stream), level=0).tiles[0].channels[X] == [5, -3, 8]


def test_bands_take_the_counts_of_their_core():
    core = Packet(adds={X: [1, 2]})
    band = Packet(component=1, adds={0: 9, 8: [4, 5]})
    tile = oracle.decode(build(Stream([core, band], degree=1))).tiles[0]
    assert tile.channels[14] == [9, 9]
    assert tile.channels[22] == [4, 5]


def test_a_palette_has_its_own_counts_and_picks_those_of_their_core():
    stream = Stream(
        [
            Packet(adds={X: [1, 2]}),
            Packet(component=5, n_adds=2, adds={0: [3, 3], 23: -1}, codings={"adds 0": 4 | DELTA}),
            Packet(component=4, picks=[1, 0]),
            Packet(component=5, level=3),
            Packet(records={0: SPLIT}, psi={X: 1}),
            Packet(component=4, is_explicit=True),
        ],
        degree=2,
        has_palette=True,
    )
    data = build(stream)
    assert data[18:20] == b"\0\1"
    table = places(data).chunks[b"PACK"] + 12
    rows = [data[at : at + 36] for at in range(table, table + 6 * 36, 36)]
    assert [row[4:6] for row in rows] == [b"\0\0", b"\5\0", b"\4\0", b"\5\3", b"\0\0", b"\4\0"]
    assert [row[12:16] for row in rows[1:3]] == [b"\2\0\0\0", bytes(4)]
    core, palette, picks, *_, zeros = (data[begin:end] for begin, end in places(data).packets)
    assert palette[:26] == bytes([0, 1, 4 | DELTA, *[0] * 22, 1])
    assert palette.endswith(b"\x06\x03")  # 3, then a difference of 0; -1 twice in a bit each
    assert picks == bytes([0, 1, 1, 1, *len(raw(b"?")).to_bytes(4, "little")]) + raw(b"\1")
    assert zeros == bytes(3)
    assert core == build(Stream([Packet(adds={X: [1, 2]})]))[-len(core) :]


def test_picks_of_changed_slots_stand_before_those_of_new_ones_and_have_a_flag():
    grow = Packet(records={0: SPLIT, 1: REFINE, 2: DROP}, psi={X: 1})
    for repicks, picks, stored in [
        ((9, 7), (3,), bytes([9, 7, 3])),
        ((9, 7), (), bytes([9, 7, 0])),
        ((), (3,), bytes([0, 0, 3])),
    ]:
        packet = Packet(component=4, picks=picks, repicks=repicks, codings={"picks": 8}, flags=2)
        packets = [Packet(adds={X: [1, 2, 3]}), Packet(component=4), grow, packet]
        data = build(Stream(packets, degree=1, has_palette=True))
        begin, end = places(data).packets[-1]
        assert data[begin : begin + 3] == bytes([OF_CHANGED | 2, 1, 8])
        assert data[begin:end].endswith(raw(stored))


def test_a_packet_with_the_flag_of_changed_slots_has_bytes():
    packets = [Packet(adds={X: 1}, n_adds=1), Packet(component=4, repicks=())]
    assert build(Stream(packets, degree=1, has_palette=True))[-3:] == bytes([OF_CHANGED, 0, 0])


def test_differences_and_colours_are_stored_as_told():
    packet = Packet(adds={X: [10, 7, 300]}, codings={"adds 0": 0x18 | DELTA}, flags=ADDS_YCOCG)
    assert oracle.decode(build(Stream([packet]))).tiles[0].channels[X] == [10, 7, 300]


def test_sibling_differences_are_stored_as_told_and_zeros_have_no_delta():
    births = [Packet(adds={X: [0]}), Packet(records={0: SPLIT})]
    layer = Packet(records={0: REFINE, 1: REFINE}, psi={X: [5, 2], Y: [0, 0]}, siblings={X, Y})
    data = build(Stream([*births, layer]))
    codings = data[places(data).packets[-1][0] :][9:23]
    assert codings == bytes([4 | DELTA, *[0] * 13])
    assert data.endswith(b"\x4a")  # 5 and 2 after zigzag, in 4 bits each
    assert oracle.decode(data).tiles[0].channels[X] == [7, 3]


def test_digests_are_right_where_they_are_not_given():
    stream = Stream([Packet(n_adds=1)], digests={(0, 0, 0): None})
    assert by_codec(build(stream), Run(verify=True)).exit == 0
    wrong = Stream([Packet(n_adds=1)], digests={(0, 0, 0): hashlib.sha256(b"").digest()})
    assert by_codec(build(wrong), Run(verify=True)).code == "E_DIGEST"


@pytest.mark.parametrize(
    "content", [b"a", b"ab" * 127, b"a" * 255, b"q" * 256, b"z" * 70000, CONTENT]
)
@pytest.mark.parametrize("style", [raw, runs, compressed(3), lambda c: raw(c, 7)])
def test_frames_give_their_content_and_keep_the_subset(content, style):
    made = style(content)
    assert zstandard.ZstdDecompressor().decompress(made) == content
    assert oracle.read_frame(made, len(content)) == content


def test_frame_headers_are_the_bytes_asked_for():
    assert raw(b"xyz") == bytes.fromhex("28b52ffd 20 03 190000") + b"xyz"
    assert raw(b"xyz", width=8)[4:14] == bytes.fromhex("e0 0300000000000000 19")
    assert raw(bytes(300))[4:7] == bytes.fromhex("60 2c00")
    two = frame(5, [(RLE, 4, b"a"), (RAW, 1, b"b")], descriptor=0x24)
    assert two == bytes.fromhex("28b52ffd 24 05 220000 61 090000 62")


@pytest.mark.parametrize("low", range(9))
@pytest.mark.parametrize("high", range(3))
def test_planes_hold_the_integers_that_were_given(low, high):
    most = 1 << (low + 8 * high)
    values = [most - 1, 0, most // 2, most // 3, 1 % most]
    coding = low | high << 4
    assert oracle.unpack(coding, planes_of(values, coding), len(values)) == values
    with pytest.raises(AssertionError, match="holds no such integers"):
        planes_of([most], coding)


@pytest.mark.parametrize("most", [0, 1, 3, 4, 15, 16, 255, 256, 65535, 65536, (1 << 24) - 1])
def test_the_default_coding_holds_the_largest_integer_in_few_bits(most):
    coding = coding_for([0, most])
    if most:
        assert oracle.unpack(coding, planes_of([0, most], coding), 2) == [0, most]
    assert (coding == 0) == (most == 0)


@pytest.mark.parametrize(
    ("stream", "code"),
    [
        (Stream(header={"tier": 9}), "E_HEADER"),
        (Stream(header={"crc": 1}), "E_CRC"),
        (Stream(header={"signature": bytes(8)}), "E_SIGNATURE"),
        (Stream(chunks=lambda c: [*c, Chunk(b"QUUX")]), "E_UNSUPPORTED"),
        (Stream(chunks=lambda c: [Chunk(b"QUAN", c[0].body, crc=9), *c[1:]]), "E_CRC"),
        (Stream(tail=b"?"), "E_TRAILING"),
        (Stream(tiles=[Tile(low=(-MAX_X - 1,) * 3)]), "E_TILE"),
        (Stream([Packet(n_adds=1, row={"level": 7})]), "E_CHAIN"),
        (Stream([Packet(n_adds=1, row={"crc": 7})]), "E_CRC"),
        (Stream([Packet(n_adds=1, flags=4)]), "E_RESERVED"),
        (Stream([Packet(n_adds=1, coding_bytes={"adds 0": 9})]), "E_PACKET"),
        (Stream([Packet(adds={X: [1]}, entries=lambda e: [(2, e[0][1])])]), "E_PACKET"),
        (Stream([Packet(adds={X: [1]}, frames=(1,), style=lambda c: b"?" + raw(c))]), "E_FRAME"),
        (Stream([Packet(n_adds=1, edit=lambda body: body[:9])]), "E_PACKET"),
        (Stream([Packet(adds={X: [1, 2]}), Packet(records={0: DROP}, stored={"gaps": [9]})]),
         "E_SLOT"),
    ],
)  # fmt: skip
def test_everything_can_be_overridden_and_the_rest_is_right(stream, code):
    outcome = by_oracle(build(stream), Run())
    assert (outcome.code, by_codec(build(stream), Run())) == (code, outcome)


def test_places_are_where_chunks_and_packets_begin():
    data = build(Stream([Packet(n_adds=1), Packet(), Packet(adds={Y: [7]})], alphas={}))
    found = places(data)
    assert [data[at : at + 4] for at in found.chunks.values()] == list(found.chunks)
    assert list(found.chunks) == [b"QUAN", b"ALFA", b"TILE", b"PACK"]
    sizes = [end - start for start, end in found.packets]
    assert sizes[:2] == [37, 0]
    assert found.packets[-1][1] == len(data)


def test_repairing_makes_every_checksum_right_and_changes_no_right_one():
    data = build(Stream([Packet(adds={X: [1, 2]})], metadata={"a": "b"}))
    assert repaired(data) == data
    start = places(data).packets[0][0]
    for at in (12, places(data).chunks[b"mETa"] + 12, start + 1):
        damaged = patched(data, at, bytes([data[at] ^ 0x40]))
        assert by_oracle(damaged, Run()).code == "E_CRC"
        assert by_oracle(repaired(damaged), Run()).code not in (None, "E_CRC")
    assert struct.unpack_from("<I", repaired(patched(data, 12, b"\2")), 60) == (
        zlib.crc32(patched(data, 12, b"\2")[:60]),
    )


@pytest.mark.parametrize("size", [0, 7, 63, 64, 70, 90])
def test_repairing_what_is_cut_short_does_not_fail(size):
    data = build(Stream([Packet(n_adds=1)]))
    assert len(repaired(data[:size])) == size
