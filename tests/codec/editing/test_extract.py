"""Extraction: smaller streams by moving packets (spec 10)."""

import struct
from typing import Any

import numpy as np
import pytest

from evogs_codec import Cut, Fault, StreamError, choose_cut, decode, extract, read_directory
from evogs_codec.decoding import tile_state as state_module
from evogs_codec.format import unpack as packets_module
from tests.support import damage

DATA = damage.stream(n_roots=20, n_levels=3, degree=2, n_tiles=4)
DIRECTORY = read_directory(DATA)
TIGHT_BOX = (-0.2, -0.2, -0.2, 0.2, 0.2, 0.2)


def random_cut(rng):
    """Any valid cut: core steps per tile, bands with at most as many."""
    most = DIRECTORY.chain_lengths
    steps = rng.integers(0, most + 1)
    return Cut(np.minimum(steps, steps[:, :1]))


def random_choice(rng):
    """(cut, box) as the options of the command line make them."""
    options = {
        "level": int(rng.integers(0, DIRECTORY.n_levels)),
        "sh_degree": int(rng.integers(0, DIRECTORY.sh_degree + 1)),
        "box": tuple(rng.uniform(-3, 3, 6).tolist()),
        "max_bytes": int(rng.integers(len(DATA) // 3, len(DATA))),
    }
    chosen: dict[str, Any] = {k: value for k, value in options.items() if rng.random() < 0.5}
    try:
        return choose_cut(DIRECTORY, **chosen), chosen.get("box")
    except ValueError:  # a budget below the first packet of the other options
        chosen.pop("max_bytes")
        return choose_cut(DIRECTORY, **chosen), chosen.get("box")


def tile_dumps(decoded, kept):
    return [tile.dump() for tile, keep in zip(decoded.tiles, kept, strict=True) if keep]


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(1, 10))]
)
def test_decoding_an_extracted_stream_is_decoding_the_original_at_the_same_cut(seed):
    rng = np.random.default_rng(seed)
    for k in range(20):
        cut, box = (random_cut(rng), None) if k % 2 else random_choice(rng)
        smaller = extract(DATA, cut, box=box)
        found, expected = decode(smaller, verify=True), decode(DATA, cut)
        if box is None:
            assert found.dump() == expected.dump()
        else:
            kept = choose_cut(DIRECTORY, box=box).steps[:, 0] > 0
            assert [tile.dump() for tile in found.tiles] == tile_dumps(expected, kept)
        leaves = (decoded.leaves(sh_degree=2).channels().tobytes() for decoded in (found, expected))
        assert next(leaves) == next(leaves)


def test_extracting_everything_changes_no_byte():
    assert extract(DATA, Cut.full(DIRECTORY)) == DATA


def test_extracting_twice_is_extracting_once():
    rng = np.random.default_rng(20)
    for _ in range(20):
        large, small = random_cut(rng), random_cut(rng)
        small = Cut(np.minimum(large.steps, small.steps))
        assert extract(extract(DATA, large), small) == extract(DATA, small)


def test_digests_of_reached_states_are_kept_and_the_others_dropped():
    rng = np.random.default_rng(21)
    for _ in range(20):
        cut = random_cut(rng)
        found = read_directory(extract(DATA, cut)).digests
        assert found == {
            key: digest for key, digest in DIRECTORY.digests.items() if key[2] < cut.steps[key[:2]]
        }
        assert DIRECTORY.digests


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.thorough),
        {"level": 1},
        pytest.param({"box": TIGHT_BOX}, marks=pytest.mark.thorough),
        pytest.param({"sh_degree": 0}, marks=pytest.mark.thorough),
    ],
)
def test_a_byte_budget_gives_the_longest_prefix_that_fits(options):
    box = options.get("box")
    order = np.flatnonzero(choose_cut(DIRECTORY, **options).packets(DIRECTORY))
    sizes = []
    for n in range(1, len(order) + 1):
        selected = np.zeros_like(DIRECTORY.chain_lengths)
        for packet in order[:n]:
            row = DIRECTORY.packets[packet]
            selected[row["tile"], row["component"]] += 1
        sizes.append(len(extract(DATA, Cut(selected), box=box)))
    for n, size in enumerate(sizes, 1):
        for budget in (size, size + 1, sizes[n] - 1 if n < len(sizes) else 1 << 40):
            cut = choose_cut(DIRECTORY, max_bytes=budget, **options)
            assert int(cut.steps.sum()) == n
            assert len(extract(DATA, cut, box=box)) == size <= budget
    for budget in (0, sizes[0] - 1):
        with pytest.raises(ValueError, match=f"^{budget} bytes are too few.* {sizes[0]}$"):
            choose_cut(DIRECTORY, max_bytes=budget, **options)


def with_chunks(chunks):
    return damage.rebuilt(DATA, chunks=chunks)


def bodies(data, kind):
    return [data[at + 12 : at + 12 + size] for at, k, size in damage.chunks_of(data) if k == kind]


def test_unknown_chunks_that_are_safe_to_copy_are_kept_and_the_others_dropped():
    data = with_chunks({b"abCd": b"kept", b"abCD": b"dropped", b"xyZz": b""})
    data = damage.rebuilt(data, chunks={b"abCe": b"kept too"})
    smaller = extract(data, Cut.of_level(DIRECTORY, 1))
    assert bodies(smaller, b"abCd") == [b"kept"]
    assert bodies(smaller, b"abCe") == [b"kept too"]
    assert bodies(smaller, b"xyZz") == [b""]
    assert bodies(smaller, b"abCD") == []
    assert decode(smaller).dump() == decode(DATA, Cut.of_level(DIRECTORY, 1)).dump()


@pytest.mark.parametrize(
    "chunks",
    [
        {b"abCd": b"kept", b"abCD": b"dropped"},
        {b"dGST": None},
        {b"dGST": b""},
        {b"mETa": b""},
        {b"ALFA": b""},
    ],
)
def test_byte_budgets_are_exact_whatever_chunks_there_are(chunks):
    data = with_chunks(chunks)
    directory = read_directory(data)
    for n in (1, 7, len(directory.packets)):
        size = len(extract(data, Cut.of_rows(directory, np.arange(n))))
        assert int(choose_cut(directory, max_bytes=size).steps.sum()) == n
        if n > 1:
            assert int(choose_cut(directory, max_bytes=size - 1).steps.sum()) == n - 1


def test_all_of_the_header_and_the_tables_that_the_text_names_is_kept():
    fields = {9: ("<B", 3), 18: ("<H", 0xFF), 20: ("<B", 200), 21: ("<B", 6), 22: ("<B", 9)}
    data = damage.rebuilt(DATA, header=fields | {23: ("<B", 2)})
    smaller = extract(data, Cut.of_level(DIRECTORY, 0))
    assert smaller[8:24] == data[8:24]
    for kind in (b"QUAN", b"ALFA", b"TILE", b"mETa"):
        assert bodies(smaller, kind) == bodies(data, kind) != []
    old, new = DIRECTORY, read_directory(smaller)
    kept = np.flatnonzero(Cut.of_level(old, 0).packets(old))
    assert (new.packets == old.packets[kept]).all()


def test_the_tier_is_the_lowest_that_the_extracted_stream_keeps():
    data = damage.rebuilt(DATA, header={10: ("<B", 3)})
    assert extract(data, Cut.of_level(DIRECTORY, 0))[10] == 1


def test_a_box_leaves_whole_tiles_out_and_moves_the_others_up():
    for tile in range(len(DIRECTORY.tiles)):
        row = DIRECTORY.tiles[tile]
        scale = 2.0 ** -DIRECTORY.grid_exponents[0]
        middle = (row["origin"] + (row["box_min"].astype(np.int64) + row["box_max"]) // 2) * scale
        box = (*middle, *middle)
        cut = choose_cut(DIRECTORY, box=box)
        kept = np.flatnonzero(cut.steps[:, 0])
        assert tile in kept
        smaller = read_directory(extract(DATA, cut, box=box))
        assert (smaller.tiles == DIRECTORY.tiles[kept]).all()
        numbers = smaller.packets["tile"]
        assert set(numbers.tolist()) == set(range(len(kept)))
        assert {kept[key[0]] for key in smaller.digests} == set(kept.tolist())


def test_a_box_that_meets_nothing_leaves_a_valid_stream_without_tiles():
    box = (1e6, 1e6, 1e6, 2e6, 2e6, 2e6)
    smaller = extract(DATA, choose_cut(DIRECTORY, box=box), box=box)
    decoded = decode(smaller, verify=True)
    assert (len(decoded.tiles), decoded.n_leaves, len(decoded.leaves())) == (0, 0, 0)


def test_a_tile_without_packets_stays_unless_a_box_leaves_it_out():
    steps = DIRECTORY.chain_lengths.copy()
    steps[1:3] = 0
    smaller = read_directory(extract(DATA, Cut(steps)))
    assert (smaller.tiles == DIRECTORY.tiles).all()
    assert (smaller.chain_lengths == steps).all()


def test_a_cut_of_tiles_outside_the_box_is_a_mistake_of_the_caller():
    with pytest.raises(ValueError, match="outside the box"):
        extract(DATA, Cut.full(DIRECTORY), box=(1e6, 1e6, 1e6, 2e6, 2e6, 2e6))


def test_extraction_never_looks_into_packets(monkeypatch):
    def never(*_):
        raise AssertionError("a packet was unpacked")

    noise = np.random.default_rng(22).bytes(len(DATA) - DIRECTORY.data_offset)
    data = damage.repaired(DATA[: DIRECTORY.data_offset] + noise)
    monkeypatch.setattr(packets_module, "unpack", never)
    monkeypatch.setattr(state_module, "unpack", never)
    directory = read_directory(data)
    smaller = extract(data, Cut.of_level(directory, 1))
    assert read_directory(smaller).n_levels == DIRECTORY.n_levels


def test_only_the_packets_of_the_cut_must_be_there():
    cut = Cut.of_rows(DIRECTORY, np.arange(9))
    end = int(DIRECTORY.offsets[9])
    assert extract(DATA[:end], cut) == extract(DATA, cut)
    with pytest.raises(StreamError) as caught:
        extract(DATA[: end - 1], cut)
    assert caught.value.fault is Fault.E_TRUNCATED
    assert caught.value.offset == DIRECTORY.offsets[8]


def test_a_damaged_packet_stays_damaged():
    at = int(DIRECTORY.offsets[2]) + 5
    smaller = extract(damage.flipped(DATA, 8 * at), Cut.of_rows(DIRECTORY, np.arange(4)))
    with pytest.raises(StreamError, match="E_CRC"):
        decode(smaller)


@pytest.mark.parametrize(
    "options", [{"level": -1}, {"level": 3}, {"sh_degree": 3}, {"sh_degree": -1}]
)
def test_a_cut_that_the_stream_does_not_have_is_refused(options):
    with pytest.raises(ValueError, match="is not one of 0"):
        choose_cut(DIRECTORY, **options)


def test_reversed_corners_of_a_box_are_put_right():
    box = (0.4, -0.1, 0.3, -0.2, 0.5, -0.3)
    low, high = np.sort(np.reshape(box, (2, 3)), axis=0)
    expected = choose_cut(DIRECTORY, box=(*low, *high))
    assert (choose_cut(DIRECTORY, box=box).steps == expected.steps).all()


def test_the_packet_rows_keep_their_order_and_their_estimates():
    cut = Cut.of_level(DIRECTORY, 1).with_sh_degree(1)
    smaller = extract(DATA, cut)
    (table,) = bodies(smaller, b"PACK")
    (whole,) = bodies(DATA, b"PACK")
    rows = [whole[at : at + 36] for at in range(0, len(whole), 36)]
    kept = [row for row, keep in zip(rows, cut.packets(DIRECTORY), strict=True) if keep]
    assert table == b"".join(kept)
    assert struct.unpack_from("<I", smaller, 28) == (len(kept),)
