"""Large packets of a palette come in parts, between packets that show something."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conformance.decoders import oracle
from evogs_codec import PRESETS, Cut, EvolutionTree, Palette, Step, decode, encode, read_directory
from evogs_codec.encoding import palette_entries, palette_parts
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.packet_order import highest_picks, packet_order
from evogs_codec.encoding.palette_entries import MAX_STEPS, MIN_OF_PART, NEVER, first_uses
from evogs_codec.encoding.palette_parts import apart, in_parts
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.write import write
from evogs_codec.model.components import CORE, PALETTE, PICKS
from evogs_codec.model.packet_id import PacketId

PALETTES = [PacketId(0, PALETTE, k) for k in range(9)]


@pytest.fixture(scope="module")
def tree():
    """20,000 splats of one level that share 3,000 vectors of SH band 1."""
    rng = np.random.default_rng(0)
    adds = Step.of_adds(0, rng.normal(size=(14, 20_000)).astype(np.float32))
    picks = rng.integers(0, 3_001, 20_000).astype(np.int32)
    entries = rng.normal(0, 0.2, (9, 3_000)).astype(np.float32)
    return EvolutionTree(0, (replace(adds, picks=picks),), palette=Palette(1, entries))


@pytest.fixture(scope="module")
def coded(tree):
    return quantise(arrange(tree, 1), 1, PRESETS["scene"])


def tile_packets(n):
    """Packets of core, and one of picks at last."""
    return [*(PacketId(0, CORE, k) for k in range(n)), PacketId(0, PICKS, 0)]


@pytest.mark.thorough
def test_a_large_packet_of_a_palette_comes_in_parts_for_hardly_more_bytes(tree, monkeypatch):
    data = encode(tree, PRESETS["scene"])
    directory = read_directory(data)
    rows = directory.packets[directory.palette_packets]
    assert len(rows) > 1
    assert set(rows["level"].tolist()) == {0}
    assert rows["n_adds"].sum() >= 2_990
    monkeypatch.setattr(palette_parts, "MAX_OF_PACKET", 1.0)
    whole = encode(tree, PRESETS["scene"])
    assert len(read_directory(whole).palette_packets) == 1
    assert len(data) <= (1 + palette_parts.MAX_ADDED) * len(whole)
    decoded = decode(data, verify=True)
    assert oracle.decode(data, check_digests=True).dump() == decoded.dump()
    assert decoded.dump() == decode(whole).dump()


def test_parts_are_as_many_as_their_bytes_ask_for_and_as_the_stream_can_bear(coded):
    packets = [*tile_packets(9), PALETTES[0]]

    def n_parts(n_bytes, share):
        sizes = dict.fromkeys(packets, int(n_bytes * (1 - share) / (len(packets) - 1)))
        sizes[PALETTES[0]] = int(n_bytes * share)
        return len(in_parts(coded, sizes).palette_rows)

    assert n_parts(10_000_000, 0.019) == 1
    assert n_parts(10_000_000, 0.03) == 2
    assert n_parts(10_000_000, 0.099) == 5
    assert n_parts(700_000, 0.099) == 3, "each part costs 900 bytes at most"
    assert n_parts(100_000, 0.5) == 1


def test_parts_hold_all_entries_in_order(coded):
    sizes = dict.fromkeys([*tile_packets(9), PALETTES[0]], 1_000_000)
    divided = in_parts(coded, sizes)
    n, parts = len(coded.entry_levels), divided.palette_rows
    assert len(parts) > 2
    assert np.concatenate([np.arange(n)[rows] for rows in parts]).tolist() == [*range(n)]
    assert max(rows.stop - rows.start for rows in parts) - n // len(parts) <= 1
    assert set(divided.palette_levels) == {0}
    assert divided.entries is coded.entries


def test_a_tree_without_a_large_palette_stays_itself(coded):
    small = {PALETTES[0]: 10, **dict.fromkeys(tile_packets(9), 1_000_000)}
    assert in_parts(coded, small) is coded
    bare = replace(coded, entries=None, entry_levels=coded.entry_levels[:0])
    assert in_parts(bare, dict.fromkeys(tile_packets(9), 1_000_000)) is bare


def test_other_packets_come_between_parts():
    packets = tile_packets(40)
    order = [*packets[:-1], *PALETTES[:4], packets[-1]]
    sizes = dict.fromkeys(packets, 230) | dict.fromkeys(PALETTES[:4], 180)  # of about 10,000
    found = apart(order, sizes, packets)
    runs = [len([*run]) for is_part, run in groupby(found, in_turn) if is_part]
    assert runs == [1, 1, 1, 1]
    assert found[-2:] == [PALETTES[3], packets[-1]]
    assert apart(order, sizes | dict.fromkeys(PALETTES, 10), packets) == order, "a short wait"


def test_parts_do_not_come_before_a_packet_that_shows_nothing():
    packets = tile_packets(40)
    order = [*packets[:-1], *PALETTES[:2], packets[-1]]
    sizes = dict.fromkeys(packets, 230) | dict.fromkeys(PALETTES[:2], 190)
    found = apart(order, sizes, {*packets} - {packets[39], packets[38]})
    assert found.index(PALETTES[0]) < found.index(packets[37]) < found.index(PALETTES[1])


def test_parts_that_find_no_place_are_not_far_from_their_picks():
    packets = tile_packets(20)
    order = [*packets[:-1], *PALETTES[:3], packets[-1]]
    sizes = dict.fromkeys(packets, 450) | dict.fromkeys(PALETTES[:3], 180)
    found = apart(order, sizes, packets)
    n_bytes = sum(sizes.values())
    passed = sum(sizes[packet] for packet in found[found.index(PALETTES[0]) :] if packet in packets)
    assert passed <= (palette_parts.MAX_PASSED + 0.05) * n_bytes + sizes[packets[-1]]


def in_turn(packet):
    return packet.component == PALETTE


@given(st.integers(0, 2**32 - 1))
def test_the_palette_only_comes_earlier(seed):
    """So what was legal stays legal: packets of the palette require but those before them."""
    rng = np.random.default_rng(seed)
    order = tile_packets(int(rng.integers(1, 30)))
    for packet in PALETTES[: rng.integers(1, 9)]:
        first = max((order.index(p) for p in order if in_turn(p)), default=0)
        order.insert(int(rng.integers(first + 1, len(order) + 1)), packet)
    sizes = {packet: int(rng.integers(0, 1000)) for packet in order}
    shows = {packet for packet in order if rng.random() < 0.8}
    found = apart(order, sizes, shows)
    assert sorted(found) == sorted(order)
    assert found[0] == order[0]
    for kind in (True, False):
        assert [p for p in found if in_turn(p) is kind] == [p for p in order if in_turn(p) is kind]
    for packet in order:
        if in_turn(packet):
            assert {*found[: found.index(packet)]} <= {*order[: order.index(packet)]}


# --- entries of steps -----------------------------------------------------------------------------


def two_steps(n_second=6_000, seed=1):
    """Two steps of one level: the first picks of 6,000 entries, the second of others as well."""
    rng, n = np.random.default_rng(seed), 6_000 + n_second
    steps = []
    for most in (6_000, n):
        adds = Step.of_adds(0, rng.normal(size=(14, 20_000)).astype(np.float32))
        steps.append(replace(adds, picks=rng.integers(0, most + 1, 20_000).astype(np.int32)))
    entries = rng.normal(0, 0.2, (9, n)).astype(np.float32)
    return EvolutionTree(0, tuple(steps), palette=Palette(1, entries[:, rng.permutation(n)]))


def coded_steps(n_second=6_000):
    return quantise([two_steps(n_second)], 1, PRESETS["scene"])


def test_the_first_use_of_an_entry_is_a_level_and_a_step():
    coded = coded_steps()
    tile, n = coded.tiles[0], len(coded.entry_uses)
    later = replace(tile.steps[1], level=3)
    uses = first_uses([replace(tile, steps=(*tile.steps, later))], n)
    assert set(uses.tolist()) == {0, 1}
    assert uses.tolist() == sorted(uses.tolist()), "entries are in order of use"
    assert set(first_uses([replace(tile, steps=(later,))], n).tolist()) == {3 * MAX_STEPS, NEVER}


def test_entries_come_before_the_first_step_that_picks_them():
    coded = coded_steps()
    first, both = highest_picks(coded.tiles[0].steps).tolist()
    assert 5_500 < first < 6_001 < both
    sizes = {PacketId(0, PALETTE, 0): 100_000}
    sizes |= {PacketId(0, c, k): 100_000 for c in (CORE, PICKS) for k in range(2)}
    divided = in_parts(coded, sizes)
    assert first in [rows.stop for rows in divided.palette_rows]
    n_first = sum(rows.stop <= first for rows in divided.palette_rows)
    sizes |= {PacketId(0, PALETTE, k): 30_000 for k in range(len(divided.palette_rows))}
    order = packet_order(divided, sizes)
    before = order[: order.index(PacketId(0, PICKS, 0))]
    assert PacketId(0, PALETTE, n_first - 1) in before


@pytest.mark.thorough
def test_a_stream_has_entries_behind_picks_of_their_level(monkeypatch):
    data = write(coded_steps())
    directory = read_directory(data)
    rows = directory.packets
    first, second = np.flatnonzero(rows["component"] == PICKS).tolist()
    assert first < directory.palette_packets[-1] < second
    assert directory.entries_required[first] < directory.entries_required[second]
    assert set(rows["level"].tolist()) == {0}
    decoded = decode(data, verify=True)
    assert oracle.decode(data, check_digests=True).dump() == decoded.dump()
    prefix = Cut.of_rows(directory, np.arange(first + 1))
    assert prefix.palette < len(directory.palette_packets)
    assert decode(data, prefix).dump() == oracle.decode(data, cut=as_of_oracle(prefix)).dump()
    monkeypatch.setattr(palette_entries, "MIN_OF_PART", 1 << 20)
    assert len(data) <= 1.005 * len(write(coded_steps()))


def as_of_oracle(cut):
    """A cut of one tile with picks and a palette."""
    core, picks = cut.steps[0].tolist()
    return [[core, 0, 0, 0, picks, cut.palette]]


def test_few_entries_of_a_step_are_among_those_of_the_step_before():
    coded = coded_steps(MIN_OF_PART - 500)
    assert set(coded.entry_uses.tolist()) == {0}
    enough = coded_steps(MIN_OF_PART + 500)
    assert set(enough.entry_uses.tolist()) == {0, 1}
