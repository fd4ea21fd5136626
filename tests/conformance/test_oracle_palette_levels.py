"""The oracle on palettes with levels: cuts, what picks may name, what comes in pieces, faults."""

from dataclasses import replace

import pytest

from conformance.decoders import oracle
from conformance.generator.builder import Packet, X, build
from tests.conformance.test_oracle_palette import (
    ADDS,
    ENTRIES,
    GROW,
    MORE,
    MORE_PICKS,
    PICKS,
    fault,
    narrow,
    pieces,
    stream,
    wide,
)

# Entries of levels 0, 1, 1 and 3; picks of steps with labels 0, 1 and 2.
LEVELS = (
    *(ENTRIES, ADDS, replace(MORE, level=1), PICKS),
    *(Packet(component=5, level=1), replace(GROW, level=1), MORE_PICKS),
    *(Packet(level=2, adds={X: [5]}), Packet(component=4, picks=[4])),
    Packet(component=5, level=3, adds={0: [50]}),
)


@pytest.mark.parametrize(
    ("level", "cut"), [(0, [1, 1, 1]), (1, [2, 2, 3]), (2, [3, 3, 3]), (3, [3, 3, 4])]
)
def test_a_cut_by_level_takes_entries_of_at_most_the_level(level: int, cut: list[int]) -> None:
    data = build(stream(*LEVELS, n_levels=4))
    assert narrow(oracle.decode(data, level=level).tiles[0].cut) == cut


def test_a_cut_by_level_takes_entries_without_picks_of_them() -> None:
    data = build(stream(ENTRIES, replace(ADDS, level=1), n_levels=2))
    assert narrow(oracle.decode(data, level=0).tiles[0].cut) == [0, 0, 1]
    assert oracle.decode(build(stream(n_tiles=0)), level=0).dump()[12:] == bytes(4)


@pytest.mark.parametrize(
    ("steps", "least"),
    [([0, 0], 0), ([3, 0], 0), ([3, 1], 1), ([2, 2], 3), ([3, 2], 3), ([3, 3], 3)],
)
def test_a_cut_takes_the_packets_of_the_palette_that_its_picks_require(
    steps: list[int], least: int
) -> None:
    data = build(stream(*LEVELS, n_levels=4))
    for n in range(5):
        if n >= least:
            assert narrow(oracle.decode(data, cut=wide([[*steps, n]])).tiles[0].cut) == [*steps, n]
        else:
            with pytest.raises(ValueError, match="cut"):
                oracle.decode(data, cut=wide([[*steps, n]]))


def test_picks_are_of_entries_of_their_level_also_where_more_are_there() -> None:
    """The entry of level 1, the fourth, stands before the picks of level 0."""
    palette = (ENTRIES, replace(MORE, level=1))
    right = build(stream(*palette, ADDS, PICKS, replace(GROW, level=1), MORE_PICKS, n_levels=2))
    assert oracle.decode(right).tiles[0].x[14] == [60, 0, 0, 80, 40]
    data = build(stream(*palette, ADDS, replace(PICKS, picks=[3, 0, 4]), n_levels=2))
    picks = oracle.read_tables(data, {}).packets[-1]
    assert fault(data) == ("E_INDEX", "R-7.2-4", picks.start)
    none = [replace(ENTRIES, level=1), ADDS, replace(PICKS, picks=[0, 1, 0])]
    assert fault(build(stream(*none, n_levels=2)))[:2] == ("E_INDEX", "R-7.2-4")


def test_entries_of_a_level_that_no_step_has_come_before_picks_of_higher_ones() -> None:
    grow, late = replace(GROW, level=3), replace(MORE_PICKS, picks=[4, 4])
    more = replace(MORE, level=2)
    packets = (ENTRIES, ADDS, PICKS, grow, more, late)
    scene = oracle.decode(build(stream(*packets, n_levels=5)))
    assert scene.tiles[0].x[14] == [60, 0, 0, 80, 80]
    with pytest.raises(ValueError, match="cut"):
        oracle.decode(build(stream(*packets, n_levels=5)), cut=wide([[2, 2, 1]]))
    swapped = build(stream(ENTRIES, ADDS, PICKS, grow, late, more, n_levels=5))
    assert fault(swapped)[:2] == ("E_INDEX", "R-7.2-4")


def test_the_highest_label_of_picks_in_any_tile_says_what_a_cut_needs() -> None:
    packets = (
        *(ENTRIES, ADDS, PICKS, replace(ADDS, tile=1, level=1)),
        *(replace(MORE, level=1), replace(PICKS, tile=1, picks=[4, 0, 0])),
    )
    data = build(stream(*packets, n_tiles=2, n_levels=2))
    cuts = [[[1, 1, 1], [1, 0, 0]], [[1, 1, 2], [1, 1, 0]], [[0, 0, 2], [1, 1, 0]]]
    for cut in cuts:
        assert [narrow(tile.cut) for tile in oracle.decode(data, cut=wide(cut)).tiles] == cut
    for tiles in ([[1, 1, 1], [1, 1, 0]], [[0, 0, 1], [1, 1, 0]]):
        with pytest.raises(ValueError, match="cut"):
            oracle.decode(data, cut=tiles)


@pytest.mark.parametrize(
    ("missing", "cut"),
    [
        ((), [3, 3, 4]),
        ((0,), [3, 0, 0]),
        ((2,), [3, 1, 1]),  # the palette packet of no bytes, and picks of label 1, wait for it
        ((9,), [3, 3, 3]),
        ((3,), [3, 0, 4]),
        ((2, 5), [1, 1, 1]),
    ],
)
def test_picks_wait_for_entries_of_at_most_their_level(missing, cut) -> None:
    data = build(stream(*LEVELS, n_levels=4))
    assert narrow(oracle.decode_pieces(data, pieces(data, *missing)).tiles[0].cut) == cut


@pytest.mark.parametrize(
    ("code", "requirement", "packets"),
    [
        ("E_CHAIN", "R-5.6-3", [replace(ENTRIES, level=3)]),
        ("E_CHAIN", "R-5.6-3", [replace(ENTRIES, level=2), ADDS, replace(MORE, level=1)]),
        ("E_CHAIN", "R-5.6-3", [replace(ENTRIES, level=3, row={"n_drops": 1})]),  # and R-5.6-4
        ("E_CHAIN", "R-5.6-3", [replace(ENTRIES, level=1), Packet(component=5, tile=1)]),
        ("E_CHAIN", "R-5.6-10", [replace(ENTRIES, tile=1)]),
    ],
)
def test_a_wrong_level_or_place_is_a_fault_of_the_packet_table(code, requirement, packets) -> None:
    data = build(stream(*packets, n_tiles=2, n_levels=3))
    assert fault(data) == (code, requirement, data.index(b"PACK"))


def test_picks_require_the_entries_up_to_their_label_that_stand_before_them() -> None:
    """12.2: the third entry stands behind the first picks, of the same label."""
    first, grow = replace(ENTRIES, adds={0: [1, 2]}), replace(GROW, level=0)
    third = replace(ENTRIES, adds={0: [3]})
    early, late = replace(PICKS, picks=[2, 0, 1]), replace(MORE_PICKS, picks=[3, 1])
    packets = [first, ADDS, early, third, grow, late]
    data = build(stream(*packets))
    scene = oracle.decode(data)
    assert [p.n_before for p in scene.packets if p.component == 4] == [1, 2]
    assert narrow(oracle.decode_pieces(data, pieces(data, 3)).tiles[0].cut) == [2, 1, 1]
    assert narrow(oracle.decode(data, cut=wide([[2, 1, 1]])).tiles[0].cut) == [2, 1, 1]
    with pytest.raises(ValueError, match="cut"):
        oracle.decode(data, cut=wide([[2, 2, 1]]))
    wrong = build(stream(first, ADDS, replace(PICKS, picks=[3, 0, 1]), third))
    assert fault(wrong)[:2] == ("E_INDEX", "R-7.2-4")


@pytest.mark.parametrize("label", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_entries_may_follow_picks_of_any_label(label: int, level: int) -> None:
    packets = (replace(ADDS, level=label), Packet(component=4), replace(ENTRIES, level=level))
    assert oracle.decode(build(stream(*packets, n_levels=3))).palette[0] == [20, 40, 60]


def test_missing_bytes_of_entries_matter_only_from_their_level_on() -> None:
    data = build(stream(ADDS, replace(ENTRIES, level=1), n_levels=2))
    assert narrow(oracle.decode(data[:-1], level=0).tiles[0].cut) == [1, 0, 0]
    assert fault(data[:-1], level=1)[:2] == ("E_TRUNCATED", "R-6.2-2")
