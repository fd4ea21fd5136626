"""Every requirement and every fault code has a vector, or a reason why not."""

import csv
import json
from pathlib import Path

from conformance.generator.generate import DOCS, VECTORS
from conformance.generator.matrix import pages
from conformance.generator.traceability import fault_codes, limitations, requirements_of

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENTS = requirements_of(ROOT)
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
VECTORS_AND_FAMILIES = MANIFEST["vectors"] + MANIFEST["families"]
EXERCISED = {name for entry in VECTORS_AND_FAMILIES for name in entry["requirements"]}
REFUSED = [entry for entry in MANIFEST["vectors"] if entry["runs"][0]["exit"] in (1, 4, 127)]


def test_the_requirements_of_the_text_are_found():
    assert len(REQUIREMENTS) > 80
    assert {role for role, _ in REQUIREMENTS.values()} == {"stream", "decoder", "encoder"}


def test_every_requirement_is_exercised_or_listed_with_a_reason():
    reasons = limitations(ROOT)
    assert set(REQUIREMENTS) == EXERCISED | set(reasons)
    assert not EXERCISED & set(reasons)
    assert all(len(reason) > 40 for reason in reasons.values())


def test_encoder_requirements_are_not_asked_of_decoders():
    encoders = {name for name, (role, _) in REQUIREMENTS.items() if role == "encoder"}
    assert not encoders & EXERCISED


def test_places_where_limitations_are_tested_exist():
    for reason in limitations(ROOT).values():
        path = reason.partition("`tests/")[2].partition("`")[0]
        assert (ROOT / "tests" / path).is_file()


def test_every_requirement_on_streams_has_a_vector_that_breaks_it_and_one_that_keeps_it():
    broken = {name for entry in REFUSED for name in entry["requirements"]}
    kept = EXERCISED - {"R-4.4-1", "R-5.1-1", "R-5.1-2", "R-5.10-4"}  # kept by every legal vector
    accepted = {
        name
        for entry in MANIFEST["vectors"]
        if entry["runs"][0]["exit"] == 0
        for name in entry["requirements"]
    }
    for name, (role, _) in REQUIREMENTS.items():
        if role == "stream":
            assert name in broken
            assert name in accepted or name not in kept


def test_every_fault_code_has_a_vector_that_is_refused_with_it():
    assert {entry["runs"][0]["code"] for entry in REFUSED} == set(fault_codes(ROOT))


def test_a_fault_belongs_to_a_requirement_that_names_it():
    """The code of a refused vector is one that the text gives to one of its requirements."""
    for entry in REFUSED:
        texts = " ".join(REQUIREMENTS[name][1] for name in entry["requirements"])
        binds_decoders = any(REQUIREMENTS[n][0] == "decoder" for n in entry["requirements"])
        assert entry["runs"][0]["code"] in texts or binds_decoders, entry["id"]


def test_vectors_name_only_requirements_and_sections_of_the_text():
    text = (ROOT / "spec" / "evogs.md").read_text(encoding="utf-8")
    assert set(REQUIREMENTS) >= EXERCISED
    for section in {section for entry in MANIFEST["vectors"] for section in entry["sections"]}:
        assert f"\n### {section} " in text or f"\n## {section}. " in text, section


def test_the_pages_about_vectors_are_those_of_the_manifest():
    made = pages(MANIFEST["vectors"], REQUIREMENTS)
    for name, text in made.items():
        assert (DOCS / name).read_text(encoding="utf-8") == text
    assert all(f"| {name} |" in made["conformance-matrix.md"] for name in REQUIREMENTS)


def test_the_tables_have_a_row_for_every_vector_and_every_mutant():
    made = pages(MANIFEST["vectors"], REQUIREMENTS)
    vectors = list(csv.DictReader(made["conformance-vectors.csv"].splitlines()))
    assert [row["vector"] for row in vectors] == [v["id"] for v in MANIFEST["vectors"]]
    mutants = list(csv.DictReader(made["conformance-mutants.csv"].splitlines()))
    fingerprints = json.loads((VECTORS / "fingerprints.json").read_text(encoding="utf-8"))
    assert {row["mutant"] for row in mutants} == set(fingerprints)
    assert all(int(row["vectors_that_kill_it"]) > 0 for row in mutants)


def test_a_person_can_read_the_matrix():
    page = pages(MANIFEST["vectors"], REQUIREMENTS)["conformance-matrix.md"]
    assert max(map(len, page.splitlines())) < 300
