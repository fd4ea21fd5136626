"""Hostile streams: refused with a code, at once and in little memory."""

import resource
import struct
import subprocess
import sys
import time
import tracemalloc

import pytest

from evogs_codec.decoding.decode import decode, decode_prefix
from evogs_codec.decoding.progressive import Decoder
from evogs_codec.errors import StreamError
from tests.support import damage
from tests.support.damage import SMALL
from tests.support.verdicts import feed, oracle_verdict

MIB = 1 << 20
BIG = 0xFFFFFFFF
BOMB = 16 * MIB


def with_field(offset, form, value):
    return damage.rebuilt(damage.stream(**SMALL[0]), header={offset: (form, value)})


def one_packet(body, n_adds):
    return damage.stream_of([damage.row(n_adds=n_adds, body=body)], body)


def claims(n_tiles, n_adds):
    """Rows that promise splats in packets whose bytes never come."""
    rows = [damage.row(tile, size=n_adds // 16 + 1, n_adds=n_adds) for tile in range(n_tiles)]
    return damage.stream_of(rows, n_tiles=n_tiles)


def alpha_tables(*tables):
    body = b"".join(struct.pack("<4B", *head) + b"\1\0" * n for head, n in tables)
    rows, empty = [damage.row()], {b"TILE": None, b"PACK": None}
    # ALFA stands before TILE and PACK, so these come again behind it.
    whole = damage.stream_of(rows)
    moved = {
        kind: whole[at + 12 : at + 12 + size]
        for at, kind, size in damage.chunks_of(whole)
        if kind in empty
    }
    area = damage.rebuilt(whole, chunks=empty)
    area = damage.rebuilt(area, chunks={b"ALFA": body})
    return damage.rebuilt(area, chunks=moved)


def hostile_streams():
    """{what it does: (stream, fault code of `decode`)}."""
    lying_more = damage.frame(192, [(1, 192, b"\0"), (1, 192, b"\0")])
    lying_less = damage.frame(192, [(1, 64, b"\0")])
    return {
        "2^32-1 tiles": (with_field(24, "<I", BIG), "E_TIER"),
        "2^32-1 packets": (with_field(28, "<I", BIG), "E_TIER"),
        "255 levels": (with_field(12, "<B", 255), "E_TIER"),
        "2^32-1 bytes of chunks": (with_field(32, "<I", BIG), "E_TIER"),
        "512 MiB of chunks that do not come": (
            damage.rebuilt(
                damage.stream(**SMALL[0]), header={10: ("<B", 3), 32: ("<I", 512 * MIB)}
            ),
            "E_TRUNCATED",
        ),
        "2^64-1 bytes of packets": (with_field(36, "<Q", (1 << 64) - 1), "E_HEADER"),
        "65536 tiles without a row": (
            damage.rebuilt(damage.stream(**SMALL[0]), header={10: ("<B", 3), 24: ("<I", 65536)}),
            "E_CHUNK",
        ),
        "2^32-1 adds in no bytes": (
            damage.stream_of([damage.row(size=1, n_adds=BIG)]),
            "E_AMPLIFICATION",
        ),
        "2^32-1 adds": (damage.stream_of([damage.row(size=BIG, n_adds=BIG)]), "E_TIER"),
        "2^32-1 refines": (damage.stream_of([damage.row(size=BIG, n_refines=BIG)]), "E_COUNT"),
        "2^32-1 splits": (damage.stream_of([damage.row(size=BIG, n_splits=BIG)]), "E_COUNT"),
        "2^32-1 drops": (damage.stream_of([damage.row(size=BIG, n_drops=BIG)]), "E_COUNT"),
        "counts that wrap": (
            damage.stream_of([damage.row(size=BIG, n_refines=BIG, n_drops=1)]),
            "E_COUNT",
        ),
        "2^24 splats that do not come": (claims(1, 1 << 24), "E_TRUNCATED"),
        "2^31-2^24 splats that do not come": (claims(127, 1 << 24), "E_TRUNCATED"),
        "a frame of 16 MiB from 512 bytes": (
            one_packet(damage.add_packet([damage.run_of_zeros(BOMB)]), 64),
            "E_FRAME",
        ),
        "a frame of 2^64-1 bytes": (
            one_packet(
                damage.add_packet([damage.frame((1 << 64) - 1, [(1, 192, b"\0")], width=8)]), 64
            ),
            "E_FRAME",
        ),
        "a frame of 2^32-1 bytes": (
            one_packet(damage.add_packet([damage.frame(BIG, [(1, 192, b"\0")])]), 64),
            "E_FRAME",
        ),
        "blocks of more than the frame says": (
            one_packet(damage.add_packet([lying_more]), 64),
            "E_ZSTD",
        ),
        "blocks of less than the frame says": (
            one_packet(damage.add_packet([lying_less]), 64),
            "E_ZSTD",
        ),
        "empty blocks without end": (
            one_packet(
                damage.add_packet([damage.frame(192, [(0, 0, b"")] * 5000 + [(1, 9, b"\0")])]),
                64,
            ),
            "E_FRAME",
        ),
        "the same alpha table twice": (
            alpha_tables(((0, 0, 0, 0), 1), ((0, 0, 0, 0), 1)),
            "E_ALPHA",
        ),
        "an alpha table past its chunk": (alpha_tables(((0, 0, 0, 255), 1)), "E_CHUNK"),
        "an alpha table of no level": (alpha_tables(((1, 0, 0, 0), 1)), "E_ALPHA"),
        "a chunk past the chunks": (
            damage.repaired(
                damage.stream(**SMALL[0])[:68]
                + b"\xff\xff\xff\xff"
                + damage.stream(**SMALL[0])[72:]
            ),
            "E_CHUNK",
        ),
        "a digest of no packet": (
            damage.stream_of([damage.row()], chunks={b"dGST": b"\xff" * 41}),
            "E_CHUNK",
        ),
        "2,000 unknown chunks, the last critical": (many_chunks(2000), "E_UNSUPPORTED"),
        "16,384 empty packets, the last of no tile": (
            damage.stream_of(
                [damage.row(tile=k // 1024) for k in range(16383)] + [damage.row(tile=16)],
                n_tiles=16,
            ),
            "E_CHAIN",
        ),
        "20,000 digests of no packet": (
            damage.stream_of([damage.row()], chunks={b"dGST": b"\xff" * 41 * 20_000}),
            "E_CHUNK",
        ),
    }


def many_chunks(n):
    whole = damage.stream_of([damage.row()])
    at = 64 + int.from_bytes(whole[32:36], "little")
    area = whole[64:at] + damage.chunk(b"teSt", b"") * n + damage.chunk(b"TESt", b"")
    return damage.repaired(whole[:32] + struct.pack("<I", len(area)) + whole[36:64] + area)


@pytest.mark.parametrize("name", hostile_streams())
def test_a_hostile_stream_is_refused_in_little_memory(name):
    data, code = hostile_streams()[name]
    with pytest.raises(StreamError) as caught:
        decode(data)
    assert caught.value.fault.name == code
    assert oracle_verdict(data) == (code, caught.value.offset)
    tracemalloc.start()
    try:
        for read in (decode, decode_prefix, feed):
            try:
                read(data)
            except StreamError:
                continue
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * MIB + 8 * len(data), f"{peak} bytes"


def test_all_hostile_streams_together_fit_into_a_small_address_space():
    """The allocations tracemalloc does not see, those of zstd and of threads, count here."""
    program = (
        "import resource\n"
        "from tests.codec.decoding import test_hostile as t\n"
        "streams = t.hostile_streams().values()\n"
        "t.decode(t.damage.stream(**t.SMALL[0]))\n"
        "size = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "resource.setrlimit(resource.RLIMIT_AS, (size + (256 << 20),) * 2)\n"
        "for data, code in streams:\n"
        "    for read in (t.decode, t.decode_prefix, t.feed):\n"
        "        try:\n"
        "            read(data)\n"
        "        except t.StreamError:\n"
        "            pass\n"
        "after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "print(after - before)\n"
    )
    if not sys.platform.startswith("linux"):
        pytest.skip("needs /proc and RLIMIT_AS")
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 32 * 1024, "KiB more than before"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > 0


def test_a_file_of_n_bytes_makes_at_most_16_n_slots_and_the_memory_the_text_says():
    for n_planes_coded in (0, 14):
        n_adds, body = 64, b""
        while n_adds <= 16 * 4000:  # grow until the packet holds as many as it may
            frames = [damage.run_of_zeros(3 * n_adds)] * n_planes_coded
            body = damage.add_packet(frames, n_coded=n_planes_coded)
            if n_adds == 16 * len(body):
                break
            n_adds = 16 * len(body)
        data = one_packet(body, n_adds)
        decode(data)  # what the compiled loops take once they are loaded is not counted
        tracemalloc.start()
        decoded = decode(data)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert decoded.n_leaves == n_adds <= 16 * len(data)
        per_slot = 14 * 4 + 5 + 3 * n_planes_coded + 40  # state, planes, a few arrays (8.3)
        assert peak < n_adds * per_slot + MIB
        with pytest.raises(StreamError, match="E_AMPLIFICATION"):
            decode(one_packet(body, n_adds + 1))


def seconds_to_decode(data):
    begin = time.process_time()
    decode(data)
    feed(data)
    return time.process_time() - begin


@pytest.mark.thorough
@pytest.mark.parametrize("degree", [0, 3])
def test_decoding_many_empty_packets_takes_time_linear_in_their_number(degree):
    def seconds(n):
        rows = [damage.row(component=c) for _ in range(n) for c in range(degree + 1)]
        return seconds_to_decode(damage.stream_of(rows, degree=degree))

    seconds(10)
    assert seconds(4000) < 12 * seconds(1000)


@pytest.mark.thorough
def test_decoding_many_tiles_takes_time_linear_in_their_number():
    def seconds(n):
        rows = [damage.row(tile) for tile in range(n)]
        return seconds_to_decode(damage.stream_of(rows, n_tiles=n))

    seconds(10)
    assert seconds(4000) < 12 * seconds(1000)


def test_feeding_a_large_directory_in_small_pieces_takes_time_linear_in_its_size():
    def seconds(n):
        large = {b"mETa": struct.pack("<BH", 1, n) + b"a" + bytes(n)}
        data = damage.stream_of([damage.row()], chunks=large)
        decoder = Decoder()
        begin = time.process_time()
        for at in range(0, len(data), 4):
            decoder.feed(data[at : at + 4])
        decoder.close()
        return time.process_time() - begin

    assert seconds(60_000) < 12 * seconds(15_000)


def test_many_small_chunks_are_read_in_linear_time():
    begin = time.process_time()
    with pytest.raises(StreamError, match="E_UNSUPPORTED"):
        decode(many_chunks(80_000))
    assert time.process_time() - begin < 5.0
