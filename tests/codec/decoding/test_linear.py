"""Time and memory are linear in the size of a file and in its counts (spec 8.3).

No test measures seconds: each counts instructions, numbers read, bytes hashed, or memory.
"""

import hashlib
import sys
from random import Random

import numpy as np
import pytest

from conformance.fuzzing import memory
from conformance.generator.builder import (
    DROP,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    X,
    build,
    places,
)
from conformance.generator.random_streams import random_stream
from evogs_codec import PRESETS, Decoder, EvolutionTree, StreamError, decode, encode, write_ply
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.replay import packet_body
from evogs_codec.editing.byte_stats import bytes_by_group, levels
from evogs_codec.editing.extract import extract
from evogs_codec.editing.omissions import omissions
from evogs_codec.format.crc import crc32
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.packet_header import read_packet_header
from evogs_codec.format.unpack import read_planes, unpack
from evogs_codec.model.arithmetic import StepPlan
from evogs_codec.model.components import component_slice
from evogs_codec.model.tree import Kind
from evogs_codec.render.demo_scene import make_scene


def n_instructions(function):
    """Instructions of Python that a call executes."""
    count = 0

    def trace(frame, event, arg):
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        count += event == "opcode"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        function()
    finally:
        sys.settrace(before)
    return count


def assert_linear(work, size):
    """Twice the size takes at most about twice the instructions of `work(size)()`."""
    once, twice = n_instructions(work(size)), n_instructions(work(2 * size))
    assert twice < 2.3 * once


# --- late SH --------------------------------------------------------------------------------------


class Counted(np.ndarray):
    """An array that counts the numbers that are read of it."""

    n_read = 0

    def __getitem__(self, key):
        found = super().__getitem__(key)
        Counted.n_read += np.size(found)
        return found


def chain(n):
    """A slot that is split from the last one made, n times, and SH that came before."""
    packets = [Packet(adds={X: [0]}), Packet(component=1, adds={0: [7]})]
    packets += [Packet(records={slot: SPLIT}, psi={X: [1]}) for slot in range(n)]
    return build(Stream(packets, degree=1))


def test_late_sh_reads_each_parent_once():
    n = 400
    tile = decode(chain(n)).tiles[0]
    tile.born_from = tile.born_from.view(Counted)
    Counted.n_read = 0
    rows = tile.channels()[component_slice(1)]
    assert Counted.n_read <= 3 * n  # one by one and round by round it was n * n / 2
    assert (rows[0] == 7).all()


# --- digests --------------------------------------------------------------------------------------


def test_states_that_did_not_change_are_hashed_once(monkeypatch):
    n_bytes, sha256 = 0, hashlib.sha256

    class Hash:
        def __init__(self, data=b""):
            self.hash = sha256(data)

        def update(self, data):
            nonlocal n_bytes
            n_bytes += memoryview(data).nbytes
            self.hash.update(data)

        def digest(self):
            return self.hash.digest()

    packets = [Packet(adds={X: list(range(100))}), Packet(component=1, adds={0: [5] * 100})]
    packets += [Packet(component=component) for _ in range(9) for component in (0, 1)]
    names = [(0, component, step) for component in (0, 1) for step in range(10)]
    data = build(Stream(packets, degree=1, digests=dict.fromkeys(names)))
    sizes = read_directory(data).state_sizes
    monkeypatch.setattr("evogs_codec.decoding.tile_state.hashlib.sha256", Hash)
    decode(data, verify=True)
    assert n_bytes <= int(sizes[0] + sizes[1])


def digested(n_steps, *, last):
    """16,000 slots, then empty steps with digests, then a packet of 10 kB at level 1."""
    packets = [Packet(n_adds=16_000, adds={X: [0, -1] * 8000})] + [Packet()] * n_steps
    packets += [Packet(level=1, n_adds=5000, adds={X: list(range(5000))})] if last else []
    names = dict.fromkeys((0, 0, step) for step in range(n_steps + 1))
    return build(Stream(packets, n_levels=2, digests=names))


def test_extracted_streams_keep_no_more_digests_than_they_may():
    data = digested(20, last=True)
    directory = read_directory(data)
    smaller = extract(data, Cut.of_level(directory, 0))
    found = read_directory(smaller)
    assert list(found.digests) == [(0, 0, 20)]
    assert decode(smaller, verify=True).dump() == decode(data, Cut.of_level(directory, 0)).dump()
    with pytest.raises(StreamError, match="E_AMPLIFICATION"):
        decode(digested(20, last=False))


# --- info -----------------------------------------------------------------------------------------


def many_tiles(n):
    """A step in each of n tiles, of 64 levels."""
    packets = [Packet(tile=t, level=t * 64 // n, adds={X: [1]}, row={"error": t}) for t in range(n)]
    return build(Stream(packets, n_levels=64, tiles=[Tile()] * n, tier=2))


def test_figures_per_level_do_not_look_at_tiles_one_by_one():
    def work(n):
        directory = read_directory(many_tiles(n))
        return lambda: levels(directory)

    assert n_instructions(work(400)) < 1.1 * n_instructions(work(40))


@pytest.mark.parametrize("figures", [bytes_by_group, omissions])
def test_figures_of_packets_are_linear_in_packets(figures):
    def work(n):
        data = memoryview(many_tiles(n))
        directory = read_directory(data)
        return lambda: figures(directory, data)

    assert_linear(work, 100)


def test_the_entropy_of_many_small_planes_takes_a_call_for_each_packet(monkeypatch):
    n_calls, bincount = 0, np.bincount

    def counted(*args, **options):
        nonlocal n_calls
        n_calls += 1
        return bincount(*args, **options)

    one = Packet(adds={channel: [3, -300] for channel in range(14)})
    data = memoryview(build(Stream([one] * 20)))
    directory = read_directory(data)
    monkeypatch.setattr(np, "bincount", counted)
    assert bytes_by_group(directory, data)["position"].n_bytes > 0
    assert n_calls <= 20


# --- feeding --------------------------------------------------------------------------------------


def waiting(n):
    """A packet, n that require it, and an empty step in each of n other tiles."""
    packets = [Packet(tile=n, adds={X: [1]})]
    packets += [Packet(tile=n, records={0: REFINE}, psi={X: [1]}) for _ in range(n)]
    packets += [Packet(tile=t) for t in range(n)]
    return build(Stream(packets, tiles=[Tile()] * (n + 1), tier=2))


@pytest.mark.parametrize("late", [1, 0], ids=["the first packet is missing", "all come"])
def test_feeding_pieces_is_linear_whatever_waits(late):
    def work(n):
        data, decoder = waiting(n), Decoder()
        first, second = places(data).packets[0]
        decoder.feed(data[:first], 0)

        def feed():
            for at in range(second if late else first, len(data), 4):
                decoder.feed(data[at : at + 4], at)

        return feed

    assert_linear(work, 150)


def test_alpha_tables_are_looked_up_once_and_not_for_each_tile(monkeypatch):
    pytest.importorskip("evogs_codec.decoding.compiled.channels", reason="numba is an extra")
    n_calls, alpha_table = 0, Directory.alpha_table

    def counted(*args):
        nonlocal n_calls
        n_calls += 1
        return alpha_table(*args)

    monkeypatch.setattr(Directory, "alpha_table", counted)
    monkeypatch.setattr(dispatch, "MIN_COMPILED", 0)
    data = many_tiles(20)
    decode(data)
    assert n_calls == 64 * 5


def test_single_bytes_in_the_worst_order_take_linear_calls_and_memory():
    def work(n):
        data = build(Stream([Packet(adds={X: list(range(0, 2000 * n, 2000))})]))
        decoder = Decoder()

        def feed():
            for at in reversed(range(len(data))):
                decoder.feed(data[at : at + 1], at)

        return feed

    assert_linear(work, 1500)
    assert memory.peak(work(3000), 1 << 21) < 1 << 21


def test_ranges_in_any_order_give_their_bytes():
    from evogs_codec.decoding.progressive import _Ranges

    rng = Random(1)
    for _ in range(200):
        data = rng.randbytes(rng.randrange(1, 20_000))
        ranges, there = _Ranges(), bytearray(len(data))
        for _ in range(rng.randrange(1, 60)):
            at = rng.randrange(len(data))
            part = data[at : at + rng.choice((1, 50, 3000))]
            ranges.put(at, part)
            there[at : at + len(part)] = b"\1" * len(part)
        head = there.index(0) if 0 in there else len(data)
        assert ranges.prefix() == data[:head]
        kept = bytearray(len(data))
        for begin, piece in ranges.all():
            assert bytes(piece) == data[begin : begin + len(piece)]
            kept[begin : begin + len(piece)] = b"\1" * len(piece)
        assert kept == there


# --- steps ----------------------------------------------------------------------------------------


def test_a_step_takes_memory_by_its_records_and_not_by_the_slots_of_the_tile():
    slots, kinds = np.array([5, 7]), np.array([Kind.SPLIT, Kind.SPLIT], np.uint8)
    plan = StepPlan.of(slots, kinds, 1 << 24, 0)
    assert memory.peak(lambda: plan.split_slots, 1 << 16) < 1 << 16
    assert plan.split_slots.tolist() == [5, 7]
    assert StepPlan.of(slots - [0, 1], kinds, 9, 0).split_slots.tolist() == [5, 6]


# --- memory ---------------------------------------------------------------------------------------

N = 60_000


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


# --- bytes that change ----------------------------------------------------------------------------


@pytest.mark.parametrize("min_compiled", [0, dispatch.MIN_COMPILED])
def test_bytes_that_change_after_their_checksum_was_checked_do_not_matter(
    monkeypatch, min_compiled
):
    monkeypatch.setattr(dispatch, "MIN_COMPILED", min_compiled)
    tree = EvolutionTree.of_splats(make_scene(50))
    right, data = (
        decode(encode(tree, PRESETS["trained"])).dump(),
        bytearray(encode(tree, PRESETS["trained"])),
    )
    begin, end = places(bytes(data)).packets[0]
    before = crc32

    def and_change(covered, *more):
        found = before(covered, *more)
        if len(covered) == end - begin:
            data[begin + 1] = 250  # the number of frames
        return found

    monkeypatch.setattr(dispatch, "crc32", and_change)
    monkeypatch.setattr("evogs_codec.format.directory.crc32", and_change)
    assert decode(memoryview(data)).dump() == right


def test_header_reading_writes_no_more_frames_than_there_is_room_for():
    kernels = pytest.importorskip(
        "evogs_codec.decoding.compiled.channels", reason="numba is an extra"
    )
    data = encode(EvolutionTree.of_splats(make_scene(50)), PRESETS["trained"])
    directory = read_directory(data)
    row = directory.packets[:1]
    counts = np.array([[int(row["n_adds"][0]), 0, 0, 0]])
    n = kernels.MAX_LISTS
    frames = np.full((40, 3), -1, np.int64)
    found = kernels.read_headers(
        np.frombuffer(data, np.uint8), directory.offsets[:1], row["size"].astype(np.int64),
        np.zeros(1, np.int64), counts, np.empty((1, n), np.uint8), np.empty((1, n), np.int64),
        np.empty(1, np.int64), frames[:0],
    )  # fmt: skip
    assert found == -1
    assert (frames == -1).all()


def test_random_streams_decode_alike_from_bytes_that_may_change():
    for seed in range(20):
        data = random_stream(Random(seed))
        assert decode(memoryview(bytearray(data))).dump() == decode(data).dump()
