"""Reference and oracle agree on strange and on damaged streams; wrong decoders are found."""

from collections import Counter
from functools import partial
from random import Random

import numpy as np
import pytest

from conformance import fuzz, memory
from conformance.builder import Packet, Stream, X, build, repaired
from conformance.cases.scenes import SMALL
from conformance.fuzz import Finding, check, smaller
from conformance.mutants import MUTANTS, load
from conformance.outcomes import Outcome, Run, by_codec, by_oracle
from conformance.random_streams import random_stream
from conformance.tampering import Parts, tampered
from evogs_codec import decode

NAMED = {mutant.name: mutant for mutant in MUTANTS}
# What shows only in the integers, behind right checksums.
WRONG = (
    *("shift-truncates", "zigzag-signs-swapped", "adds-before-splits", "late-sh-zero"),
    *("alpha-of-first-split", "packed-from-high-bits", "ycocg-co-truncates"),
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
    assert min(kinds[kind] for kind in ("STEP", "ALFA", "dGST", "mETa", "teSt")) > 5
    assert min(kinds[kind] for kind in ("degree 3", "no tiles", "empty packet")) > 5


def test_damage_is_behind_right_checksums_and_is_the_same_for_a_seed() -> None:
    base = random_stream(Random(1))
    damaged = [tampered(Random(seed), base) for seed in range(100)]
    assert damaged == [tampered(Random(seed), base) for seed in range(100)]
    right = sum(repaired(data) == data for data in damaged)
    assert 60 < right < 100
    assert sum(by_oracle(data, Run()).exit != 0 for data in damaged) > 30


def test_the_reference_and_the_oracle_agree_on_some_hundred_streams() -> None:
    verdicts, findings = fuzz.fuzz(20260101, 0, 400)
    assert findings == []
    assert verdicts["file 0"] > 100
    codes = {verdict.split()[-1] for verdict in verdicts if "E_" in verdict}
    assert len(codes) >= 15


def test_any_part_of_a_run_finds_what_the_whole_finds() -> None:
    whole, _ = fuzz.fuzz(7, 0, 60)
    first, _ = fuzz.fuzz(7, 0, 25)
    second, _ = fuzz.fuzz(7, 25, 35)
    assert first + second == whole


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


def test_exceptions_endless_loops_and_memory_are_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    data = build(SMALL)
    assert check(data, Run(), measures=True) == ("0", "")
    assert check(data, Run(), decode=raising)[1] == "IndexError: list index out of range"
    large = random_stream(Random(3), fuzz.TIMES)
    assert check(large, Run(), measures=True) == ("0", "")
    assert "bytes of memory" in check(large, Run(), decode=greedy, measures=True)[1]
    monkeypatch.setattr(fuzz, "SECONDS", 0.05)
    assert check(data, Run(), decode=endless)[1] == "no end within 0.05 s"


def test_a_stream_with_trailing_bytes_is_refused_alike() -> None:
    assert check(build(SMALL) + b"x", Run(verify=True)) == ("1 E_TRAILING", "")


def test_the_command_prints_what_it_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["--count", "20", "--seed", "3"]) == 0
    assert "0 findings" in capsys.readouterr().out
