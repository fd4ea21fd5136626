"""Reference and oracle agree on strange and on damaged streams; wrong decoders are found."""

from collections import Counter
from dataclasses import replace
from functools import partial
from itertools import pairwise
from random import Random

import numpy as np
import pytest

from conformance.decoders import oracle
from conformance.decoders.outcomes import Outcome, Run, by_oracle
from conformance.decoders.reference import by_codec
from conformance.fuzzing import cli, fuzz, memory
from conformance.fuzzing.costly import BUDGET, costly_stream, random_shape, stream_of
from conformance.fuzzing.fuzz import Finding, check
from conformance.fuzzing.smaller import smaller
from conformance.generator.builder import PALETTE, PICKS, Packet, Stream, X, build, repaired
from conformance.generator.cases.scenes import SMALL
from conformance.generator.random_streams import random_stream
from conformance.generator.tampering import Parts, tampered
from conformance.mutants import MUTANTS, load
from evogs_codec import Decoded, SplatParams, decode
from tests.support.sibling_streams import with_siblings

NAMED = {mutant.name: mutant for mutant in MUTANTS}
# What shows only in the integers, behind right checksums.
WRONG = (
    *("shift-truncates", "zigzag-signs-swapped", "adds-before-splits", "late-sh-zero"),
    *("alpha-of-first-split", "packed-from-high-bits", "ycocg-co-truncates"),
    *("siblings-ignored", "siblings-before-ycocg", "siblings-by-last-step"),
    *("late-picks-zero", "picks-of-size-0-are-1", "delta-across-palette-packets"),
)


def by_mutant(name: str, data: bytes, run: Run) -> Outcome:
    return by_oracle(data, run, load(NAMED[name]))


def raising(data: bytes, run: Run) -> Outcome:
    raise IndexError("list index out of range")


def endless(data: bytes, run: Run) -> Outcome:
    while True:
        pass


def greedy(data: bytes, run: Run) -> Outcome:
    """The reference, which besides has its state once more, as floats of 64 bits."""
    decoded = decode(data)
    floats = [tile.x.astype(np.float64) for tile in decoded.tiles]
    return by_codec(data, run) if floats else Outcome(1)


@pytest.mark.thorough
def test_random_streams_are_legal_and_use_what_the_text_leaves_free() -> None:
    kinds = Counter[str]()
    for seed in range(150):
        data = random_stream(Random(seed))
        assert by_oracle(data, Run(verify=True)).exit == 0, seed
        assert random_stream(Random(seed)) == data
        parts = Parts.of(data)
        assert parts.join() == data
        kinds.update(kind.decode() for kind, _ in parts.chunks)
        kinds["degree 3"] += data[11] == 3
        kinds["no tiles"] += data[24:28] == bytes(4)
        kinds["empty packet"] += b"" in parts.packets
    assert min(kinds[kind] for kind in ("QUAN", "ALFA", "dGST", "mETa", "teSt")) > 5
    assert min(kinds[kind] for kind in ("degree 3", "no tiles", "empty packet")) > 5


@pytest.mark.thorough
def test_random_streams_have_sibling_differences_of_every_kind() -> None:
    kinds = Counter[str]()
    for seed in range(400):
        data = random_stream(Random(f"siblings {seed}"))
        scene = oracle.decode(data)  # they are all legal
        kinds["streams"] += 1
        for packet, codings, siblings in with_siblings(data, scene):
            tile, is_turned = scene.tiles[packet.tile], data[packet.start] & 1 == 1
            step, born_from = tile.steps[packet.step], tile.born_from
            parents = [born_from[slot] for slot in siblings]
            others = [born_from[slot] for slot in step.slots if slot not in siblings]
            kinds["no siblings"] += not siblings
            kinds["siblings"] += bool(siblings)
            kinds["a parent that is not named"] += any(slot is not None for slot in others)
            kinds["several children of a slot"] += len(parents) > len(set(parents))
            kinds["a chain"] += any(slot in siblings for slot in parents)
            kinds["of a band"] += bool(siblings) and packet.component > 0
            kinds["beside adds"] += bool(siblings) and step.core.n_adds > 0
            kinds["in YCoCg-R"] += bool(siblings) and is_turned
            kinds["of some channels"] += any(c & 64 == 0 for c in codings)
            kinds["of a band that is late"] += (
                bool(siblings) and packet.component > 0 and not is_next(scene, packet)
            )
    assert kinds.pop("streams") < 5 * kinds["siblings"]
    assert {name: n for name, n in kinds.items() if n < 5} == {}


def is_next(scene: oracle.Scene, packet: oracle.Packet) -> bool:
    """No step of core stands between that of the packet and the packet."""
    before = scene.packets[: scene.packets.index(packet)]
    return sum(p.tile == packet.tile and p.component == 0 for p in before) == packet.step + 1


@pytest.mark.thorough
def test_random_streams_have_palettes_of_every_kind() -> None:
    kinds = Counter[str]()
    for seed in range(600):
        data = random_stream(Random(f"palette {seed}"))
        kinds["streams with SH"] += data[11] > 0
        if not data[19] & 1:
            continue
        scene = oracle.decode(data, check_digests=True)  # they are all legal
        rows, tiles, n_entries = scene.packets, scene.tiles, len(scene.palette[0])
        kinds["palettes"] += 1
        for degree in (1, 2, 3):
            kinds[f"degree {degree}"] += scene.header.sh_degree == degree and n_entries > 0
        kinds["no tiles"] += not tiles
        kinds["several tiles with picks"] += sum(tile.cut[PICKS] > 0 for tile in tiles) > 1
        kinds["no entries, but picks"] += n_entries == 0 and any(p.component == PICKS for p in rows)
        kinds["several packets of the palette"] += sum(p.component == PALETTE for p in rows) > 1
        kinds["a packet without entries"] += any(
            p.component == PALETTE and p.size == 0 for p in rows
        )
        levels = [p.level for p in rows if p.component == PALETTE]
        labels = {p.level for p in rows if p.component == 0}
        kinds["palettes of several levels"] += len(set(levels)) > 1
        kinds["two packets of a level above 0"] += any(a == b > 0 for a, b in pairwise(levels))
        kinds["a level that no step has"] += bool(levels and labels and set(levels) - labels)
        kinds["entries behind picks of a lower level"] += any(
            p.component == PICKS and q.component == PALETTE and q.n_adds > 0
            for p, q in pairwise(rows)
        )
        kinds["picks of some of the entries before them"] += picks_some_entries(scene)
        kinds["picks of 9 bits"] += n_entries > 255
        kinds["picks of no bytes"] += any(p.component == PICKS and p.size == 0 for p in rows)
        kinds["late picks"] += any(tile.cut[0] > tile.cut[PICKS] > 0 for tile in tiles)
        kinds["core before the palette"] += any(
            p.component == 0 and q.component == PALETTE for p, q in pairwise(rows)
        )
        kinds["digests of the palette"] += any(key[1] == PALETTE for key in scene.digests)
        shown = [
            [tile.channels[c][u] for c in range(14, len(tile.x))]
            for tile in tiles
            for u in range(tile.n_slots)
        ]
        entries = [list(entry) for entry in zip(*scene.palette, strict=True)]
        kinds["the last entry"] += n_entries > 1 and any(entries[-1]) and entries[-1] in shown
        kinds["SH of 0 beside others"] += any(map(any, shown)) and not all(map(any, shown))
        bit_2 = [
            tiles[p.tile].steps[p.step].core
            for p in rows
            if p.component == PICKS and p.size > 0 and data[p.start] & 4
        ]
        kinds["new picks of refined slots"] += any(core.n_refines for core in bit_2)
        kinds["new picks of split slots"] += any(core.n_splits for core in bit_2)
        kinds["new picks of no slots"] += any(core.n_psi == 0 for core in bit_2)
        for step in (step for tile in tiles for step in tile.steps[: tile.cut[PICKS]]):
            for kind, name in enumerate(("refine", "split", "drop")):
                kinds[f"a {name} under picks"] += n_entries > 0 and kind in step.kinds
    assert 4 * kinds["palettes"] > 0.7 * kinds.pop("streams with SH")
    assert {name: n for name, n in kinds.items() if n < 5} == {}


def picks_some_entries(scene: oracle.Scene) -> bool:
    """Before some row of picks stand entries that it may name, and others of higher levels."""
    before = list[oracle.Packet]()
    for p in scene.packets:
        if p.component == PALETTE and p.n_adds > 0:
            before.append(p)
        elif p.component == PICKS and p.size > 0:
            label = scene.tiles[p.tile].steps[p.step].core.level
            if 0 < sum(q.level <= label for q in before) < len(before):
                return True
    return False


@pytest.mark.thorough
def test_damage_reaches_palettes_and_picks() -> None:
    found, n_falling = Counter[str](), 0
    for number in range(150):
        base = random_stream(Random(f"palette {number}"))
        for seed in range(60 if base[19] & 1 else 2):
            data = tampered(Random(f"{number}/{seed}"), base)
            try:
                oracle.decode(data)
            except oracle.FaultError as fault:
                found[fault.detail] += 1
                n_falling += fault.detail == "R-5.6-3" and palette_falls(data)
    wanted = {"R-5.1-9", "R-5.6-1", "R-5.6-2", "R-5.6-4", "R-5.6-5", "R-5.6-10", "R-7.2-4"}
    assert wanted <= set(found)
    assert n_falling > 3


def palette_falls(data: bytes) -> bool:
    """A row of the palette has a lower level than the one before it."""
    rows = Parts.of(data).table()
    levels = [rows[at + 5] for at in range(0, len(rows), 36) if rows[at + 4] == PALETTE]
    return levels != sorted(levels)


def test_damage_is_behind_right_checksums_and_is_the_same_for_a_seed() -> None:
    base = random_stream(Random(1))
    damaged = [tampered(Random(seed), base) for seed in range(100)]
    assert damaged == [tampered(Random(seed), base) for seed in range(100)]
    right = sum(repaired(data) == data for data in damaged)
    assert 60 < right < 100
    assert sum(by_oracle(data, Run()).exit != 0 for data in damaged) > 30


@pytest.mark.thorough
def test_the_reference_and_the_oracle_agree_on_some_hundred_streams() -> None:
    verdicts, findings = fuzz.fuzz(20260101, 0, 400)
    assert findings == []
    assert verdicts["file 0"] > 100
    codes = {verdict.split()[-1] for verdict in verdicts if "E_" in verdict}
    assert len(codes) >= 15


@pytest.mark.thorough
def test_any_part_of_a_run_finds_what_the_whole_finds() -> None:
    whole, _ = fuzz.fuzz(7, 0, 60)
    first, _ = fuzz.fuzz(7, 0, 25)
    second, _ = fuzz.fuzz(7, 25, 35)
    assert first + second == whole


@pytest.mark.thorough
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_decoder_is_found_and_its_stream_made_smaller(name: str) -> None:
    decode = partial(by_mutant, name)
    for seed in range(300):
        data = random_stream(Random(f"wrong/{seed}"))
        for run in fuzz.runs_of(Random(seed), data):
            _, says = check(data, run, decode=decode)
            if says:
                found = smaller(Finding(data, run, says), decode=decode)
                assert len(found.data) <= len(data)
                assert check(found.data, found.run, decode=decode)[1] == found.says
                assert found.run == Run() or found.run.mode == "progressive" or found.run.level
                return
    raise AssertionError("not found")


def test_a_state_of_megabytes_keeps_to_the_memory_of_its_counts() -> None:
    data = build(Stream([Packet(adds={X: range(40_000)})]))
    decode(data)
    allowed = memory.bound(data)
    assert memory.peak(lambda: decode(data), allowed) <= allowed


def test_a_palette_of_a_megabyte_keeps_to_the_memory_of_its_counts() -> None:
    entries = {channel: range(channel, 4000 + channel) for channel in range(45)}
    packets = [Packet(component=PALETTE, adds=entries), Packet(adds={X: range(4000)})]
    packets.append(Packet(component=PICKS, picks=range(1, 4001)))
    data = build(Stream(packets, degree=3, has_palette=True))
    allowed = memory.bound(data)
    assert memory.peak(lambda: decode(data), allowed) <= allowed


@pytest.mark.thorough
def test_exceptions_endless_loops_and_memory_are_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    data = build(SMALL)
    assert check(data, Run(), measures=True) == ("0", "")
    assert check(data, Run(), decode=raising)[1] == "IndexError: list index out of range"
    large = random_stream(Random(3), fuzz.LARGE_TIMES)
    assert check(large, Run(), measures=True) == ("0", "")
    assert "bytes of memory" in check(large, Run(), decode=greedy, measures=True)[1]
    monkeypatch.setattr(fuzz, "SECONDS", 0.05)
    assert check(data, Run(), decode=endless)[1] == "no end within 0.05 s"


def test_a_stream_with_trailing_bytes_is_refused_alike() -> None:
    assert check(build(SMALL) + b"x", Run(verify=True)) == ("1 E_TRAILING", "")


@pytest.mark.thorough
def test_the_command_prints_what_it_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--count", "10", "--seed", "3"]) == 0
    assert "0 findings" in capsys.readouterr().out


@pytest.mark.thorough
def test_costly_streams_are_what_the_oracle_takes_them_for() -> None:
    verdicts = Counter[str]()
    for seed in range(40):
        rng = Random(seed)
        shape = replace(random_shape(rng), adds=rng.choice((1, 3, 50)), tiles=rng.choice((1, 3)))
        shape = replace(shape, chunks=0, metadata=rng.choice((0, 50)), entries=0)
        try:
            data = stream_of(shape, 6000)
        except ValueError:  # no room for packets
            continue
        assert len(data) <= 6001
        verdict, says = check(data, Run())
        assert says == ""
        assert verdict == {"": "0", "trailing": "1 E_TRAILING", "crc": "1 E_CRC"}[shape.fault]
        verdicts[verdict] += 1
    assert len(verdicts) == 3


def test_costly_streams_have_no_more_bytes_than_they_may() -> None:
    sizes = [len(costly_stream(Random(seed))) for seed in range(30)]
    assert max(sizes) <= BUDGET + 1  # and a byte that trails
    assert sorted(sizes)[10] > 0.8 * BUDGET


@pytest.mark.thorough
def test_a_costly_stream_is_held_to_the_clock_and_to_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, verdict, says = fuzz.costly(Random(2))
    assert (verdict, says) == ("0", "")
    leaves = Decoded.leaves

    def with_copies(self: Decoded) -> SplatParams:
        copies = [tile.x.astype(np.float64) for tile in self.tiles]
        found = leaves(self)
        assert len(copies) == len(self.tiles)  # still there
        return found

    with monkeypatch.context() as patch:
        patch.setattr(Decoded, "leaves", with_copies)
        assert "bytes of memory for the float view" in fuzz.costly(Random(2))[2]
    monkeypatch.setattr(fuzz, "COSTLY_SECONDS", 0.01)
    assert fuzz.costly(Random(2))[2] == "no end within 0.01 s"
