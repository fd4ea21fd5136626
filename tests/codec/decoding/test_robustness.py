"""Damaged streams: refused with a code, or a legal scene; never anything else."""

import random

import numpy as np
import pytest

from evogs_codec import (
    PRESETS,
    AccuracyWarning,
    Cut,
    Decoder,
    Fault,
    StreamError,
    encode,
    lift,
    read_ply,
)
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.decoding.decode import decode, decode_prefix
from evogs_codec.decoding.replay import packet_body
from evogs_codec.format.directory import read_directory, read_header
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.render.demo_scene import make_scene
from tests.support import damage
from tests.support.damage import SMALL
from tests.support.verdicts import feed, oracle_verdict, verdict

# --- truncation ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "small", [SMALL[0], *(pytest.param(small, marks=pytest.mark.thorough) for small in SMALL[1:])]
)
@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.thorough)])
def test_every_prefix_is_refused_as_truncated_where_it_is_cut(small, step):
    data = damage.stream(**small)
    directory = read_directory(data)
    ends = directory.offsets + directory.packets["size"]
    starts = [0, 64, *directory.offsets.tolist()]
    stops = [64, directory.data_offset, *ends.tolist()]
    for n in range(0, len(data), step):
        with pytest.raises(StreamError) as caught:
            decode(data[:n])
        cut_short = next(a for a, b in zip(starts, stops, strict=True) if b > n)
        assert (caught.value.fault, caught.value.offset) == (Fault.E_TRUNCATED, cut_short), n


@pytest.mark.parametrize("small", SMALL)
def test_every_prefix_with_header_and_chunks_gives_the_scene_of_its_complete_packets(small):
    data = damage.stream(**small)
    directory = read_directory(data)
    ends = directory.offsets + directory.packets["size"]
    for n in range(directory.data_offset):
        with pytest.raises(StreamError, match="E_TRUNCATED"):
            decode_prefix(data[:n])
    known = {}
    for n in range(directory.data_offset, len(data) + 1):
        n_whole = int(np.searchsorted(ends, n, side="right"))
        if n_whole not in known:
            known[n_whole] = decode(data, Cut.of_rows(directory, np.arange(n_whole))).dump()
            assert decode_prefix(data[:n]).dump() == known[n_whole]
        else:  # decoding again for each byte would only repeat the packets: the cut decides
            there = Cut.of_complete(directory, ends <= n)
            assert (there.steps == Cut.of_rows(directory, np.arange(n_whole)).steps).all()
    assert len(known) > 2


# --- flips ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("small", SMALL)
@pytest.mark.parametrize("step", [37, pytest.param(1, marks=pytest.mark.thorough)])
def test_every_single_bit_flip_is_refused(small, step):
    data = damage.stream(**small)
    for bit in range(0, 8 * len(data), step):
        with pytest.raises(StreamError):
            decode(damage.flipped(data, bit))


@pytest.mark.parametrize("small", SMALL)
@pytest.mark.parametrize("step", [61, pytest.param(23, marks=pytest.mark.thorough)])
def test_flips_with_repaired_checksums_get_the_verdict_of_the_oracle(small, step):
    check_repaired_flips(damage.stream(**small), step=step)


@pytest.mark.parametrize("small", SMALL)
@pytest.mark.parametrize("step", [97, pytest.param(47, marks=pytest.mark.thorough)])
def test_compiled_loops_give_the_verdict_of_the_oracle_too(small, step, monkeypatch):
    pytest.importorskip("numba")
    monkeypatch.setattr(dispatch, "MIN_COMPILED", 0)
    check_repaired_flips(damage.stream(**small), step=step)


@pytest.mark.slow
@pytest.mark.parametrize("small", SMALL)
def test_compiled_loops_give_the_verdict_of_the_oracle_for_all_flips(small, monkeypatch):
    pytest.importorskip("numba")
    monkeypatch.setattr(dispatch, "MIN_COMPILED", 0)
    check_repaired_flips(damage.stream(**small), step=1)


@pytest.mark.slow
@pytest.mark.parametrize("small", [*SMALL, {"n_roots": 4, "degree": 1}])
def test_all_flips_with_repaired_checksums_get_the_verdict_of_the_oracle(small):
    check_repaired_flips(damage.stream(**small), step=1)


def check_repaired_flips(data, step):
    assert damage.repaired(data) == data
    accepted = 0
    for bit in range(0, 8 * len(data), step):
        damaged = damage.repaired(damage.flipped(data, bit))
        expected = oracle_verdict(damaged)
        assert verdict(damaged) == expected, f"bit {bit} (byte {bit >> 3})"
        accepted += isinstance(expected, bytes)
    assert accepted > 0


@pytest.mark.parametrize("step", [127, pytest.param(61, marks=pytest.mark.thorough)])
def test_flips_with_repaired_checksums_never_trouble_info_or_feeding(step):
    from evogs_codec.editing.byte_stats import bytes_by_group, levels

    data = damage.stream(**SMALL[0])
    for bit in range(5, 8 * len(data), step):
        damaged = damage.repaired(damage.flipped(data, bit))
        try:
            directory = read_directory(damaged)
            levels(directory)
            bytes_by_group(directory, memoryview(damaged))
        except StreamError:
            pass
        assert fed_verdict(damaged) == whole_verdict(damaged), bit


def fed_verdict(data):
    decoder = Decoder()
    try:
        for at in range(0, len(data), 97):
            decoder.feed(data[at : at + 97])
        decoder.close()
    except StreamError as error:
        return error.fault, error.offset
    return decoder.leaves().channels().tobytes()


def whole_verdict(data):
    try:
        decoded = decode(data)
    except StreamError as error:
        return error.fault, error.offset
    return decoded.leaves().channels().tobytes()


def check_random_flips(data, n_flips, seed):
    """Each flip is in a structure whose CRC-32 is checked before it is used."""
    buffer = bytearray(data)
    view = memoryview(buffer)
    directory = read_directory(data)
    random_ = random.Random(seed)
    silent = []
    for _ in range(n_flips):
        bit = random_.randrange(8 * len(data))
        at = bit >> 3
        buffer[at] ^= 1 << (bit & 7)
        try:
            if at < directory.data_offset:
                read_directory(view)
            else:
                packet = int(np.searchsorted(directory.offsets, at, side="right")) - 1
                packet_body(directory, view, packet)
            silent.append(bit)
        except StreamError:
            pass
        buffer[at] ^= 1 << (bit & 7)
    assert not silent
    assert buffer == data


@pytest.mark.thorough
def test_random_flips_in_a_medium_stream_are_all_noticed():
    tree = EvolutionTree.of_splats(make_scene(20_000))
    with pytest.warns(AccuracyWarning, match="splats are moved by up to"):
        data = encode(tree, PRESETS["scene"].finer(0.25), n_tiles=4, digests=False)
    check_random_flips(data, 3000, seed=1)
    for bit in random.Random(2).sample(range(8 * len(data)), 3):
        with pytest.raises(StreamError):
            decode(damage.flipped(data, bit))


@pytest.mark.slow
def test_ten_thousand_flips_in_the_half_million_splat_stream_are_all_noticed(shared):
    tree = lift(read_ply(shared / "data" / "playbot" / "playbot.ply"), 4)
    data = encode(tree, PRESETS["scene"])
    check_random_flips(data, 10_000, seed=3)
    for bit in random.Random(4).sample(range(8 * len(data)), 20):
        with pytest.raises(StreamError):
            decode(damage.flipped(data, bit))


# --- other files ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"", "E_TRUNCATED"),
        (b"\x89EVG", "E_TRUNCATED"),
        (b"\0\0\0\0", "E_SIGNATURE"),
        (bytes(1000), "E_SIGNATURE"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "E_SIGNATURE"),
        (b"\x89", "E_TRUNCATED"),
        (b"\x89E", "E_TRUNCATED"),
        (b"ply\nformat binary_little_endian 1.0\n", "E_SIGNATURE"),
    ],
)
def test_what_is_no_stream_is_refused_by_its_first_bytes(data, code):
    for read in (decode, decode_prefix, feed):
        with pytest.raises(StreamError) as caught:
            read(data)
        assert (caught.value.fault.name, caught.value.offset) == (code, 0)
    assert oracle_verdict(data) == (code, 0)


def test_random_bytes_are_refused_also_behind_a_right_header():
    random_ = random.Random(5)
    head = damage.stream(**SMALL[0])[:64]
    for n in range(300):
        for data in (random_.randbytes(n), head + random_.randbytes(n)):
            for read in (decode, decode_prefix, feed, read_header):
                if read is read_header and data[:64] == head:
                    continue
                with pytest.raises(StreamError):
                    read(memoryview(data))
