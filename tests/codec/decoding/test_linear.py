"""Time is linear in the size of a file and in its counts (spec 8.3).

No test measures seconds: each counts instructions, calls, numbers read, or bytes hashed.
"""

import hashlib
import sys
from random import Random

import numpy as np
import pytest

from conformance.fuzzing import memory
from conformance.generator.builder import REFINE, SPLIT, Packet, Stream, Tile, X, build, places
from evogs_codec import Decoder, StreamError, decode
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.decoding.cut import Cut
from evogs_codec.editing.byte_stats import bytes_by_group, levels
from evogs_codec.editing.extract import extract
from evogs_codec.editing.omissions import omissions
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.components import component_slice
from tests.support.counting import Counted


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


@pytest.mark.thorough
def test_extracted_streams_keep_no_more_digests_than_they_may():
    data = digested(20, last=True)
    directory = read_directory(data)
    smaller = extract(data, Cut.of_level(directory, 0))
    found = read_directory(smaller)
    assert list(found.digests) == [(0, 0, 20)]
    assert decode(smaller, verify=True).dump() == decode(data, Cut.of_level(directory, 0)).dump()
    with pytest.raises(StreamError, match=r"E_AMPLIFICATION.*spec 5\.7") as caught:
        decode(digested(20, last=False))
    assert caught.value.section == "5.7"


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


@pytest.mark.parametrize(
    "late",
    [
        pytest.param(1, id="the first packet is missing"),
        pytest.param(0, id="all come", marks=pytest.mark.thorough),
    ],
)
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


@pytest.mark.parametrize("name", ["alpha_tables", "alpha_entries"])
def test_alpha_tables_are_looked_up_once_and_not_for_each_tile(name, monkeypatch):
    pytest.importorskip("evogs_codec.decoding.compiled.channels", reason="numba is an extra")
    n_calls, made = 0, vars(Directory)[name].func

    def counted(directory):
        nonlocal n_calls
        n_calls += 1
        return made(directory)

    monkeypatch.setattr(vars(Directory)[name], "func", counted)
    monkeypatch.setattr(dispatch, "MIN_COMPILED", 0)
    decode(many_tiles(20))
    assert n_calls == 1


@pytest.mark.thorough
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
    from evogs_codec.decoding.arrived import ArrivedRanges

    rng = Random(1)
    for _ in range(200):
        data = rng.randbytes(rng.randrange(1, 20_000))
        ranges, there = ArrivedRanges(), bytearray(len(data))
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
