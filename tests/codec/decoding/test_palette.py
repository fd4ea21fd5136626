"""Streams with a palette: integers, digests, floats and faults, against the oracle."""

import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from conformance.decoders import oracle
from conformance.generator.builder import SPLIT, X
from evogs_codec import Cut, Decoder, StreamError, decode, read_directory
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.decoding.decode import decode_leaves, decode_prefix
from evogs_codec.decoding.float_view import float_picks, float_rows
from evogs_codec.editing.read_tree import read_coded_tree
from evogs_codec.encoding.write import write
from evogs_codec.model.channels import GROUP_CHANNELS
from tests.support.palette_streams import (
    DATA,
    DEGREE,
    DIRECTORY,
    FIRST,
    N_ABOVE,
    PACKETS,
    PLACES,
    SECOND,
    changed,
    each_stream,
    entries,
    oracle_dump,
    picks,
    random_cut,
    stream,
)


@pytest.fixture(params=["numpy", "compiled"])
def way(request, monkeypatch):
    """Both ways to decode, however small the stream."""
    if request.param == "compiled":
        pytest.importorskip("numba")
        monkeypatch.setattr(dispatch, "MIN_COMPILED", 0)
    return request.param


# --- integers ------------------------------------------------------------------------------------


def test_integers_and_digests_are_those_of_the_oracle_at_every_level(way):
    for data in each_stream():
        directory = read_directory(data)
        assert decode(data, verify=True).dump() == oracle.decode(data).dump()
        for level in range(directory.n_levels):
            found = decode(data, Cut.of_level(directory, level))
            assert found.dump() == oracle.decode(data, level=level).dump()


def test_integers_are_those_of_the_oracle_at_any_cut(way):
    rng = np.random.default_rng(1)
    for data in each_stream():
        directory = read_directory(data)
        for _ in range(6):
            cut = random_cut(rng, directory)
            assert decode(data, cut).dump() == oracle_dump(data, cut)


@pytest.mark.thorough
def test_every_prefix_of_the_packets_is_a_cut_and_what_a_truncated_file_gives():
    for n in range(len(PACKETS) + 1):
        cut = Cut.of_rows(DIRECTORY, np.arange(n))
        end = int(DIRECTORY.offsets[n]) if n < len(PACKETS) else len(DATA)
        expected = oracle_dump(DATA, cut)
        assert decode(DATA, cut).dump() == expected
        assert decode(DATA[:end], cut).dump() == expected
        # Behind it may be packets of no bytes, which need none.
        there = Cut.of_complete(DIRECTORY, DIRECTORY.offsets + DIRECTORY.packets["size"] <= end)
        assert there.contains(cut)
        assert decode_prefix(DATA[:end]).dump() == oracle_dump(DATA, there)


@pytest.mark.parametrize("place", sorted(PLACES))
def test_a_wrong_digest_of_any_component_is_found_and_only_if_asked(place, way):
    data = stream(digests=dict.fromkeys(sorted(PLACES)) | {place: bytes(32)})
    with pytest.raises(StreamError, match="E_DIGEST") as caught:
        decode(data, verify=True)
    assert caught.value.offset == DIRECTORY.digests_offset
    assert decode(data).dump() == oracle.decode(data).dump()


def test_the_state_of_a_tile_has_a_pick_for_each_slot_and_no_sh_above_band_0():
    state = decode(DATA).tiles[2]
    assert len(state.x) == 14
    # The second step has new picks of 0, 1 and 3. Slots 2, then 1 and 5, were dropped.
    assert state.picks[: state.n_slots].tolist() == [4, 0, 0, 2, 5, 0, 0, 3, 7]
    assert state.palette is not None
    assert state.palette.x.shape == (N_ABOVE, 1 + DIRECTORY.n_entries)


def test_slots_of_steps_whose_picks_are_late_show_those_of_their_ancestors():
    cut = Cut(np.array([[3, 0], [3, 0], [3, 1]]), 2)
    state = decode(DATA, cut).tiles[2]
    # 4 was split from 0 and 7 from 4; 5 from 3, but dropped; 6 and 8 are adds.
    picks_shown = np.where(state.live[:9], state.shown_picks(), -1).tolist()
    assert picks_shown == [3, -1, -1, 1, 3, -1, 0, 3, 0]


@pytest.mark.parametrize("is_explicit", [False, True])
def test_second_children_have_the_picks_of_their_parents_unless_zeros_are_stored(way, is_explicit):
    packets = (entries(5, 100), FIRST[0], picks(0, 1, 2, 3, 4), SECOND[0])
    data = stream((*packets, replace(picks(0), is_explicit=is_explicit)))
    splits = [slot for slot, kind in SECOND[0].records.items() if kind == SPLIT]
    state = decode(data, verify=True).tiles[0]
    n = len(FIRST[0].adds[X])
    expected = [0] * len(splits) if is_explicit else state.picks[splits].tolist()
    assert any(state.picks[splits])
    assert state.picks[n : n + len(splits)].tolist() == expected
    assert not state.picks[n + len(splits) : state.n_slots].any()
    assert decode(data).dump() == oracle.decode(data).dump()
    step = read_coded_tree(data).tiles[0].steps[1]
    assert len(step.picks) == (step.n_new if is_explicit else 0)
    assert decode(write(read_coded_tree(data))).dump() == decode(data).dump()


def test_records_of_a_stream_written_again_decode_to_the_same_integers():
    packets = (entries(1, 100), entries(1, 101), FIRST[0], picks(0, 1, 2, 0, 2), SECOND[0])
    later = (entries(3, 102, level=1), changed(0, 1, 0, 3, 5, 4, 2), FIRST[2])
    data = stream((*packets, *later, picks(2, 1, 1, 1, 2)))
    tree = read_coded_tree(data)
    assert tree.entries is not None
    assert tree.entries.shape == (N_ABOVE, 5)
    assert tree.entry_levels.tolist() == [0, 0, 1, 1, 1]
    step = tree.tiles[0].steps[1]
    assert (step.changed_picks.tolist(), step.picks.tolist()) == ([1, 0, 3], [5, 4, 2])
    again = write(tree)
    assert decode(again, verify=True).dump() == decode(data).dump()
    directory = read_directory(again)
    levels_and_entries = directory.packets[directory.palette_packets][["level", "n_adds"]].tolist()
    assert levels_and_entries == [(0, 2), (1, 3)]
    with pytest.raises(ValueError, match="fewer steps than core"):
        read_coded_tree(DATA)


def test_records_keep_entries_that_no_pick_requires():
    data = stream((entries(2, 1), FIRST[0], picks(0, 1, 2, 0, 2), entries(3, 2, level=2)))
    tree, again = read_coded_tree(data), read_coded_tree(write(read_coded_tree(data)))
    assert tree.entries is not None
    assert again.entries is not None
    assert again.entries.tolist() == tree.entries.tolist()
    assert again.entry_levels.tolist() == tree.entry_levels.tolist() == [0, 0, 2, 2, 2]


# --- floats --------------------------------------------------------------------------------------


def floats_of(decoded, degree):
    """(D, N) what spec 7.6 says of the integers of a dump."""
    directory, parts = decoded.directory, []
    for row, tile in zip(directory.tiles, decoded.tiles, strict=True):
        x = tile.channels()[:, tile.live[: tile.n_slots]].astype(np.float64)
        x[:3] += row["origin"][:, None]
        for exponent, group in zip(directory.grid_exponents, GROUP_CHANNELS, strict=True):
            x[group] *= 2.0**-exponent
        parts.append(x[: 11 + 3 * (degree + 1) ** 2])
    return np.concatenate(parts, axis=1).astype(np.float32)


def test_floats_are_the_integers_at_every_degree(way):
    for data in each_stream():
        directory = read_directory(data)
        if not len(directory.tiles):
            continue
        for cut in (
            Cut.full(directory),
            Cut.of_rows(directory, np.arange(len(directory.packets) // 2)),
        ):
            decoded = decode(data, cut)
            for degree in range(directory.sh_degree + 1):
                expected = floats_of(decoded, degree)
                assert np.array_equal(decoded.leaves(sh_degree=degree).channels(), expected)
                found = decode_leaves(data, cut, sh_degree=degree)
                assert np.array_equal(found.channels(), expected)


def test_the_degree_of_floats_is_that_of_the_stream_where_picks_are_applied():
    assert decode(DATA).leaves().sh_degree == decode_leaves(DATA).sh_degree == DEGREE
    plain = Cut.full(DIRECTORY).with_sh_degree(0)
    assert decode(DATA, plain).leaves().sh_degree == decode_leaves(DATA, plain).sh_degree == 0
    higher = decode(DATA).leaves(sh_degree=3)
    assert not higher.sh[:, 9:].any()
    assert np.array_equal(higher.sh[:, :9], decode(DATA).leaves().sh)


@pytest.mark.parametrize(("dtype", "largest"), [(np.int16, 1 << 15), (np.int32, 1 << 28)])
@pytest.mark.parametrize("n_rest", [9, 24, 45])
def test_rows_of_picks_are_written_alike_by_numpy_and_compiled_code(n_rest, dtype, largest):
    kernels = pytest.importorskip("evogs_codec.decoding.compiled.channels")
    rng = np.random.default_rng(n_rest)
    n = 5000
    x = rng.integers(-5000, 5000, (3, n)).astype(np.int32)
    rows = rng.integers(-largest, largest, (70, n_rest + 7)).astype(dtype)
    chosen = rng.integers(0, 70, n).astype(np.int32)
    outs = [np.empty((n, 3 + n_rest), np.float32) for _ in range(2)]
    float_picks(x, 1 / 128, chosen, rows, outs[0])
    kernels.float_picks(x, 1 / 128, chosen, rows, outs[1])
    shown = rows[chosen, :n_rest] / np.float64(128)
    expected = np.concatenate([(x / 128).T, shown], axis=1).astype(np.float32)
    assert all(np.array_equal(out, expected) for out in outs)
    again = np.empty((n, 3), np.float32)
    float_rows(x, np.zeros(3, np.int64), 1 / 128, again)
    assert np.array_equal(again, expected[:, :3])


# --- faults --------------------------------------------------------------------------------------


def damaged(*packets):
    """The stream with these packets (number, change) spoiled."""
    changed = list(PACKETS)
    for number, change in packets:
        changed[number] = replace(changed[number], **change)
    return stream(changed)


OUT_OF_BOX = {"adds": {X: [2000] * 4}}
BAD_ENTRIES = {"adds": {0: [1 << 22] * 4}, "codings": {"adds 1": 0x68}}
TOO_FAR = {"picks": (5, 0, 2, 1)}  # entry 5 is of level 1
RESERVED = {"edit": lambda body: bytes([body[0] | 8]) + body[1:]}
FAULTS = [
    ("E_RANGE", 1, [(1, OUT_OF_BOX), (2, RESERVED)]),
    ("E_RESERVED", 2, [(2, RESERVED), (3, OUT_OF_BOX)]),
    ("E_RESERVED", 4, [(4, RESERVED), (5, TOO_FAR)]),
    ("E_INDEX", 5, [(5, TOO_FAR), (7, {"psi": {X: [5000] * 3}})]),
    ("E_RANGE", 3, [(3, OUT_OF_BOX), (4, RESERVED), (5, RESERVED)]),
    ("E_RESERVED", 6, [(6, RESERVED)]),
    ("E_RESERVED", 4, [(4, {"flags": 4})]),
    ("E_RESERVED", 7, [(7, {"flags": 4})]),
    ("E_INDEX", 10, [(10, {"picks": (4, 7, 2, 5, 6, 0)}), (11, OUT_OF_BOX)]),
    ("E_INDEX", 10, [(10, {"picks": (4, 0, 2, 5, 6, 7)})]),
    ("E_RESERVED", 9, [(9, RESERVED), (10, {"picks": (7, 0, 2, 5, 6, 0)}), (18, TOO_FAR)]),
    ("E_RESERVED", 16, [(16, RESERVED), (17, {"picks": (8, 0)}), (18, TOO_FAR)]),
    ("E_INDEX", 17, [(17, {"picks": (0, 8)}), (18, TOO_FAR)]),
    ("E_INDEX", 18, [(18, TOO_FAR), (20, RESERVED)]),
]


@pytest.mark.parametrize(("code", "at", "packets"), FAULTS)
def test_the_first_fault_of_the_file_is_reported_wherever_it_is(code, at, packets, way):
    data = damaged(*packets)
    offset = int(read_directory(data).offsets[at])
    for read in (decode, partial(decode, verify=True), decode_leaves):
        with pytest.raises(StreamError) as caught:
            read(data)
        assert (caught.value.fault.name, caught.value.offset) == (code, offset)
    decoder = Decoder()
    with pytest.raises(StreamError) as caught:
        decoder.feed(data)
    assert (caught.value.fault.name, caught.value.offset) == (code, offset)
    with pytest.raises(oracle.FaultError) as refused:
        oracle.decode(data)
    assert (refused.value.code, refused.value.offset) == (code, offset)


@pytest.mark.parametrize(("q", "is_legal"), [(1 << 20, True), ((1 << 20) + 1, False)])
def test_an_entry_out_of_range_is_a_fault_of_its_packet(q, is_legal, way):
    changed = [*PACKETS[:2], replace(PACKETS[2], adds={0: [q, 0, -q]}), *PACKETS[3:]]
    data = stream(changed, quantisers={(0, 5): (16, 4)})
    if is_legal:
        assert decode(data).dump() == oracle.decode(data).dump()
        return
    with pytest.raises(StreamError, match="E_RANGE") as caught:
        decode(data)
    assert caught.value.offset == read_directory(data).offsets[2]


def test_packets_outside_the_cut_are_not_examined():
    data = damaged((2, RESERVED), (4, RESERVED))
    cut = Cut.full(read_directory(data)).with_sh_degree(0)
    assert decode(data, cut).dump() == decode(DATA, cut).dump()
    with pytest.raises(StreamError, match="E_RESERVED"):
        decode(data, Cut(cut.steps, 1))


def test_a_level_does_not_meet_the_faults_of_entries_of_higher_ones(way):
    data = damaged((9, RESERVED), (16, RESERVED))
    directory = read_directory(data)
    assert decode(data, Cut.of_level(directory, 0)).dump() == oracle.decode(DATA, level=0).dump()
    for level in (1, 2):
        with pytest.raises(StreamError, match="E_RESERVED") as caught:
            decode(data, Cut.of_level(directory, level))
        assert caught.value.offset == directory.offsets[9]


HIGH, LOW = entries(1, 1, level=1), entries(1, 2)
TABLES = [
    (None, [HIGH, replace(HIGH), FIRST[0], picks(0)]),
    (None, [LOW, FIRST[0], picks(0), HIGH, FIRST[1], picks(1), SECOND[1], picks(1)]),
    (None, [FIRST[0], FIRST[1], SECOND[1], picks(1), HIGH, picks(1)]),
    (None, [FIRST[0], picks(0), LOW]),  # 12.2: picks require what stands before them
    (None, [LOW, FIRST[2], FIRST[1], SECOND[1], picks(1), picks(2), picks(1), HIGH]),
    (None, [LOW, FIRST[2], SECOND[2], picks(2), picks(2), FIRST[1], picks(1), HIGH]),
    ("E_CHAIN", [HIGH, LOW]),  # R-5.6-3
    ("E_CHAIN", [replace(HIGH, level=3)]),
    ("E_CHAIN", [HIGH, replace(LOW, row={"n_drops": 1})]),
    ("E_COUNT", [LOW, replace(HIGH, row={"n_drops": 1})]),  # R-5.6-4
    ("E_COUNT", [HIGH, FIRST[0], replace(picks(0, 1), level=1)]),
    ("E_CHAIN", [replace(LOW, tile=1)]),  # R-5.6-10
    ("E_CHAIN", [picks(0), LOW]),
]


@pytest.mark.parametrize(("code", "packets"), TABLES)
def test_packet_tables_are_refused_or_taken_as_by_the_oracle(code, packets):
    data = stream(packets)
    if code is None:
        assert decode(data).dump() == oracle.decode(data).dump()
        return
    with pytest.raises(oracle.FaultError) as refused:
        oracle.decode(data)
    with pytest.raises(StreamError) as caught:
        decode(data)
    assert (caught.value.fault.name, caught.value.offset) == (code, refused.value.offset)
    assert refused.value.code == code


@pytest.mark.parametrize(("name", "least"), [("tile_slots", 30), ("slots", 34), ("tile_steps", 2)])
def test_the_palette_is_bounded_like_the_slots_of_a_tile(name, least):
    data = stream([FIRST[0], entries(29, 1), entries(1, 2)])
    assert decode(data, limits={name: least}).n_leaves == 4
    with pytest.raises(StreamError, match="E_LIMIT"):
        decode(data, limits={name: least - 1})


def test_a_truncated_file_does_not_take_memory_for_entries_that_never_come():
    n, size = 1 << 20, 1 << 17
    large = replace(PACKETS[2], row={"n_adds": n, "size": size})
    data_size = DIRECTORY.size - DIRECTORY.data_offset + size - int(DIRECTORY.packets["size"][2])
    data = stream([*PACKETS[:2], large, *PACKETS[3:]], tier=3, header={"data_size": data_size})
    directory = read_directory(data)
    assert directory.n_entries == n + 4
    head = data[: directory.data_offset + 500]
    for read in (decode, decode_leaves):
        tracemalloc.start()
        with pytest.raises(StreamError, match="E_TRUNCATED"):
            read(head)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < n  # the entries would take 96 times as much
