"""Zstandard frames: the subset of spec 5.10, held to by reader and writer."""

import numpy as np
import pytest
import zstandard

from conformance.decoders import oracle
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format.compiled_frames import is_frame
from evogs_codec.format.frames import MAX_CONTENT, check_frame, compress, decompress, store
from tests.support.damage import frame

RAW, RLE, COMPRESSED, RESERVED = range(4)
KIB, MIB = 1 << 10, 1 << 20
OFFSET = 1234


def is_in_subset(data, size):
    """What the compiled check of headers says of a frame."""
    return is_frame(np.frombuffer(data, np.uint8), size)


def fault(data, size):
    """Code of the fault, which the oracle and the compiled check must find too."""
    with pytest.raises(StreamError) as caught:
        decompress(memoryview(data), size, OFFSET)
    assert is_in_subset(data, size) == (caught.value.fault is Fault.E_ZSTD)
    with pytest.raises(oracle.FaultError) as found:
        oracle.read_frame(data, size)
    assert found.value.code == caught.value.fault.name
    assert caught.value.offset == OFFSET
    assert caught.value.section == "5.10"
    return caught.value.fault


def content_of(data, size):
    content = decompress(memoryview(data), size, OFFSET)
    assert oracle.read_frame(data, size) == content
    assert is_in_subset(data, size)
    return content


def noise(size):
    return np.random.default_rng(size).bytes(size)


def text(size):
    """Bytes that compress: few values, some repeats."""
    return np.random.default_rng(size).integers(0, 5, size, np.uint8).tobytes()


# --- reading: what is inside the subset ----------------------------------------------------------


@pytest.mark.parametrize("width", [1, 4, 8])
def test_a_frame_is_read_with_its_content_size_in_any_width(width):
    assert content_of(frame(3, [(RAW, 3, b"abc")], width=width), 3) == b"abc"


def test_two_bytes_of_content_size_count_from_256():
    assert content_of(frame(300, [(RLE, 300, b"x")], width=2), 300) == 300 * b"x"


def test_raw_and_run_length_blocks_may_mix_and_a_raw_last_one_may_be_empty():
    blocks = [(RAW, 2, b"ab"), (RLE, 5, b"c"), (RAW, 1, b"e"), (RAW, 0, b"")]
    assert content_of(frame(8, blocks), 8) == b"abccccce"


def test_blocks_may_hold_128_kib_and_no_more():
    size = 128 * KIB + 1
    assert content_of(frame(size, [(RLE, size - 1, b"a"), (RAW, 1, b"b")]), size)[-2:] == b"ab"
    assert fault(frame(size, [(RLE, size, b"a")]), size) is Fault.E_FRAME


# --- reading: each requirement broken by itself --------------------------------------------------

GOOD = {"content_size": 3, "blocks": [(RAW, 3, b"abc")], "width": 1}


@pytest.mark.parametrize(
    "magic",
    [
        b"\x00\xb5\x2f\xfd",
        b"\x28\xb5\x2f\xfc",
        b"\xfd\x2f\xb5\x28",
        b"\x50\x2a\x4d\x18",  # a skippable frame
        b"\x27\xb5\x2f\xfd",  # version 0.7
    ],
)
def test_another_magic_number_is_refused(magic):
    assert fault(frame(**GOOD, magic=magic), 3) is Fault.E_FRAME


@pytest.mark.parametrize("bits", [0x01, 0x02, 0x03, 0x04, 0x08, 0x10, 0x1F])
def test_dictionary_checksum_and_reserved_bits_are_refused(bits):
    assert fault(frame(**GOOD, descriptor=0x20 | bits), 3) is Fault.E_FRAME


def test_a_window_descriptor_is_refused():
    data = frame(**GOOD, descriptor=0x00)
    assert fault(data[:5] + b"\x00" + data[5:], 3) is Fault.E_FRAME


def test_a_frame_with_a_checksum_as_the_library_makes_it_is_refused():
    for compressor in (
        zstandard.ZstdCompressor(level=3, write_checksum=True),
        zstandard.ZstdCompressor(level=3, write_content_size=False),
    ):
        assert fault(compressor.compress(text(1000)), 1000) is Fault.E_FRAME
    dictionary = zstandard.ZstdCompressionDict(text(5000), zstandard.DICT_TYPE_RAWCONTENT)
    data = zstandard.ZstdCompressor(level=3, dict_data=dictionary).compress(text(5000)[:900])
    assert fault(data, 900) is Fault.E_ZSTD


@pytest.mark.parametrize("size", [0, 2, 4, 259, 1 << 40])
def test_another_content_size_than_that_of_the_planes_is_refused(size):
    assert fault(frame(**GOOD), size) is Fault.E_FRAME


@pytest.mark.parametrize("size", [(1 << 64) - 1, 1 << 63, (1 << 32) + 3])
def test_a_content_size_of_eight_bytes_is_read_whole(size):
    assert fault(frame(size, [(RAW, 3, b"abc")], width=8), 3) is Fault.E_FRAME


def test_more_than_16_mib_are_refused_before_a_block_is_looked_at():
    size = 16 * MIB + 1
    blocks = [(RLE, 128 * KIB, b"\0")] * 128 + [(RLE, 1, b"\0")]
    assert fault(frame(size, blocks), size) is Fault.E_FRAME
    assert len(content_of(frame(size - 1, blocks[:-1]), size - 1)) == 16 * MIB


@pytest.mark.parametrize(
    "blocks",
    [
        [(RESERVED, 3, b"abc")],
        [(RAW, 1, b"a"), (RESERVED, 2, b"bc")],
        [(RAW, 4, b"abcd")],  # a block above the content
        [(RLE, 4, b"a")],
        [(RLE, (1 << 21) - 1, b"a")],
        [(COMPRESSED, 4, b"abcd")],
        [(COMPRESSED, 0, b"")],
        [(RAW, 0, b""), (RAW, 3, b"abc")],
        [(RAW, 3, b"abc"), (RLE, 0, b"a")],
    ],
)
def test_reserved_empty_and_too_large_blocks_are_refused(blocks):
    assert fault(frame(3, blocks), 3) is Fault.E_FRAME


@pytest.mark.parametrize("end", [b"\0", b"abc", b"\x28\xb5\x2f\xfd\x20\x00\x01\x00\x00"])
def test_bytes_and_frames_behind_the_last_block_are_refused(end):
    assert fault(frame(**GOOD) + end, 3) is Fault.E_FRAME


def test_a_last_block_that_is_not_marked_is_refused():
    data = bytearray(frame(**GOOD))
    data[6] &= ~1
    assert fault(bytes(data), 3) is Fault.E_FRAME


@pytest.mark.parametrize("make", [lambda data: compress(data, 19), store])
def test_a_frame_cut_short_anywhere_is_refused(make):
    data = make(text(400))
    for n in range(len(data)):
        assert fault(data[:n], 400) is Fault.E_FRAME


@pytest.mark.parametrize(
    ("blocks", "size"),
    [
        ([(RAW, 2, b"ab")], 3),
        ([(RAW, 0, b"")], 3),
        ([(RAW, 3, b"abc"), (RAW, 1, b"d")], 3),
        ([(RLE, 2, b"a"), (RLE, 2, b"a")], 3),
        ([(COMPRESSED, 3, b"abc")], 3),
        ([(COMPRESSED, 50, bytes(50))], 100),
        ([(COMPRESSED, 50, b"\xff" * 50)], 100),
    ],
)
def test_blocks_that_do_not_regenerate_the_content_size_are_refused(blocks, size):
    assert fault(frame(size, blocks), size) is Fault.E_ZSTD


@pytest.mark.thorough
def test_damaged_content_is_refused_or_has_the_right_size():
    data = compress(text(600), 19)
    for bit in range(8 * 9, 8 * len(data)):
        damaged = bytearray(data)
        damaged[bit >> 3] ^= 1 << (bit & 7)
        try:
            found: object = len(decompress(memoryview(damaged), 600, OFFSET))
        except StreamError as error:
            found = error.fault
        assert found in (600, Fault.E_FRAME, Fault.E_ZSTD)
        assert is_in_subset(bytes(damaged), 600) == (found is not Fault.E_FRAME)


# --- writing -------------------------------------------------------------------------------------

SIZES = [0, 1, 2, 255, 256, 257, 65791, 65792, 128 * KIB, 128 * KIB + 1, MIB]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("make", [text, noise, bytes])
def test_what_is_written_is_inside_the_subset_and_comes_back(make, size):
    data = make(size)
    stored = store(data)
    frames = {stored, *(compress(data, effort) for effort in (1, 3, 12, 19))}
    if size <= 128 * KIB:
        frames.add(compress(data, 22))
    for written in frames:
        check_frame(memoryview(written), size, OFFSET)
        assert decompress(memoryview(written), size, OFFSET) == data
        assert len(written) <= len(stored)
    n_blocks = max(1, -(-size // (128 * KIB)))
    assert len(stored) - size - 3 * n_blocks in (6, 7, 9)


@pytest.mark.parametrize("make", [bytes, noise])
def test_a_frame_may_hold_16_mib_and_no_more(make):
    data = make(MAX_CONTENT)
    for written in (store(data), compress(data, 1)):
        assert decompress(memoryview(written), MAX_CONTENT, OFFSET) == data
    for write in (store, lambda content: compress(content, 1)):
        with pytest.raises(ValueError, match="too many"):
            write(data + b"\0")


@pytest.mark.parametrize("size", [1, 300, 70_000])
def test_the_same_content_gives_the_same_frame_whatever_was_written_before(size):
    first = compress(text(size), 19)
    compress(noise(12345), 19)
    compress(noise(12345), 3)
    assert compress(text(size), 19) == first


def by_libzstd(data, level):
    """The size at a level as it is."""
    return len(zstandard.ZstdCompressor(level=level, write_content_size=True).compress(data))


@pytest.mark.parametrize("effort", [16, 19])
def test_planes_without_repeats_take_fewer_bytes_than_a_search_for_them_leaves(effort):
    plane = np.random.default_rng(0).geometric(0.5, 100_000).astype(np.uint8).tobytes()
    assert len(compress(plane, effort)) < by_libzstd(plane, effort)


@pytest.mark.parametrize("effort", [16, 19])
def test_repeats_are_found_however_far_apart(effort):
    data = 2 * noise(60_000)
    assert len(compress(data, effort)) < 61_000
    assert len(compress(data, effort)) <= by_libzstd(data, effort)
