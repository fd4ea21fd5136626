"""A decoder is asked for its state beside a fault: the contract, the vectors, the fuzzer."""

import json
import shlex
import subprocess
import sys
import zlib
from collections import Counter
from random import Random

import pytest

from conformance.decoders import oracle
from conformance.decoders.outcomes import Outcome, Run, by_oracle
from conformance.decoders.reference import by_codec
from conformance.fuzzing import fuzz
from conformance.fuzzing.fuzz import check
from conformance.fuzzing.late_faults import late_fault, runs_beside_faults
from conformance.generator.builder import places
from conformance.generator.cases import fault_states
from conformance.generator.generate import stored_fingerprints
from conformance.generator.random_streams import random_stream
from conformance.harness.cli import main
from conformance.mutants import MUTANTS, load
from tests.conformance.schemas import errors
from tests.conformance.tiny import EXAMPLE, ROOT

VECTORS = ROOT / "conformance" / "vectors"
ATTACK = ROOT.parent / "shared" / "data" / "attacks" / "feed_fault_corrupts.evogs"
SCHEMA = json.loads((ROOT / "conformance/harness/reporting/report.schema.json").read_text())
NAMED = {mutant.name: mutant for mutant in MUTANTS}
KEEPS = {  # wrong decoders that keep what a packet with a fault wrote, and the vectors that show it
    "core-fault-keeps-numbers": ("core", "siblings", "two"),
    "core-fault-keeps-drops": ("core", "two"),
    "core-fault-keeps-packet": ("core", "siblings", "two"),
    "band-fault-keeps-numbers": ("band",),
    "picks-fault-keeps-picks": ("picks",),
    "palette-fault-keeps-entries": ("palette",),
}
DECODERS = {
    "reference": ["-m", "conformance.decoders.reference"],
    "cleanroom": [str(ROOT / "conformance" / "decoders" / "cleanroom" / "decoder.py")],
    "oracle": ["-m", "conformance.mutants", "run", "oracle"],
}
BESIDE = Run("progressive", dump_on_fault=True)
BROKEN = EXAMPLE[:-1] + bytes([EXAMPLE[-1] ^ 1])  # in the packet of level 1
LEVEL_0 = oracle.decode(EXAMPLE, level=0).dump()


# --- the contract ---------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("name", DECODERS)
@pytest.mark.parametrize(
    ("data", "options", "exit_code", "dump"),
    [
        (BROKEN, ["--dump-on-fault"], 1, LEVEL_0),
        (BROKEN, [], 1, None),
        (EXAMPLE + b"x", ["--dump-on-fault"], 1, oracle.decode(EXAMPLE).dump()),
        (b"x" + EXAMPLE[1:], ["--dump-on-fault"], 1, None),
        (EXAMPLE, ["--dump-on-fault"], 0, oracle.decode(EXAMPLE).dump()),
        (EXAMPLE[:-1], ["--dump-on-fault"], 3, LEVEL_0),
    ],
    ids=["packet", "not asked", "trailing", "header", "legal", "incomplete"],
)
def test_a_dump_stands_beside_a_fault_if_it_is_asked_for(
    tmp_path, name, data, options, exit_code, dump
):
    source, target = tmp_path / "in", tmp_path / "out"
    source.write_bytes(data)
    command = [sys.executable, *DECODERS[name], "--in", str(source), "--out", str(target)]
    done = subprocess.run(
        [*command, "--mode", "progressive", *options], cwd=ROOT, capture_output=True, check=False
    )
    assert done.returncode == exit_code
    assert (target.read_bytes() if target.exists() else None) == dump


@pytest.mark.parametrize("name", DECODERS)
def test_a_batch_asks_for_the_dump_beside_a_fault_run_by_run(tmp_path, name):
    source = tmp_path / "in"
    source.write_bytes(BROKEN)
    common = {"in": str(source), "mode": "progressive"}
    requests = [
        {"id": 1, "out": str(tmp_path / "a"), "dump_on_fault": True} | common,
        {"id": 2, "out": str(tmp_path / "b")} | common,
    ]
    done = subprocess.run(
        [sys.executable, *DECODERS[name], "--batch"],
        input="".join(f"{json.dumps(request)}\n" for request in requests),
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    fault = {"exit": 1, "code": "E_CRC", "offset": 457}
    assert answers == [{"id": 1} | fault, {"id": 2} | fault]
    assert (tmp_path / "a").read_bytes() == LEVEL_0
    assert not (tmp_path / "b").exists()


def test_a_level_and_digests_may_be_asked_for_beside_a_fault():
    assert by_codec(BROKEN, Run("progressive", level=1, dump_on_fault=True)) == Outcome(
        1, "E_CRC", 457, LEVEL_0
    )
    assert by_codec(BROKEN, Run("progressive", level=0, dump_on_fault=True)).exit == 0
    verify = Run("progressive", verify=True, dump_on_fault=True)
    assert by_codec(BROKEN, verify) == by_oracle(BROKEN, verify)


# --- the vectors ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "case", [case for recipe in fault_states.RECIPES for case in recipe()], ids=lambda c: c.name
)
def test_reference_and_oracle_have_the_same_state_beside_each_fault(case):
    for run in case.runs:
        assert by_codec(case.data, run) == by_oracle(case.data, run)


def test_the_state_beside_a_fault_is_that_of_a_file_without_the_packet():
    n_compared = 0
    for case in (case for recipe in fault_states.RECIPES[:5] for case in recipe()):
        came = by_oracle(case.data, BESIDE)
        if came.code is None:
            continue
        spans = [span for span in places(case.data).packets if span[0] != came.offset]
        pieces = ((0, places(case.data).packets[0][0]), *((a, b - a) for a, b in spans))
        left = by_oracle(case.data, Run("progressive", arrival=pieces))
        assert (left.exit, left.dump) == (3, came.dump)
        n_compared += 1
    assert n_compared > 20


@pytest.mark.thorough
@pytest.mark.parametrize("name", KEEPS)
def test_what_a_wrong_decoder_keeps_of_a_packet_shows_in_the_vectors_of_its_component_alone(name):
    found = stored_fingerprints()[name]
    vectors = {run.partition("#")[0] for run in (*found["outcomes"], *found["codes"])}
    words = {vector.removeprefix("fault-states-").partition("-")[0] for vector in vectors}
    assert words
    assert words <= set(KEEPS[name])
    assert all(outcome.startswith("1:") for outcome in found["outcomes"].values())


def with_quantisers_renamed(data: bytes) -> bytes:
    """A stream of draft 1, whose first chunk was `STEP`, as draft 2 writes it."""
    assert data[64:68] == b"STEP"
    covered = b"QUAN" + data[68:72] + data[76 : 76 + int.from_bytes(data[68:72], "little")]
    crc = zlib.crc32(covered).to_bytes(4, "little")
    return data[:64] + covered[:8] + crc + covered[8:] + data[68 + len(covered) :]


@pytest.mark.skipif(not ATTACK.is_file(), reason="the streams of attackers are not here")
def test_the_stream_of_an_attacker_leaves_no_trace_of_its_fault():
    data = with_quantisers_renamed(ATTACK.read_bytes())
    for run in runs_beside_faults(Random(1), data):
        assert by_codec(data, run) == by_oracle(data, run)
    assert by_oracle(data, BESIDE).code == "E_RANGE"


# --- the harness ----------------------------------------------------------------------------------


def trial(tmp_path, decoder, *options):
    """(exit code, report) of a trial on the vectors of this family."""
    report = tmp_path / "report.json"
    command = ["run", "--decoder", shlex.join([sys.executable, *decoder]), "--fresh", "0"]
    command += ["--family", "fault-states", "--again", "2", "--json", str(report), *options]
    code = main(command)
    found = json.loads(report.read_text())
    assert errors(found, SCHEMA) == []
    return code, found


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*KEEPS, "stops-at-first-fault", "stops-at-fault-of-tile"])
def test_the_harness_names_what_is_wrong_beside_a_fault(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    decoder = ["-m", "conformance.mutants", "run", name]
    code, report = trial(tmp_path, decoder, "--env", "PYTHONPATH")
    assert code == 1
    assert {entry["kind"] for entry in report["results"]} == {"pass", "wrong dump"}
    assert name in [one["name"] for one in report["diagnosis"]["alike"] if one["share"] == 1]
    said = capsys.readouterr().out
    assert "a packet with a fault changed the state" in said
    assert "the state beside the fault: " in said


def test_a_decoder_that_does_not_know_the_option_is_not_asked_and_the_report_says_so(
    tmp_path, capsys
):
    old = ROOT / "conformance" / "harness" / "bad" / "__main__.py"
    decoder = [str(old), "of-before-dump-on-fault", str(VECTORS)]
    code, report = trial(tmp_path, decoder, "--family", "core")
    kinds = Counter(entry["kind"] for entry in report["results"])
    n = kinds["not asked"]
    assert (code, set(kinds)) == (0, {"pass", "not asked"})
    assert n == report["summary"]["families"]["fault-states"]["not asked"] > 50
    assert report["requirements"]["R-6.4-5"] == "untested"
    assert report["header"]["capabilities"]["dump_on_fault"] is False
    said = capsys.readouterr().out
    assert f"note: not asked: {n} with --dump-on-fault" in said
    assert f"; not asked: {n}" in said


# --- the fuzzer -----------------------------------------------------------------------------------


@pytest.mark.thorough
def test_most_late_faults_are_faults_of_packets_that_leave_a_state():
    codes, n = Counter[str](), 150
    for seed in range(n):
        base = random_stream(Random(f"late {seed}"))
        came = by_oracle(late_fault(Random(seed), base), BESIDE)
        codes[str(came.code)] += came.dump is not None
    codes.pop("None")
    assert codes.total() > 0.5 * n
    assert {"E_RANGE", "E_INDEX", "E_PACKET"} <= set(codes)
    assert codes["E_RANGE"] > 0.25 * n


def test_damage_to_late_checks_is_the_same_for_a_seed():
    base = random_stream(Random(4))
    damaged, again = ([late_fault(Random(seed), base) for seed in range(20)] for _ in range(2))
    assert damaged == again
    assert len(set(damaged)) > 5


@pytest.mark.thorough
def test_reference_and_oracle_have_the_same_states_beside_late_faults():
    verdicts, findings = fuzz.fuzz(20261122, 0, 40, "late-faults")
    assert findings == []
    assert sum(n for name, n in verdicts.items() if " 1 E_" in name) > 40


@pytest.mark.thorough
@pytest.mark.parametrize("name", KEEPS)
def test_a_decoder_that_keeps_what_a_packet_with_a_fault_wrote_is_found(name):
    def decode(data: bytes, run: Run) -> Outcome:
        return by_oracle(data, run, load(NAMED[name]))

    for seed in range(800):
        rng = Random(f"beside {seed}")
        base = random_stream(rng)
        if name.startswith("p") and not base[19] & 1:
            continue  # it has no palette
        data = late_fault(rng, base)
        if any(check(data, run, decode=decode)[1] for run in runs_beside_faults(rng, data)):
            return
    raise AssertionError("not found")
