"""The same integers and the same faults, however the bytes of a stream come and in what order."""

import random
import struct
import zlib
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

from conformance.decoders import oracle
from conformance.fuzzing import memory
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode, decode_prefix
from evogs_codec.decoding.progressive import Decoder
from evogs_codec.editing.extract import extract
from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.settings import PRESETS
from evogs_codec.encoding.write import write
from evogs_codec.errors import StreamError
from evogs_codec.format.directory import read_directory
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Step
from tests.support.coded_strategies import coded_trees
from tests.support.strategies import trees

SMALL = coded_trees(max_tiles=2, max_steps=4, max_adds=3)
SEEDS = st.integers(0, 2**32)


def dump_of(decoder: Decoder) -> bytes:
    return decoder.decoded.dump()


def feed_in_pieces(decoder: Decoder, data: bytes, size: int) -> None:
    for at in range(0, len(data), size):
        decoder.feed(data[at : at + size])


def fed_dump(data: bytes, size: int) -> bytes:
    decoder = Decoder()
    feed_in_pieces(decoder, data, size)
    decoder.close()
    return dump_of(decoder)


def overlapping_ranges(rng: random.Random, size: int) -> list[tuple[int, int]]:
    """Ranges that cover 0..size, most of them overlapping, in random order."""
    cuts = [0, *sorted(rng.randrange(size + 1) for _ in range(rng.randrange(12))), size]
    ranges = [
        (max(0, a - rng.randrange(20)), min(size, b + rng.randrange(20))) for a, b in pairwise(cuts)
    ]
    ranges += [(a, a + 30) for a in (rng.randrange(size) for _ in range(3))]
    rng.shuffle(ranges)
    return ranges


def in_another_order(data: bytes, rng: random.Random) -> bytes:
    """The stream with its packets in a random order that R-5.6-2 and R-5.6-3 allow."""
    directory = read_directory(data)
    waiting: dict[tuple[int, int], list[int]] = {}
    for packet, row in enumerate(directory.packets):
        waiting.setdefault((int(row["tile"]), int(row["component"])), []).append(packet)
    lengths = {chain: len(packets) for chain, packets in waiting.items()}
    order = []
    while waiting:
        done = {chain: n - len(waiting.get(chain, [])) for chain, n in lengths.items()}
        ready = [(t, c) for t, c in waiting if c == 0 or done[t, 0] > done[t, c]]
        chain = rng.choice(ready)
        order.append(waiting[chain].pop(0))
        if not waiting[chain]:
            del waiting[chain]
    rows = directory.packets[np.array(order, np.int64)]
    head = rebuild_directory(directory, directory.tiles, rows, directory.digests)
    ends = directory.offsets + directory.packets["size"]
    return head + b"".join(data[directory.offsets[p] : ends[p]] for p in order)


def with_wrong_digests(data: bytes) -> bytes:
    directory = read_directory(data)
    at = directory.digests_offset + 12
    size = struct.unpack_from("<I", data, directory.digests_offset + 4)[0]
    rows = bytes(b ^ (k % 41 == 40) for k, b in enumerate(data[at : at + size]))
    return mended(data[:at] + rows + data[at + size :])


def random_cut(data: bytes, rng: random.Random) -> Cut:
    """Any valid cut: tiles differ, bands come late or never."""
    directory = read_directory(data)
    steps = directory.chain_lengths()
    for row in steps:
        row[0] = rng.randint(0, int(row[0]))
        for component in range(1, len(row)):
            row[component] = rng.choice([0, min(row[0], rng.randint(0, int(row[component])))])
    return Cut(steps)


# --- the same integers ----------------------------------------------------------------------------


@budget(max_examples=25)
@given(SMALL, st.sampled_from([1, 2, 7, 1 << 30]))
def test_feeding_1_2_7_or_all_bytes_gives_what_decode_gives(tree, size):
    data = write(tree, effort=1)
    assert fed_dump(data, size) == decode(data).dump()


@budget(max_examples=60)
@given(SMALL, SEEDS)
def test_ranges_in_any_order_overlapping_or_not_give_what_decode_gives(tree, seed):
    data = write(tree, effort=1)
    decoder = Decoder()
    steps = 0
    for a, b in overlapping_ranges(random.Random(seed), len(data)):
        steps += len(decoder.feed(data[a:b], a))
    decoder.close()
    assert dump_of(decoder) == decode(data).dump()
    assert steps == sum(len(tile.steps) for tile in tree.tiles) * (tree.sh_degree + 1)


@budget(max_examples=40)
@given(SMALL, SEEDS)
def test_what_was_fed_so_far_is_always_the_largest_complete_cut(tree, seed):
    data = write(tree, effort=1)
    directory = read_directory(data)
    decoder, there = Decoder(), np.zeros(len(data), bool)
    for a, b in overlapping_ranges(random.Random(seed), len(data)):
        decoder.feed(data[a:b], a)
        there[a:b] = True
        if decoder.directory is None:
            assert not there[: directory.data_offset].all()
            continue
        ends = directory.offsets + directory.packets["size"]
        complete = [there[i:j].all() for i, j in zip(directory.offsets, ends, strict=True)]
        cut = Cut.of_complete(directory, np.array(complete, bool))
        assert decoder.cut.steps.tolist() == cut.steps.tolist()
        assert dump_of(decoder) == oracle.decode(data, cut=cut.steps.tolist()).dump()


@budget(max_examples=50)
@given(SMALL, SEEDS)
def test_any_legal_order_of_the_packets_gives_the_same_integers(tree, seed):
    data = write(tree, effort=1)
    moved = in_another_order(data, random.Random(seed))
    assert decode(moved, verify=True).dump() == decode(data).dump()
    assert oracle.decode(moved, check_digests=True).dump() == decode(data).dump()
    assert fed_dump(moved, 97) == decode(data).dump()


@budget(max_examples=60)
@given(SMALL, SEEDS)
def test_every_cut_decodes_as_the_oracle_does_with_sh_late_or_never(tree, seed):
    data = write(tree, effort=1)
    for k in range(3):
        cut = random_cut(data, random.Random(seed + k))
        scene = oracle.decode(data, cut=cut.steps.tolist())
        decoded = decode(data, cut)
        assert decoded.dump() == scene.dump()
        splats = decoded.leaves(sh_degree=tree.sh_degree)
        assert [tuple(row) for row in splats.channels().T.tolist()] == scene.float_view()
        assert decode(extract(data, cut), verify=True).dump() == scene.dump()


@budget(max_examples=40)
@given(SMALL)
def test_every_level_decodes_as_the_oracle_does(tree):
    data = write(tree, effort=1)
    directory = read_directory(data)
    for level in range(tree.n_levels):
        cut = Cut.of_level(directory, level)
        assert decode(data, cut).dump() == oracle.decode(data, level=level).dump()


@budget(max_examples=25)
@given(SMALL)
def test_every_prefix_decodes_as_the_oracle_does(tree):
    data = write(tree, effort=1)
    directory = read_directory(data)
    ends = (directory.offsets + directory.packets["size"]).tolist()
    bounds = {0, 1, 63, 64, directory.data_offset, *ends}
    for size in sorted({b + d for b in bounds for d in (-1, 0, 1) if 0 <= b + d <= len(data)}):
        prefix = data[:size]
        if size < directory.data_offset:
            assert fault_of(decode_prefix, prefix) == oracle_fault(oracle.decode_prefix, prefix)
            continue
        expected = oracle.decode_prefix(prefix).dump()
        assert decode_prefix(prefix).dump() == expected
        decoder = Decoder()
        decoder.feed(prefix)
        assert dump_of(decoder) == expected


# --- the same faults ------------------------------------------------------------------------------


@cache
def samples() -> tuple[bytes, ...]:
    """Two streams of a few tiles, levels and SH bands, always the same."""
    streams = []
    for degree, seed in ((1, 5), (0, 9)):
        rng = np.random.default_rng(seed)
        tree = random_tree(rng, degree)
        streams.append(encode(tree, PRESETS["trained"], n_tiles=2))
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


def fault_of(function, *args, **options):
    """(code, offset) that the codec reports, or None."""
    try:
        function(*args, **options)
    except StreamError as error:
        return error.fault.name, error.offset
    return None


def oracle_fault(function, *args, **options):
    try:
        function(*args, **options)
    except oracle.FaultError as fault:
        return fault.code, fault.offset
    return None


def feed_all(data: bytes, pieces: list[tuple[int, int]]) -> None:
    decoder = Decoder()
    for a, b in pieces:
        decoder.feed(data[a:b], a)
    decoder.close()


def mended(data: bytes) -> bytes:
    """The stream with the CRC-32 of the header and of every chunk and packet made right."""
    out = bytearray(data)
    chunks_size, at = struct.unpack_from("<I", out, 32)[0], 64
    end = min(64 + chunks_size, len(out))
    table = None
    while at + 12 <= end:
        size = struct.unpack_from("<I", out, at + 4)[0]
        if out[at : at + 4] == b"PACK":
            table = (at + 12, size)
        at += 12 + size
    if table is not None and table[0] + table[1] <= len(out):
        start = 64 + chunks_size
        for row in range(table[0], table[0] + table[1] - 35, 36):
            size = struct.unpack_from("<I", out, row + 8)[0]
            struct.pack_into("<I", out, row + 32, zlib.crc32(out[start : start + size]))
            start += size
    at = 64
    while at + 12 <= end:
        size = struct.unpack_from("<I", out, at + 4)[0]
        crc = zlib.crc32(out[at : at + 8] + out[at + 12 : at + 12 + size])
        struct.pack_into("<I", out, at + 8, crc)
        at += 12 + size
    struct.pack_into("<I", out, 60, zlib.crc32(out[:60]))
    return bytes(out)


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
    return bytes(out) if rng.random() < 0.3 else mended(bytes(out))


@budget(max_examples=200)
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


@budget(max_examples=60)
@given(st.sampled_from([0, 1]), SEEDS)
def test_a_prefix_of_a_damaged_stream_is_judged_as_the_oracle_judges_it(which, seed):
    rng = random.Random(seed)
    data = damaged(samples()[which], rng)
    data = data[: rng.randrange(len(data) + 1)]
    assert fault_of(decode_prefix, data) == oracle_fault(oracle.decode_prefix, data)


@budget(max_examples=60)
@given(st.sampled_from([0, 1]), SEEDS)
def test_a_cut_of_a_damaged_stream_is_judged_as_the_oracle_judges_it(which, seed):
    rng = random.Random(seed)
    good = samples()[which]
    cut = random_cut(good, rng)
    start = read_directory(good).data_offset
    data = bytearray(good)
    for _ in range(3):
        data[rng.randrange(start, len(data))] ^= 1 << rng.randrange(8)
    data = bytearray(mended(bytes(data)) if rng.random() < 0.7 else data)
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


@budget(max_examples=15)
@given(trees(max_roots=5, max_steps=3, largest=300), SEEDS)
def test_encoded_trees_may_come_in_any_order_too(tree, seed):
    data = encode(tree, PRESETS["trained"], n_tiles=2)
    decoder = Decoder()
    for a, b in overlapping_ranges(random.Random(seed), len(data)):
        decoder.feed(data[a:b], a)
    decoder.close()
    expected = oracle.decode(data, check_digests=True).dump()
    assert dump_of(decoder) == decode(data, verify=True).dump() == expected


def test_bytes_that_come_before_the_directory_are_not_kept_twice():
    rng = np.random.default_rng(0)
    adds = rng.normal(size=(n_channels(0), 20_000)).astype(np.float32)
    data = encode(EvolutionTree(0, (Step.of_adds(0, adds),)), PRESETS["near-lossless"])
    third = len(data) // 3
    ranges = [(2 * third, len(data)), (third, 2 * third), (0, third)]

    def feed() -> None:
        decoder = Decoder()
        for begin, end in ranges:
            decoder.feed(data[begin:end], begin)
        decoder.close()

    feed()
    whole = memory.peak(lambda: decode(data), 0)
    # As they came, and packet by packet; the state, which grows by doubling, is small beside them.
    allowed = whole + int(3.2 * len(data))
    assert memory.peak(feed, allowed) <= allowed


def test_ranges_that_come_again_and_again_are_kept_once():
    adds = np.random.default_rng(0).normal(size=(n_channels(0), 4000)).astype(np.float32)
    data = encode(EvolutionTree(0, (Step.of_adds(0, adds),)), PRESETS["scene"])
    decoder = Decoder()
    half = len(data) // 2

    def feed() -> None:
        for at in range(len(data) - 1, half, -50):
            decoder.feed(data[at:], at)

    assert memory.peak(feed, 3 * len(data)) < 3 * len(data)
    decoder.feed(data[: half + 1], 0)
    decoder.feed(data[half:], half)
    decoder.close()
    assert decoder.dump() == decode(data).dump()
