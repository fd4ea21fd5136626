"""The oracle on streams with a palette: numbers, states, cuts and faults worked out by hand."""

import hashlib
import struct
from dataclasses import replace
from typing import Any

import pytest

from conformance.decoders import oracle
from conformance.generator.builder import DELTA, DROP, REFINE, SPLIT, Packet, Stream, Tile, X, build

ENTRIES = Packet(component=5, adds={0: [10, 20, 30], 4: [-1, -2, -3]})
MORE = Packet(component=5, adds={0: [40]})
ADDS = Packet(adds={X: [1, 2, 3]})
PICKS = Packet(component=4, picks=[3, 0, 1])
GROW = Packet(records={0: SPLIT, 1: REFINE, 2: DROP}, psi={X: [1, 1]}, adds={X: [4]})
MORE_PICKS = Packet(component=4, picks=[4, 2])
NEW_PICKS = replace(MORE_PICKS, repicks=[2, 1])
PACKETS = (ENTRIES, ADDS, MORE, PICKS, GROW, MORE_PICKS)


def wide(cut: list[list[int]]) -> list[list[int]]:
    """Steps of core, picks and the palette of each tile, by component as the oracle has them."""
    return [[*steps[:1], 0, 0, 0, *steps[1:]] for steps in cut]


def narrow(steps: list[int]) -> list[int]:
    """Those of a tile back again."""
    return [steps[component] for component in (0, 4, 5)]


def stream(*packets: Packet, n_tiles: int = 1, **changes: Any) -> Stream:
    """SH of degree 1; one q of an entry is 2 units."""
    tiles = (Tile(),) * n_tiles
    plain = Stream(packets, degree=1, has_palette=True, tiles=tiles, quantisers={(0, 5): (1, 1)})
    return replace(plain, **changes)


def start_of(data: bytes) -> int:
    return 64 + int(struct.unpack_from("<I", data, 32)[0])


def fault(data: bytes, **options) -> tuple[str, str, int]:
    with pytest.raises(oracle.FaultError) as caught:
        oracle.decode(data, **options)
    return caught.value.code, caught.value.detail, caught.value.offset


def test_new_slots_have_their_picks_and_keep_them() -> None:
    scene = oracle.decode(build(stream(*PACKETS)))
    assert scene.palette[0] == [20, 40, 60, 80]
    assert scene.palette[4] == [-2, -4, -6, 0]
    (tile,) = scene.tiles
    # Entries 3, none, 1, which was dropped; the second child has 4 and the add 2.
    assert tile.channels[14] == [60, 0, 0, 80, 40]
    assert tile.channels[18] == [-6, 0, 0, 0, -4]
    assert narrow(tile.cut) == [2, 2, 2]


@pytest.mark.parametrize("flags", [0, 3])
def test_refined_and_split_slots_may_have_new_picks(flags: int) -> None:
    (tile,) = oracle.decode(build(stream(*PACKETS[:5], replace(NEW_PICKS, flags=flags)))).tiles
    # The first child of slot 0 has entry 2 now, and slot 1, refined, entry 1; slot 2 was dropped.
    assert tile.x[14] == tile.channels[14] == [40, 20, 0, 80, 40]
    assert tile.x[18] == tile.channels[18] == [-4, -2, 0, 0, -4]


def test_new_picks_of_0_say_0_and_are_not_the_old_ones() -> None:
    (tile,) = oracle.decode(build(stream(*PACKETS[:5], Packet(component=4, repicks=())))).tiles
    assert tile.x[14] == [0] * 5


def test_new_picks_are_in_order_of_slot_whatever_the_kind() -> None:
    grow = Packet(records={0: REFINE, 1: DROP, 2: SPLIT}, psi={X: [1, 1]}, adds={X: [4]})
    late = replace(NEW_PICKS, picks=[3, 0])
    (tile,) = oracle.decode(build(stream(*PACKETS[:4], grow, late))).tiles
    assert tile.x[14] == [40, 0, 20, 60, 0]


def test_a_step_that_only_refines_has_picks_of_its_slots_alone() -> None:
    refine = Packet(records={1: REFINE, 2: REFINE}, psi={X: [1, 1]})
    packets = (*PACKETS[:4], refine, Packet(component=4, repicks=[4, 0]))
    assert oracle.decode(build(stream(*packets))).tiles[0].x[14] == [60, 80, 0]
    kept = oracle.decode(build(stream(*packets[:5], Packet(component=4, is_explicit=True))))
    assert kept.tiles[0].x[14] == [60, 0, 20]


def test_new_picks_that_come_late_are_those_of_their_step() -> None:
    drop = Packet(records={1: DROP, 3: SPLIT}, psi={X: [1]})
    packets = (*PACKETS[:5], drop, NEW_PICKS)
    (tile,) = oracle.decode(build(stream(*packets))).tiles
    # Slot 1 has been dropped since; slot 5 was split from slot 3, with entry 4.
    assert tile.x[14] == [40, 20, 0, 80, 40]
    assert tile.channels[14] == [40, 0, 0, 80, 40, 80]
    before = oracle.decode(build(stream(*packets)), cut=wide([[3, 1, 2]])).tiles[0]
    assert before.channels[14] == [60, 0, 0, 60, 0, 60]


def test_the_state_of_picks_has_the_new_picks_of_changed_slots() -> None:
    seen: dict[tuple[int, int, int], bytes] = {}
    data = build(stream(*PACKETS[:5], NEW_PICKS))
    oracle.decode(data, trace=lambda t, s, c, state: seen.update({(t, c, s): state}))
    assert seen[0, 4, 0][:16] == struct.pack("<I3i", 3, 60, 0, 20)
    assert seen[0, 4, 1][:24] == struct.pack("<I5i", 5, 40, 20, 0, 80, 40)


def test_alpha_and_psi_of_steps_leave_what_is_above_band_0() -> None:
    alphas = {(0, 4): (0, [5])}
    colours = replace(GROW, psi={X: [1, 1], 11: [7, 8]})
    tile = oracle.decode(build(stream(*PACKETS[:4], colours, MORE_PICKS, alphas=alphas))).tiles[0]
    assert tile.channels[11] == [7, 8, 0, -35, 0]
    assert tile.channels[14] == [60, 0, 0, 80, 40]


def test_a_step_whose_picks_are_late_shows_those_of_the_ancestor() -> None:
    data = build(stream(*PACKETS))
    late = oracle.decode(data, cut=wide([[2, 1, 2]])).tiles[0]
    assert late.x[14] == [60, 0, 20]
    assert late.channels[14] == [60, 0, 0, 60, 0]
    none = oracle.decode(data, cut=wide([[2, 0, 0]])).tiles[0]
    assert none.channels[14] == [0] * 5


def test_a_packet_of_picks_of_no_bytes_says_those_of_parents_and_drops_all_the_same() -> None:
    tile = oracle.decode(build(stream(*PACKETS[:5], Packet(component=4)))).tiles[0]
    # Slot 0 has entry 3 and keeps it, slot 2 was dropped; 3 was split from 0, and 4 is an add.
    assert tile.x[14] == [60, 0, 0, 60, 0]
    zeros = Packet(component=4, is_explicit=True)
    (tile,) = oracle.decode(build(stream(*PACKETS[:5], zeros))).tiles
    assert tile.x[14] == [60, 0, 0, 0, 0]


def test_a_palette_without_packets_allows_the_pick_0_only() -> None:
    zeros = replace(PICKS, picks=[0, 0, 0], is_explicit=True)
    assert oracle.decode(build(stream(ADDS, zeros))).tiles[0].channels[14] == [0, 0, 0]
    data = build(stream(ADDS, replace(PICKS, picks=[0, 1, 0])))
    (_, picks) = oracle.read_tables(data, {}).packets
    assert fault(data) == ("E_INDEX", "R-7.2-4", picks.start)


def test_all_tiles_share_the_palette() -> None:
    packets = (ENTRIES, replace(ADDS, tile=1), ADDS, replace(PICKS, tile=1), PICKS)
    one, other = oracle.decode(build(stream(*packets, n_tiles=2))).tiles
    assert one.channels[14] == other.channels[14] == [60, 0, 20]
    assert (narrow(one.cut), narrow(other.cut)) == ([1, 1, 1], [1, 1, 0])


def test_differences_of_entries_are_summed_in_a_packet_then_colours_are_undone() -> None:
    coded = Packet(
        component=5,
        adds={0: [1, 2], 1: [2, 4], 2: [0, 0]},
        flags=2,
        codings={"adds 0": DELTA | 4, "adds 1": DELTA | 4},
    )
    scene = oracle.decode(build(stream(coded, coded)))
    # Y 1 and 2, Co 2 and 4: b = 0, r = 2 and 4, g = 1 and 2; times 2; the second packet again.
    assert [scene.palette[c] for c in (0, 1, 2)] == [[4, 8] * 2, [2, 4] * 2, [0, 0] * 2]


def test_states_are_those_of_all_channels_above_band_0_and_of_the_entries() -> None:
    seen: dict[tuple[int, int, int], bytes] = {}
    data = build(stream(*PACKETS))
    oracle.decode(data, trace=lambda t, s, c, state: seen.update({(t, c, s): state}))
    zeros = bytes(4 * 3 * 3)
    entries = struct.pack("<I3i", 3, 20, 40, 60) + zeros + struct.pack("<3i", -2, -4, -6)
    assert seen[0, 5, 0] == entries + bytes(4 * 3 * 4)
    assert seen[0, 4, 0][:16] == struct.pack("<I3i", 3, 60, 0, 20)
    assert len(seen[0, 4, 0]) == 4 + 4 * 9 * 3
    assert seen[0, 4, 1][:24] == struct.pack("<I5i", 5, 60, 0, 0, 80, 40)
    digests: dict[tuple[int, int, int], bytes | None] = {
        key: hashlib.sha256(seen[key]).digest() for key in sorted(seen)
    }
    oracle.decode(build(stream(*PACKETS, digests=digests)), check_digests=True)
    wrong = build(stream(*PACKETS, digests=digests | {(0, 5, 1): bytes(32)}))
    assert fault(wrong, check_digests=True) == ("E_DIGEST", "R-5.7-3", wrong.index(b"dGST"))
    oracle.decode(wrong, cut=wide([[2, 0, 1]]), check_digests=True)


def test_a_digest_of_the_palette_is_a_row_of_tile_0() -> None:
    packets = (ENTRIES, ADDS, replace(ADDS, tile=1))
    data = build(stream(*packets, n_tiles=2, digests={(1, 5, 0): bytes(32)}))
    assert fault(data) == ("E_CHUNK", "R-5.7-2", data.index(b"dGST"))


@pytest.mark.parametrize("steps", [[0, 0, 2], [0, 0, 1], [2, 0, 1], [1, 1, 2], [2, 2, 2]])
def test_cuts_that_are_valid(steps: list[int]) -> None:
    assert narrow(oracle.decode(build(stream(*PACKETS)), cut=wide([steps])).tiles[0].cut) == steps


@pytest.mark.parametrize(
    "steps", [[1, 1, 1], [2, 1, 0], [1, 2, 2], [2, 2, 3], [0, 0, -1], [2, 2], [2, 2, 2, 0], []]
)
def test_cuts_that_are_not_valid(steps: list[int]) -> None:
    with pytest.raises(ValueError, match="cut"):
        oracle.decode(build(stream(*PACKETS)), cut=wide([steps]))


def test_picks_of_another_tile_need_the_palette_too() -> None:
    data = build(stream(ENTRIES, ADDS, replace(ADDS, tile=1), replace(PICKS, tile=1), n_tiles=2))
    with pytest.raises(ValueError, match="cut"):
        oracle.decode(data, cut=wide([[1, 0, 0], [1, 1, 0]]))
    with pytest.raises(ValueError, match="cut"):
        oracle.decode(data, cut=wide([[1, 0, 1], [1, 1, 1]]))
    assert oracle.decode(data, cut=wide([[0, 0, 1], [1, 1, 0]])).tiles[1].channels[14] == [
        60,
        0,
        20,
    ]


# ---- what comes in pieces ----


def pieces(data: bytes, *missing: int) -> list[tuple[int, int]]:
    """Ranges of all but the packets of these numbers."""
    packets = oracle.read_tables(data, {}).packets
    kept = [(p.start, p.size) for k, p in enumerate(packets) if k not in missing]
    return [(0, start_of(data)), *kept]


@pytest.mark.parametrize(
    ("missing", "cut"),
    [
        ((), [2, 2, 2]),
        ((0,), [2, 0, 0]),  # the second packet of the palette waits for the first
        ((2,), [2, 0, 1]),
        ((1,), [0, 0, 2]),
        ((3,), [2, 0, 2]),
        ((4,), [1, 1, 2]),
        ((1, 2), [0, 0, 1]),
    ],
)
def test_picks_wait_for_core_and_for_the_whole_palette(missing, cut) -> None:
    data = build(stream(*PACKETS))
    assert narrow(oracle.decode_pieces(data, pieces(data, *missing)).tiles[0].cut) == cut


def test_picks_of_no_bytes_wait_for_the_palette_too() -> None:
    data = build(stream(ENTRIES, ADDS, Packet(component=4)))
    assert narrow(oracle.decode_pieces(data, pieces(data, 0)).tiles[0].cut) == [1, 0, 0]


def test_a_wrong_packet_of_picks_is_not_examined_while_the_palette_is_not_there() -> None:
    data = build(stream(ENTRIES, ADDS, replace(PICKS, picks=[9, 9, 9])))
    assert narrow(oracle.decode_pieces(data, pieces(data, 0)).tiles[0].cut) == [1, 0, 0]
    with pytest.raises(oracle.FaultError) as caught:
        oracle.decode_pieces(data, pieces(data))
    assert caught.value.code == "E_INDEX"


# ---- faults ----


@pytest.mark.parametrize(
    ("code", "requirement", "packets"),
    [
        ("E_CHAIN", "R-5.6-1", [ADDS, Packet(component=3)]),
        ("E_CHAIN", "R-5.6-2", [ENTRIES, Packet(component=4)]),
        ("E_CHAIN", "R-5.6-2", [ADDS, Packet(component=4), Packet(component=4)]),
        ("E_COUNT", "R-5.6-4", [replace(ENTRIES, row={"n_splits": 1})]),
        ("E_COUNT", "R-5.6-4", [replace(ENTRIES, row={"n_drops": 1})]),
        ("E_COUNT", "R-5.6-4", [ADDS, replace(PICKS, row={"n_adds": 3})]),
        ("E_COUNT", "R-5.6-4", [ADDS, replace(PICKS, row={"level": 1})]),
        ("E_COUNT", "R-5.6-5", [Packet(component=5, row={"n_adds": 1})]),
        ("E_COUNT", "R-5.6-5", [Packet(component=5, is_explicit=True)]),
        ("E_COUNT", "R-5.6-6", [ENTRIES, Packet(records={0: REFINE})]),
        ("E_AMPLIFICATION", "R-5.6-7", [Packet(component=5, n_adds=16 * 11 + 1, is_explicit=True)]),
        ("E_CRC", "R-5.6-8", [Packet(component=5, tile=1, row={"crc": 1})]),
        ("E_CHAIN", "R-5.6-10", [replace(ENTRIES, tile=1)]),
    ],
)
def test_a_wrong_row_is_a_fault_of_the_packet_table(code, requirement, packets) -> None:
    data = build(stream(*packets, n_tiles=2))
    assert fault(data) == (code, requirement, data.index(b"PACK"))


@pytest.mark.parametrize("component", [1, 2, 3, 6, 255])
def test_a_stream_with_a_palette_has_no_bands(component) -> None:
    data = build(stream(ADDS, Packet(row={"component": component}), degree=3))
    assert fault(data)[:2] == ("E_CHAIN", "R-5.6-1")


def test_a_palette_needs_sh_and_is_looked_for_after_grid_exponents() -> None:
    assert fault(build(stream(degree=0)))[:2] == ("E_HEADER", "R-5.1-9")
    reserved = build(stream(header={"flags": 0x300}))
    assert fault(reserved)[:2] == ("E_RESERVED", "R-4.4-1")
    wrong_grid = build(stream(degree=0, grid=(41, 0, 0, 0, 0)))
    assert fault(wrong_grid)[:2] == ("E_HEADER", "R-5.1-7")


@pytest.mark.parametrize(
    ("name", "most", "packets"),
    [
        ("tile_steps", 3, (*[ENTRIES] * 3, ADDS)),
        ("tile_slots", 4, (ENTRIES, ADDS, MORE)),  # 4 entries; 3 slots of tile 0 stand apart
        ("tile_slots", 5, PACKETS),
        ("slots", 12, (*PACKETS, replace(ADDS, tile=1))),  # 5 and 3 slots, 4 entries
    ],
)
def test_the_palette_is_bounded_like_a_tile_and_counts_among_all_slots(name, most, packets) -> None:
    data = build(stream(*packets, n_tiles=2))
    oracle.decode(data, limits={name: most})
    assert fault(data, limits={name: most - 1}) == ("E_LIMIT", name, data.index(b"PACK"))


@pytest.mark.parametrize(
    ("code", "requirement", "body"),
    [
        ("E_PACKET", "R-5.9-1", bytes([0, 0])),
        *(("E_RESERVED", "R-4.4-1", bytes([1 << bit, 0, 0])) for bit in range(3, 8)),
        ("E_PACKET", "R-5.9-1", bytes([4, 0])),
        ("E_PACKET", "R-5.9-3", bytes([4, 0, 0x44])),
        ("E_RESERVED", "R-4.4-1", bytes([0, 0, 0x82])),
        ("E_PACKET", "R-5.9-2", bytes([0, 0, 0x40])),
        ("E_PACKET", "R-5.9-3", bytes([0, 0, 0x44])),
        ("E_PACKET", "R-5.9-7", bytes([0, 0, 0x04])),
        ("E_PACKET", "R-5.9-8", bytes([0, 0, 0, 9])),
    ],
)
def test_a_wrong_packet_of_picks_is_a_fault_at_its_start(code, requirement, body) -> None:
    data = build(stream(ENTRIES, ADDS, replace(PICKS, edit=lambda _: body)))
    assert fault(data) == (code, requirement, len(data) - len(body))


def test_bit_2_of_core_and_of_the_palette_is_reserved() -> None:
    for packets in ([replace(ADDS, flags=4)], [replace(ENTRIES, flags=4)]):
        data = build(stream(*packets))
        assert fault(data) == ("E_RESERVED", "R-4.4-1", start_of(data))
    band = Packet(component=1, adds={0: [1, 2, 3]}, flags=4)
    data = build(stream(ADDS, band, has_palette=False))
    (_, picks) = oracle.read_tables(data, {}).packets
    assert fault(data) == ("E_RESERVED", "R-4.4-1", picks.start)


@pytest.mark.parametrize(
    ("code", "requirement", "changes"),
    [
        ("E_FRAME", "R-5.10-3", {"flags": 4}),  # a plane of the new slots only
        ("E_FRAME", "R-5.10-3", {"repicks": None, "stored": {"picks": [2, 1, 4, 2]}}),
        ("E_INDEX", "R-7.2-4", {"repicks": [5, 0]}),
        ("E_INDEX", "R-7.2-4", {"repicks": [0, 5]}),
        ("E_INDEX", "R-7.2-4", {"repicks": [0, 0], "picks": [5, 0]}),
    ],
)
def test_wrong_picks_of_changed_slots_are_a_fault_of_their_packet(
    code, requirement, changes
) -> None:
    wrong = replace(MORE_PICKS, codings={"picks": 8}, **changes)
    data = build(stream(*PACKETS[:5], wrong))
    picks = oracle.read_tables(data, {}).packets[-1]
    assert fault(data) == (code, requirement, picks.start)


def test_the_list_of_no_picks_has_the_coding_byte_0() -> None:
    drop = Packet(records={0: DROP})
    right = Packet(component=4, edit=lambda _: bytes([7, 0, 0]))  # flags of nothing are allowed
    assert narrow(oracle.decode(build(stream(ADDS, right, drop, right))).tiles[0].cut) == [2, 2, 0]
    wrong = replace(right, edit=lambda _: bytes([0, 0, 4]))
    assert fault(build(stream(ADDS, right, drop, wrong)))[:2] == ("E_PACKET", "R-5.9-4")


@pytest.mark.parametrize(
    ("requirement", "stored", "coding"),
    [
        ("R-7.1-1", [(1 << 24) - 2] * 33, 0x28 | DELTA),  # 33 (2^23 - 1) is over 2^28
        ("R-7.3-1", [(1 << 23) + 2], 0x28),  # 2^22 + 1 times 2^6
    ],
)
def test_entries_out_of_range_are_refused(requirement, stored, coding) -> None:
    n, codings = len(stored), {"adds 0": coding}
    wrong = Packet(component=5, n_adds=n, stored={"adds 0": stored}, codings=codings)
    data = build(stream(wrong, quantisers={(0, 5): (1 << 6, 0)}))
    assert fault(data) == ("E_RANGE", requirement, start_of(data))


def test_the_last_entry_may_be_picked_and_none_after_it() -> None:
    last = replace(PICKS, picks=[4, 4, 4])
    assert oracle.decode(build(stream(*PACKETS[:3], last))).tiles[0].channels[14] == [80] * 3
    data = build(stream(*PACKETS[:3], replace(PICKS, picks=[4, 5, 4])))
    assert fault(data)[:2] == ("E_INDEX", "R-7.2-4")


def test_missing_bytes_of_the_palette_matter_only_in_cuts_that_take_it() -> None:
    data = build(stream(ADDS, ENTRIES))
    assert fault(data[:-1])[:2] == ("E_TRUNCATED", "R-6.2-2")
    assert fault(data[:-1], level=0)[:2] == ("E_TRUNCATED", "R-6.2-2")
    assert narrow(oracle.decode(data[:-1], cut=wide([[1, 0, 0]])).tiles[0].cut) == [1, 0, 0]
