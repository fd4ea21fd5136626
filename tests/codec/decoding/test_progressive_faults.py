"""The same faults, however the bytes of a damaged stream come and in what order."""

import random
import struct
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conformance.decoders import oracle
from evogs_codec.decoding.decode import decode, decode_prefix
from evogs_codec.decoding.progressive import Decoder
from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.settings import PRESETS
from evogs_codec.errors import StreamError
from evogs_codec.format.directory import read_directory
from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Step
from tests.support import damage
from tests.support.examples import examples
from tests.support.pieces import overlapping_ranges, random_cut
from tests.support.verdicts import fault_of, oracle_fault

SEEDS = st.integers(0, 2**32)


@cache
def samples() -> tuple[bytes, ...]:
    """Two streams of a few tiles, levels and SH bands, always the same."""
    streams = []
    for degree, seed in ((1, 5), (0, 9)):
        rng = np.random.default_rng(seed)
        tree = random_tree(rng, degree)
        streams.append(encode(tree, replace(PRESETS["trained"], zstd_level=1), n_tiles=2))
    return tuple(streams)


def random_tree(rng: np.random.Generator, degree: int) -> EvolutionTree:
    """Eight roots; six of them are split, refined or dropped, and two more come."""
    d = n_channels(degree)

    def numbers(n):
        return rng.uniform(-1, 1, (d, n)).astype(np.float32)

    kinds = np.array([1, 0, 2, 1, 1, 0], np.uint8)
    alpha = rng.choice([1.0, 0.5, -1.0], (5, 3)).astype(np.float32)
    record = Step(1, np.arange(6, dtype=np.int32), kinds, numbers(5), alpha, numbers(2))
    return EvolutionTree(degree, (Step.of_adds(0, numbers(8)), record))


def feed_all(data: bytes, pieces: list[tuple[int, int]]) -> None:
    decoder = Decoder()
    for a, b in pieces:
        decoder.feed(data[a:b], a)
    decoder.close()


def with_wrong_digests(data: bytes) -> bytes:
    directory = read_directory(data)
    at = directory.digests_offset + 12
    size = struct.unpack_from("<I", data, directory.digests_offset + 4)[0]
    rows = bytes(b ^ (k % 41 == 40) for k, b in enumerate(data[at : at + size]))
    return damage.repaired(data[:at] + rows + data[at + size :])


def damaged(data: bytes, rng: random.Random) -> bytes:
    """One or two kinds of damage."""
    out = bytearray(data)
    kind = rng.choice(["flip", "flip", "set", "two", "cut", "more", "swap"])
    if kind == "cut":
        return data[: rng.randrange(len(data))]
    if kind == "more":
        out += bytes(rng.randrange(1, 4))
    for _ in range(2 if kind == "two" else 1):
        at = rng.randrange(len(data))
        if kind == "set":
            out[at] = rng.choice([0, 1, 127, 128, 255])
        elif kind != "more" or rng.random() < 0.5:
            out[at] ^= 1 << rng.randrange(8)
    if kind == "swap":
        a = rng.randrange(len(data) - 8)
        out[a : a + 8] = reversed(out[a : a + 8])
    return bytes(out) if rng.random() < 0.3 else damage.repaired(bytes(out))


@pytest.mark.thorough
@examples(200)
@given(st.sampled_from([0, 1]), SEEDS)
def test_decode_and_the_oracle_and_every_way_of_feeding_find_the_same_fault(which, seed):
    rng = random.Random(seed)
    data = damaged(samples()[which], rng)
    expected = oracle_fault(oracle.decode, data)
    assert fault_of(decode, data) == expected
    checked = oracle_fault(oracle.decode, data, check_digests=True)
    assert fault_of(decode, data, verify=True) == checked
    size = rng.choice([13, 100, 1 << 30])
    pieces = [(at, min(at + size, len(data))) for at in range(0, len(data), size)]
    assert fault_of(feed_all, data, pieces) == expected
    if data:
        assert fault_of(feed_all, data, overlapping_ranges(rng, len(data))) == expected
    if expected is None:
        assert decode(data).dump() == oracle.decode(data).dump()


@examples(60)
@given(st.sampled_from([0, 1]), SEEDS)
def test_a_prefix_of_a_damaged_stream_is_judged_as_the_oracle_judges_it(which, seed):
    rng = random.Random(seed)
    data = damaged(samples()[which], rng)
    data = data[: rng.randrange(len(data) + 1)]
    assert fault_of(decode_prefix, data) == oracle_fault(oracle.decode_prefix, data)


@examples(60)
@given(st.sampled_from([0, 1]), SEEDS)
def test_a_cut_of_a_damaged_stream_is_judged_as_the_oracle_judges_it(which, seed):
    rng = random.Random(seed)
    good = samples()[which]
    cut = random_cut(good, rng)
    start = read_directory(good).data_offset
    data = bytearray(good)
    for _ in range(3):
        data[rng.randrange(start, len(data))] ^= 1 << rng.randrange(8)
    data = bytearray(damage.repaired(bytes(data)) if rng.random() < 0.7 else data)
    steps = cut.steps.tolist()
    assert fault_of(decode, bytes(data), cut) == oracle_fault(oracle.decode, bytes(data), cut=steps)


def test_a_fault_waits_for_the_packets_before_it():
    data = bytearray(samples()[0])
    directory = read_directory(bytes(data))
    last = int(directory.offsets[-1])
    data[last] ^= 1
    fed = bytes(data)
    decoder = Decoder()
    decoder.feed(fed[: directory.data_offset])
    decoder.feed(fed[last:], last)  # no fault yet: earlier packets may have one too
    with pytest.raises(StreamError) as caught:
        decoder.feed(fed[directory.data_offset : last], directory.data_offset)
    assert (caught.value.fault.name, caught.value.offset) == ("E_CRC", last)


def test_bytes_after_the_last_packet_come_before_a_wrong_digest():
    data = with_wrong_digests(samples()[0])
    at = read_directory(data).digests_offset
    for stream, fault in ((data, ("E_DIGEST", at)), (data + b"x", ("E_TRAILING", len(data)))):
        assert fault_of(decode, stream, verify=True) == fault
        assert oracle_fault(oracle.decode, stream, check_digests=True) == fault
