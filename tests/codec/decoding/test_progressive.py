"""The same integers, however the bytes of a stream come and in what order."""

import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
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
from evogs_codec.format.directory import read_directory
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Step
from tests.support.coded_strategies import coded_trees
from tests.support.examples import examples
from tests.support.pieces import overlapping_ranges, random_cut
from tests.support.strategies import trees
from tests.support.verdicts import fault_of, oracle_fault

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


# --- the same integers ----------------------------------------------------------------------------


@examples(25)
@given(SMALL, st.sampled_from([1, 2, 7, 1 << 30]))
def test_feeding_1_2_7_or_all_bytes_gives_what_decode_gives(tree, size):
    data = write(tree, zstd_level=1)
    assert fed_dump(data, size) == decode(data).dump()


@examples(60)
@given(SMALL, SEEDS)
def test_ranges_in_any_order_overlapping_or_not_give_what_decode_gives(tree, seed):
    data = write(tree, zstd_level=1)
    decoder = Decoder()
    steps = 0
    for a, b in overlapping_ranges(random.Random(seed), len(data)):
        steps += len(decoder.feed(data[a:b], a))
    decoder.close()
    assert dump_of(decoder) == decode(data).dump()
    assert steps == sum(len(tile.steps) for tile in tree.tiles) * (tree.sh_degree + 1)


@examples(40)
@given(SMALL, SEEDS)
def test_what_was_fed_so_far_is_always_the_largest_complete_cut(tree, seed):
    data = write(tree, zstd_level=1)
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


@pytest.mark.thorough
@examples(50)
@given(SMALL, SEEDS)
def test_any_legal_order_of_the_packets_gives_the_same_integers(tree, seed):
    data = write(tree, zstd_level=1)
    moved = in_another_order(data, random.Random(seed))
    assert decode(moved, verify=True).dump() == decode(data).dump()
    assert oracle.decode(moved, check_digests=True).dump() == decode(data).dump()
    assert fed_dump(moved, 97) == decode(data).dump()


@pytest.mark.thorough
@examples(60)
@given(SMALL, SEEDS)
def test_every_cut_decodes_as_the_oracle_does_with_sh_late_or_never(tree, seed):
    data = write(tree, zstd_level=1)
    for k in range(3):
        cut = random_cut(data, random.Random(seed + k))
        scene = oracle.decode(data, cut=cut.steps.tolist())
        decoded = decode(data, cut)
        assert decoded.dump() == scene.dump()
        splats = decoded.leaves(sh_degree=tree.sh_degree)
        assert [tuple(row) for row in splats.channels().T.tolist()] == scene.float_view()
        assert decode(extract(data, cut), verify=True).dump() == scene.dump()


@examples(40)
@given(SMALL)
def test_every_level_decodes_as_the_oracle_does(tree):
    data = write(tree, zstd_level=1)
    directory = read_directory(data)
    for level in range(tree.n_levels):
        cut = Cut.of_level(directory, level)
        assert decode(data, cut).dump() == oracle.decode(data, level=level).dump()


@pytest.mark.thorough
@examples(25)
@given(SMALL)
def test_every_prefix_decodes_as_the_oracle_does(tree):
    data = write(tree, zstd_level=1)
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


@pytest.mark.filterwarnings("ignore:position. splats are moved by up to")
@examples(15)
@given(trees(max_roots=5, max_steps=3, largest=300), SEEDS)
def test_encoded_trees_may_come_in_any_order_too(tree, seed):
    data = encode(tree, replace(PRESETS["trained"], zstd_level=1), n_tiles=2)
    decoder = Decoder()
    for a, b in overlapping_ranges(random.Random(seed), len(data)):
        decoder.feed(data[a:b], a)
    decoder.close()
    expected = oracle.decode(data, check_digests=True).dump()
    assert dump_of(decoder) == decode(data, verify=True).dump() == expected


# --- nothing is kept twice ------------------------------------------------------------------------


@pytest.mark.thorough
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
