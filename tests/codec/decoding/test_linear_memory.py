"""Memory is linear in the size of a file and in its counts (spec 8.3)."""

import numpy as np
import pytest

from conformance.fuzzing import memory
from conformance.generator.builder import DROP, SPLIT, Packet, Stream, X, build
from evogs_codec import Decoder, decode, write_ply
from evogs_codec.decoding.replay import packet_body
from evogs_codec.format.directory import read_directory
from evogs_codec.format.packet_header import read_packet_header
from evogs_codec.format.unpack import read_planes, unpack
from evogs_codec.model.arithmetic import StepPlan
from evogs_codec.model.tree import Kind
from tests.support.counting import Counted

N = 60_000


# --- steps ----------------------------------------------------------------------------------------


def test_a_step_takes_memory_by_its_records_and_not_by_the_slots_of_the_tile():
    slots, kinds = np.array([5, 7]), np.array([Kind.SPLIT, Kind.SPLIT], np.uint8)
    plan = StepPlan.of(slots, kinds, 1 << 24, 0)
    assert memory.peak(lambda: plan.split_slots, 1 << 16) < 1 << 16
    assert plan.split_slots.tolist() == [5, 7]
    assert StepPlan.of(slots - [0, 1], kinds, 9, 0).split_slots.tolist() == [5, 6]


# --- states and views -----------------------------------------------------------------------------


def large(*, late=False, dropped=False):
    """N slots at SH degree 3: the bands come before the last step, or a slot is dropped."""
    packets = [Packet(n_adds=N, adds={X: [0, -1] * (N // 2)})]
    packets += [Packet(component=b, adds={0: [0, -1] * (N // 2)}) for b in (1, 2, 3)]
    last = Packet(records={0: DROP} if dropped else {0: SPLIT}, psi={} if dropped else {X: [1]})
    packets.append(last)
    if not late:
        packets += [Packet(component=b) for b in (1, 2, 3)]
    return build(Stream(packets, degree=3))


@pytest.mark.parametrize("what", [{"late": True}, {"dropped": True}], ids=str)
def test_one_late_band_or_dropped_slot_makes_no_copy_of_the_state(what):
    decoded = decode(large(**what))
    view = 4 * 59 * N
    few_arrays = 6 * 4 * N + (6 << 20)  # and huge pages, and blocks of slots
    assert memory.peak(decoded.leaves, view + few_arrays) < view + few_arrays


@pytest.mark.parametrize("what", [{}, {"late": True}, {"dropped": True}], ids=str)
def test_a_dump_takes_its_own_size_and_not_several_times(what):
    decoded = decode(large(**what))
    size = len(decoded.dump())
    assert memory.peak(decoded.dump, int(1.3 * size)) < 1.3 * size
    largest = memory.peak(lambda: [len(part) for part in decoded.dump_parts()], size)
    assert largest < 5 * 4 * N


def test_a_state_that_grows_takes_no_more_than_spec_8_3_says():
    data = build(Stream([Packet(n_adds=700, adds={X: [k] * 700}) for k in range(1, 34)], degree=3))
    state = (4 * 59 + 5) * 33 * 700

    def feed():
        decoder = Decoder()
        for at in range(0, len(data), 1000):
            decoder.feed(data[at : at + 1000])

    allowed = 3 * state + 3 * len(data) + (1 << 18)
    assert memory.peak(feed, allowed) < allowed


def test_a_state_does_not_grow_step_by_step_where_its_packets_are_all_there():
    data = build(Stream([Packet(n_adds=700, adds={X: [k] * 700}) for k in range(1, 34)], degree=3))
    state = (4 * 59 + 5) * 33 * 700

    def feed():
        decoder = Decoder()
        for at in reversed(range(0, len(data), 1000)):
            decoder.feed(data[at : at + 1000], at)

    allowed = int(1.1 * state) + 3 * len(data) + (1 << 18)
    assert memory.peak(feed, allowed) < allowed


def test_a_ply_is_written_without_a_copy_of_the_splats(tmp_path):
    splats = decode(large()).leaves()
    block = 4 * 59 * 4096
    written = memory.peak(lambda: write_ply(tmp_path / "a.ply", splats), 3 * block)
    assert written < 3 * block < 4 * 59 * N / 4


def test_a_view_without_sh_bands_reads_none():
    decoded = decode(large(dropped=True))
    tile = decoded.tiles[0]
    tile.x = tile.x.view(Counted)
    Counted.n_read = 0
    assert decoded.leaves(sh_degree=0).sh_degree == 0
    assert Counted.n_read < 3 * 14 * N  # of 59 channels it was more


def test_a_state_that_is_almost_whole_at_once_is_not_copied_as_it_grows():
    state = (4 * 59 + 5) * N
    data = large()

    def feed():
        Decoder().feed(data)

    few_arrays = 8 * 4 * N + 3 * len(data) + (1 << 18)
    assert memory.peak(feed, state + few_arrays) < state + few_arrays


def many_frames():
    """N splats whose planes are a frame each, and their size."""
    packet = Packet(
        n_adds=N, adds=dict.fromkeys(range(14), [300, -300] * (N // 2)), frames=[1] * 28
    )
    data = build(Stream([packet]))
    return data, 2 * 14 * N


def test_planes_in_many_frames_are_not_there_twice():
    data, size = many_frames()
    directory = read_directory(data)
    body = packet_body(directory, memoryview(data), 0)
    head = read_packet_header(body, 0, directory.counts(0), 0)
    assert sum(head.plane_sizes) == size
    assert memory.peak(lambda: read_planes(body, head, 0), int(1.2 * size)) < 1.2 * size


@pytest.mark.parametrize("flags", [0, 2], ids=["colours", "turned colours"])
def test_lists_become_integers_without_large_arrays_beside_them(flags):
    n = 8 * N
    lists = dict.fromkeys((11, 12, 13), [300, -300] * (n // 2))
    coding = {f"adds {k}": 0x28 | 64 for k in lists}
    packet = Packet(n_adds=n, adds=lists, codings=coding, flags=flags)
    data = build(Stream([packet]))
    directory = read_directory(data)
    body = packet_body(directory, memoryview(data), 0)
    adds = unpack(body, 0, directory.counts(0), 0).adds
    allowed = 4 * n * (3 if flags else 1) + (3 << 20)
    assert memory.peak(lambda: adds.rows(11), allowed) < allowed
