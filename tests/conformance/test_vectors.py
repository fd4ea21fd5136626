"""The committed vectors: what the manifest says of them, and that recipes make them as they are."""

import hashlib
import json
import subprocess
import sys
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from conformance.decoders.outcomes import Outcome
from conformance.generator.generate import (
    KEPT,
    REDUNDANT,
    VECTORS,
    collect,
    differing,
    differing_outcomes,
    files_of,
    make_all,
    stored_fingerprints,
)
from conformance.generator.suite import ZSTD, DisagreementError, Vector, agreed
from conformance.mutants import MUTANTS
from tests.conformance.schemas import errors

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
SCHEMA = json.loads((VECTORS / "manifest.schema.json").read_text(encoding="utf-8"))
FINGERPRINTS = stored_fingerprints()
BY_ID = {entry["id"]: entry for entry in MANIFEST["vectors"]}
MAX_FOLDER, MAX_VECTOR = 6 << 20, 1 << 17


@pytest.fixture(scope="module")
def made() -> list[Vector]:
    return make_all()


def test_the_manifest_keeps_its_schema():
    assert errors(MANIFEST, SCHEMA) == []


@pytest.mark.parametrize(
    "damage",
    [
        lambda m: m.pop("zstd"),
        lambda m: m["vectors"][0].pop("kills"),
        lambda m: m["vectors"][0].update(more=1),
        lambda m: m["vectors"][0]["runs"][0].update(exit=2),
        lambda m: m["vectors"][0]["runs"][0].update(dump="0"),
        lambda m: m["families"][0].pop("dumps"),
    ],
)
def test_the_schema_refuses_what_is_missing_unknown_or_none(damage):
    manifest = json.loads(json.dumps(MANIFEST | {"vectors": MANIFEST["vectors"][:3]}))
    assert not errors(manifest, SCHEMA)
    damage(manifest)
    assert errors(manifest, SCHEMA)


def test_the_page_of_results_counts_vectors_runs_and_mutants():
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    n_runs = sum(len(entry["runs"]) for entry in MANIFEST["vectors"])
    n_mutants = f"{len(MUTANTS):,}"
    assert f"| vectors, runs of them | {len(MANIFEST['vectors']):,}, {n_runs:,};" in text
    assert f" killed by the vectors | {n_mutants} of {n_mutants} |" in text


@pytest.mark.thorough
def test_the_vectors_are_made_anew_to_the_byte(made):
    if MANIFEST["zstd"] == ZSTD:
        assert differing(files_of(made, mutants=False)) == []
    else:
        assert differing_outcomes(made) == []


@pytest.mark.thorough
def test_under_another_libzstd_outcomes_are_compared(made):
    assert differing_outcomes(made) == []
    n_runs = len(made[0].case.runs)
    other = replace(made[0], outcomes=(Outcome(1, "E_CRC", 0),) * n_runs)
    assert differing_outcomes([other, *made[1:]]) == [f"{other.id} differs"]
    assert differing_outcomes(made[1:]) == [f"{other.id} differs"]


def test_there_are_at_least_500_vectors_in_a_small_folder():
    assert len(BY_ID) == len(MANIFEST["vectors"]) >= 500
    files = (path for path in VECTORS.rglob("*") if path.is_file())
    assert sum(path.stat().st_size for path in files) < MAX_FOLDER
    assert max(entry["size"] for entry in MANIFEST["vectors"]) < MAX_VECTOR


def test_files_and_goldens_are_those_of_the_manifest_and_no_others():
    named = {*KEPT, "manifest.json", "fingerprints.json"}
    for entry in MANIFEST["vectors"]:
        data = (VECTORS / entry["file"]).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (entry["size"], entry["sha256"])
        named.add(entry["file"])
    dumps = {run["dump"] for entry in MANIFEST["vectors"] for run in entry["runs"]}
    dumps |= {dump for family in MANIFEST["families"] for dump in family.get("dumps", ())}
    for dump in dumps - {None}:
        packed = (VECTORS / "goldens" / f"{dump[:16]}.z").read_bytes()
        assert hashlib.sha256(zlib.decompress(packed)).hexdigest() == dump
        named.add(f"goldens/{dump[:16]}.z")
    there = {str(path.relative_to(VECTORS)) for path in VECTORS.rglob("*") if path.is_file()}
    assert there == named


def test_no_two_vectors_are_the_same_file_asked_the_same():
    keys = Counter((e["sha256"], json.dumps(e["runs"])) for e in MANIFEST["vectors"])
    assert [key for key, n in keys.items() if n > 1] == []


def test_no_two_vectors_say_that_they_test_the_same():
    says = Counter((e["family"], e["tests"]) for e in MANIFEST["vectors"])
    assert [pair for pair, n in says.items() if n > 1] == []


def test_no_two_vectors_have_the_same_requirements_and_show_the_same_wrong_decoders():
    keys = Counter((*sorted(e["requirements"]), *sorted(e["kills"])) for e in MANIFEST["vectors"])
    assert [key for key, n in keys.items() if n > 1] == []


def test_a_case_that_is_left_out_names_a_vector():
    left_out = json.loads(REDUNDANT.read_text(encoding="utf-8"))
    assert not left_out.keys() & BY_ID.keys()
    assert set(left_out.values()) <= BY_ID.keys()


def test_every_vector_tells_a_wrong_decoder_from_a_right_one():
    assert [entry["id"] for entry in MANIFEST["vectors"] if not entry["kills"]] == []


def test_every_wrong_decoder_of_the_library_is_shown():
    assert list(FINGERPRINTS) == [mutant.name for mutant in MUTANTS]
    survivors = [n for n, found in FINGERPRINTS.items() if not found["outcomes"] | found["codes"]]
    assert survivors == []


def test_kills_follow_from_the_fingerprints():
    told: dict[str, set[str]] = {name: set() for name in BY_ID}
    for name, found in FINGERPRINTS.items():
        for run in (*found["outcomes"], *found["codes"]):
            told[run.partition("#")[0]].add(name)
    assert told == {entry["id"]: set(entry["kills"]) for entry in MANIFEST["vectors"]}


def test_every_refused_vector_has_a_legal_twin():
    for entry in MANIFEST["vectors"]:
        if entry["runs"][0]["exit"] in (0, 3):
            assert entry["near_miss_of"] is None
        else:
            assert BY_ID[entry["near_miss_of"]]["runs"][0]["exit"] == 0, entry["id"]


def test_one_scene_written_in_many_ways_has_one_dump():
    dumps: dict[bool, set[str]] = {False: set(), True: set()}
    for entry in MANIFEST["vectors"]:
        if entry["family"] == "metamorphic":
            is_doubled = entry["id"].startswith("metamorphic-quantisers-")
            dumps[is_doubled] |= {run["dump"] for run in entry["runs"]}
    assert [len(found) for found in dumps.values()] == [1, 1]


def test_only_progressive_runs_are_incomplete_and_only_dumps_are_accepted():
    for entry in MANIFEST["vectors"]:
        for run in entry["runs"]:
            assert run["exit"] != 3 or run["mode"] == "progressive"
            assert run["mode"] == "progressive" or run["arrival"] is None
            is_beside = run.get("dump_on_fault", False)
            assert not is_beside or run["mode"] == "progressive"
            may_have_dump = run["exit"] == 3 or (run["exit"] == 1 and is_beside)
            assert (run["dump"] is not None) == (run["exit"] == 0) or may_have_dump
            assert (run["code"] is None) == (run["exit"] in (0, 3)) == (run["offset"] is None)


@pytest.mark.thorough
def test_recipes_are_deterministic(made):
    assert [case.data for _, _, case in collect()] == [one.case.data for one in made]


def test_no_golden_without_agreement(monkeypatch):
    family, provenance, case = next(collect())
    monkeypatch.setattr("conformance.decoders.reference.by_codec", lambda data, run: Outcome(4))
    with pytest.raises(DisagreementError, match="oracle 0"):
        agreed(case.data, case.runs[0])
    monkeypatch.setattr(
        "conformance.generator.generate.collect", lambda: [(family, provenance, case)]
    )
    with pytest.raises(DisagreementError, match=f"{family}-{case.name}"):
        make_all()


def test_a_recipe_that_expects_another_verdict_or_twin_is_a_finding(monkeypatch):
    family, provenance, case = next(collect())
    wrong = [
        (family, provenance, type(case)(**{**vars(case), **change}))
        for change in ({"expect": "E_CRC"}, {"twin": "core-none"})
    ]
    monkeypatch.setattr("conformance.generator.generate.collect", lambda: wrong)
    with pytest.raises(DisagreementError) as found:
        make_all()
    assert str(found.value).splitlines() == [
        f"core-{case.name}: None, the recipe expected E_CRC",
        f"core-{case.name}: two vectors of this id",
        f"core-{case.name}: no legal vector core-none",
    ]


def fresh(folder: Path, seed: int, count: int) -> dict[str, bytes]:
    command = [sys.executable, "-m", "conformance.fuzzing.fresh", "--seed", str(seed)]
    command += ["--count", str(count), "--out", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.thorough
def test_fresh_vectors_are_a_suite_that_follows_from_the_seed(tmp_path):
    files, again, other = (fresh(tmp_path / str(k), 5 + (k == 2), 12) for k in range(3))
    assert files == again != other
    manifest = json.loads(files["manifest.json"])
    assert errors(manifest, SCHEMA) == []
    assert len(manifest["vectors"]) == 12
    assert {entry["runs"][0]["exit"] == 0 for entry in manifest["vectors"]} == {True, False}
    for entry in manifest["vectors"]:
        assert hashlib.sha256(files[entry["file"]]).hexdigest() == entry["sha256"]
        for run in entry["runs"]:
            if run["dump"] is not None:
                dump = zlib.decompress(files[f"goldens/{run['dump'][:16]}.z"])
                assert hashlib.sha256(dump).hexdigest() == run["dump"]
