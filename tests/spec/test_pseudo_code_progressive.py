"""The pseudo-code of cuts (3.5, 3.6) and of progressive decoding (6.4) against the oracle."""

from collections.abc import Iterable
from random import Random
from types import SimpleNamespace

import pytest

from conformance.decoders import oracle
from conformance.generator.builder import REFINE, Packet, Stream, Tile, X, build
from conformance.generator.random_streams import random_stream
from tests.support.palette_streams import each_stream
from tests.support.pseudo_code import pseudo_code

SPEC = pseudo_code()
N_STREAMS = 160


def streams() -> list[bytes]:
    drawn = [random_stream(Random(f"progressive {seed}")) for seed in range(N_STREAMS)]
    return [*drawn, *each_stream()]


def components(scene: oracle.Scene) -> dict[int, int]:
    """Component of the oracle: component of the text."""
    names = {c: c for c in range(SPEC.PALETTE + 1)}
    if scene.header.has_palette:
        names |= {oracle.PICKS: SPEC.PICKS, oracle.PALETTE: SPEC.PALETTE}
    return names


def rows_of(scene: oracle.Scene) -> list[SimpleNamespace]:
    """The packets as the pseudo-code wants them (3.5)."""
    names, levels, rows = components(scene), {}, list[SimpleNamespace]()
    for p in scene.packets:
        row = SimpleNamespace(tile=p.tile, step=p.step, component=names[p.component], size=p.size)
        if row.component == SPEC.CORE:
            levels[p.tile, p.step] = p.level
        own = row.component in (SPEC.CORE, SPEC.PALETTE)
        row.label = p.level if own else levels[p.tile, p.step]
        row.packet, row.row = p, len(rows)
        rows.append(row)
    return rows


def oracle_cut(scene: oracle.Scene, cut: dict[tuple[int, int], int]) -> list[list[int]]:
    names = components(scene)
    return [
        [cut.get((t, names[c]), 0) for c in range(len(tile.cut))]
        for t, tile in enumerate(scene.tiles)
    ]


# --- cuts -----------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_cut_by_level_has_the_packets_that_the_oracle_takes():
    for data in streams():
        scene = oracle.read_tables(data, {})
        rows = rows_of(scene)
        for level in range(min(scene.header.n_levels, 9)):
            cut = SPEC.cut_by_level(rows, level)
            assert oracle_cut(scene, cut) == oracle.cut_by_level(scene, level)
            assert [r.label <= level for r in rows] == [
                r in SPEC.packets_of(cut, rows) for r in rows
            ]
            assert SPEC.is_valid(cut, rows)


@pytest.mark.thorough
def test_the_cut_by_the_highest_level_has_all_packets():
    for data in streams():
        scene = oracle.read_tables(data, {})
        rows = rows_of(scene)
        cut = SPEC.cut_by_level(rows, scene.header.n_levels - 1)
        assert SPEC.packets_of(cut, rows) == rows


@pytest.mark.thorough
def test_cuts_are_valid_exactly_if_the_oracle_takes_them():
    rng, n_valid, n_wrong = Random("cuts"), 0, 0
    for data in streams():
        scene = oracle.read_tables(data, {})
        rows = rows_of(scene)
        for _ in range(4):
            most = SPEC.cut_of(rows)
            cut = {chain: rng.randint(0, n + (rng.random() < 0.1)) for chain, n in most.items()}
            valid = SPEC.is_valid(cut, rows)
            try:
                oracle.check_cut(scene, oracle_cut(scene, cut))
            except ValueError:
                assert not valid
                n_wrong += 1
            else:
                assert valid
                n_valid += 1
    assert min(n_valid, n_wrong) > 50


@pytest.mark.thorough
def test_each_packet_stands_behind_those_that_it_requires():
    for data in streams():
        rows = rows_of(oracle.read_tables(data, {}))
        for i, p in enumerate(rows):
            assert not any(SPEC.requires(p, q) for q in rows[i:])
            assert SPEC.is_valid(SPEC.cut_of(rows[: i + 1]), rows)


# --- progressive decoding -------------------------------------------------------------------------


def damaged(data: bytes, packets: Iterable[oracle.Packet]) -> bytes:
    """The stream with the last byte of these packets changed."""
    out = bytearray(data)
    for p in packets:
        out[p.start + p.size - 1] ^= 0xFF
    return bytes(out)


def feed(data: bytes, order: list[int]) -> tuple[oracle.Scene, SimpleNamespace]:
    """The state and the decoder of the text after these packets came, in this order."""
    scene = oracle.read_tables(data, {})

    def apply(row: SimpleNamespace) -> None:
        p = row.packet
        try:
            oracle.apply_whole(scene, p, data[p.start : p.start + p.size])
        except oracle.FaultError as fault:
            raise SPEC.FaultError(fault.code, p.start) from fault

    decoder = SPEC.Progressive(rows_of(scene), apply)
    for number in order:
        decoder.completed([number])
    oracle.finish(scene, [], set())
    return scene, decoder


def arrival(data: bytes, order: list[int]) -> list[tuple[int, int]]:
    scene = oracle.read_tables(data, {})
    head = oracle.HEADER.size + scene.header.chunks_size
    return [(0, head), *((scene.packets[i].start, scene.packets[i].size) for i in order)]


def test_the_pseudo_code_applies_the_packets_that_the_oracle_applies():
    rng, n_faults, n_partial = Random("arrival"), 0, 0
    for data in streams():
        whole = oracle.read_tables(data, {})
        stored = [p for p in whole.packets if p.size > 0]
        bad = [p for p in stored if rng.random() < rng.choice((0, 0.1, 0.3))]
        stream = damaged(data, bad)
        order = [i for i in range(len(whole.packets)) if rng.random() < 0.9]
        rng.shuffle(order)
        expected = oracle.decode_what_came(stream, arrival(stream, order))
        scene, decoder = feed(stream, order)
        assert scene.dump() == expected.dump()
        assert [tile.cut for tile in scene.tiles] == [tile.cut for tile in expected.tiles]
        found = [decoder.fault_of[i] for i in sorted(decoder.fault_of)]
        assert [(f.code, f.offset) for f in found] == [(f.code, f.offset) for f in expected.faults]
        verdict = decoder.end(False, False)
        if expected.faults:
            assert verdict is found[0]
        else:
            is_whole = len(SPEC.packets_of(SPEC.cut_of(decoder.applied), decoder.packets))
            assert verdict == ("complete" if is_whole == len(decoder.packets) else "partial")
            n_partial += verdict == "partial"
        n_faults += len(found)
    assert min(n_faults, n_partial) > 20


@pytest.mark.thorough
def test_the_order_of_arrival_changes_nothing():
    rng = Random("orders")
    for data in streams()[::5]:
        n = len(oracle.read_tables(data, {}).packets)
        order = [i for i in range(n) if rng.random() < 0.8]
        dumps = set()
        for _ in range(3):
            rng.shuffle(order)
            dumps.add(feed(data, order)[0].dump())
        assert len(dumps) == 1


def chain(n: int = 4) -> bytes:
    """Packets of two tiles in turn; each step after the first refines slot 0."""
    packets = [Packet(tile=t, adds={X: [5]}) for t in range(2)]
    for _ in range(n):
        packets += [Packet(tile=t, records={0: REFINE}, psi={X: [1]}) for t in range(2)]
    return build(Stream(packets, tiles=(Tile(), Tile())))


def test_a_fault_is_reported_when_no_earlier_packet_is_missing():
    data = chain()
    rows = oracle.read_tables(data, {}).packets
    data = damaged(data, [rows[3]])
    _, decoder = feed(data, [1, 3])
    assert decoder.fault_of[3].code == "E_CRC"
    assert decoder.fault() is None  # packets 0 and 2 are missing
    decoder.completed([0])
    assert decoder.fault() is None
    decoder.completed([2])
    assert decoder.fault() is decoder.fault_of[3]


def test_what_requires_a_faulty_packet_is_not_examined_and_the_rest_goes_on():
    data = chain()
    rows = oracle.read_tables(data, {}).packets
    data = damaged(data, [rows[3], rows[5]])
    _, decoder = feed(data, list(range(len(rows))))
    assert list(decoder.fault_of) == [3]
    assert [(row.tile, row.step) for row in decoder.applied] == [
        *((0, 0), (1, 0), (0, 1)),
        *((0, step) for step in range(2, 5)),
    ]


@pytest.mark.parametrize(
    ("order", "trailing", "differs", "expected"),
    [
        (range(10), False, False, "complete"),
        (range(9), False, False, "partial"),
        (range(9), True, True, "E_TRAILING"),
        (range(10), False, True, "E_DIGEST"),
    ],
)
def test_the_end_of_the_bytes_has_one_verdict(order, trailing, differs, expected):
    _, decoder = feed(chain(), list(order))
    verdict = decoder.end(trailing, differs)
    assert getattr(verdict, "code", verdict) == expected
