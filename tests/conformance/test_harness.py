"""The harness: its verdicts, what it refuses to conclude, its reports."""

import ast
import fnmatch
import hashlib
import json
import re
import shlex
import shutil
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from conformance.harness import manifest
from conformance.harness.answers import Answer, AnswerError, read_entry, read_fault
from conformance.harness.canary import canaries
from conformance.harness.capabilities import Capabilities
from conformance.harness.cli import main
from conformance.harness.diagnosis import Fingerprint, likenesses
from conformance.harness.dumps import channel_name, difference
from conformance.harness.families import expand
from conformance.harness.judging import KINDS, judge
from conformance.harness.selftest import BAD
from tests.conformance import tiny
from tests.conformance.schemas import errors
from tests.conformance.tiny import EXAMPLE, ROOT

SCHEMA = json.loads((ROOT / "conformance/harness/report.schema.json").read_text())
VECTORS = ROOT / "conformance" / "vectors" / "manifest.json"
HARNESS = ROOT / "conformance" / "harness"
PROVEN = sys.stdlib_module_names


def bad(name, folder):
    """The command of a bad decoder."""
    name = name.partition(" ")[0]
    return shlex.join([sys.executable, "-I", "-S", str(BAD / "__main__.py"), name, str(folder)])


def run(folder, name="right", *options):
    """Exit code of a trial of a bad decoder."""
    decoder = ["--decoder", bad(name, folder), "--vectors", str(folder)]
    return main(["run", *decoder, "--fresh", "0", "--jobs", "2", "--again", "2", *options])


def cases_of(folder):
    return {case.id: case for case in manifest.load(folder).cases()}


# --- the rule it stands on ------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(HARNESS.rglob("*.py")), ids=lambda path: path.stem)
def test_the_harness_imports_nothing_but_the_standard_library_and_itself(path):
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            found.add(str(node.module))
    ours = {name for name in found if name.split(".")[0] == "conformance"}
    assert all(name.startswith("conformance.harness") for name in ours)
    assert {name.split(".")[0] for name in found - ours} <= PROVEN | {"__future__"}


def test_the_harness_runs_where_nothing_is_installed(made_suite):
    program = [sys.executable, "-I", "-S", "-c"]
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); from conformance.harness.cli import main"
    )
    code += "; sys.exit(main(sys.argv[1:]))"
    options = ["run", "--decoder", bad("right", made_suite), "--vectors", str(made_suite)]
    options += ["--fresh", "0", "--family", "core"]
    done = subprocess.run([*program, code, *options], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "PASS" in done.stdout


# --- verdicts -------------------------------------------------------------------------------------


def verdict(folder, case_id, answer, lacking=(), codes=True):
    suite = manifest.load(folder)
    case = cases_of(folder)[case_id]
    return judge(case, answer, list(lacking), suite.golden, codes=codes)


def golden_of(folder, case_id):
    suite = manifest.load(folder)
    return suite.golden(cases_of(folder)[case_id].run.dump)


@pytest.mark.parametrize(
    ("case_id", "answer", "kind"),
    [
        ("core-example#0", Answer(0), "wrong dump"),
        ("core-example#0", Answer(1, code="E_CRC", offset=0), "wrong verdict"),
        ("core-example#0", Answer(127), "wrong verdict"),
        ("core-example#0", Answer(None, trouble="crash", detail="SIGSEGV"), "crash"),
        ("crc-of-a-packet#0", Answer(1, code="E_CRC", offset=457), "pass"),
        ("crc-of-a-packet#0", Answer(1, output=b"", code="E_CRC", offset=457), "pass"),
        ("crc-of-a-packet#0", Answer(1, code="E_CRC", offset=0), "wrong code"),
        ("crc-of-a-packet#0", Answer(1), "wrong code"),
        ("crc-of-a-packet#0", Answer(1, output=b"x", code="E_CRC", offset=457), "stray output"),
        ("crc-of-a-packet#0", Answer(0), "wrong verdict"),
        ("crc-of-a-packet#0", Answer(4), "wrong verdict"),
        ("core-example#7", Answer(4, code="E_LIMIT", offset=207), "pass"),
        ("critical-chunk#0", Answer(127, code="E_UNSUPPORTED", offset=64), "pass"),
        ("critical-chunk#0", Answer(1, code="E_UNSUPPORTED", offset=64), "wrong verdict"),
    ],
)
def test_an_answer_gets_the_verdict(made_suite, case_id, answer, kind):
    result = verdict(made_suite, case_id, answer)
    assert result.kind == kind, result.says
    assert kind in KINDS
    assert result.failed == (kind != "pass")


def test_codes_are_judged_only_of_decoders_that_declare_them(made_suite):
    assert verdict(made_suite, "crc-of-a-packet#0", Answer(1), codes=False).kind == "pass"


def test_a_run_is_skipped_only_if_the_feature_is_declared_missing_and_127_is_answered(made_suite):
    lacking = ["progressive mode"]
    assert verdict(made_suite, "core-example#3", Answer(127), lacking).kind == "skipped"
    assert verdict(made_suite, "core-example#3", Answer(127)).kind == "wrong verdict"
    assert verdict(made_suite, "core-example#3", Answer(1), lacking).kind == "wrong verdict"
    dump = golden_of(made_suite, "core-example#3")
    assert verdict(made_suite, "core-example#3", Answer(0, dump), lacking).kind == "pass"
    assert verdict(made_suite, "core-example#3", Answer(127, dump), lacking).failed


# --- where a dump is wrong ------------------------------------------------------------------------


def changed(dump, at, value):
    return dump[:at] + value + dump[at + len(value) :]


def test_a_wrong_dump_is_told_by_level_tile_slot_and_channel(made_suite):
    dump = golden_of(made_suite, "core-example#2")
    at = 16 + 28 + 4 + 4 * (7 * 4 + 1)  # channel 7, slot 1 of 4
    wrong = Answer(0, changed(dump, at, (-149).to_bytes(4, "little", signed=True)))
    says = verdict(made_suite, "core-example#2", wrong).says
    assert says.startswith("level 1, tile 0, slot 1, channel 7 scale x: -149, not -150")
    assert "1 of 56 integers" in says


def test_usual_mistakes_of_dumps_are_named(made_suite):
    dump = golden_of(made_suite, "core-example#0")
    assert difference(dump, dump) == ""
    assert difference(b"", dump) == "the dump is empty"
    assert "not even" in difference(dump[:9], dump)
    assert "right as far as they go" in difference(dump[:-1], dump)
    assert difference(dump + b"xy", dump) == "2 bytes follow the dump"
    assert "magic is 45 56 47 58" in difference(changed(dump, 3, b"X"), dump)
    assert "n_tiles is 0, not 1" in difference(changed(dump, 12, bytes(4)), dump)
    assert "3 slots, not 4" in difference(changed(dump, 40, b"\3"), dump)
    assert "origin" in difference(changed(dump, 16, b"\1"), dump)
    assert "slot 2: the live byte is 1, not 0" in difference(changed(dump, 46, b"\1"), dump)
    assert "ends at byte" in difference(changed(dump, 40, b"\xff"), dump)
    body = dump[48:]
    integers = [body[at : at + 4] for at in range(0, len(body), 4)]
    swapped = b"".join(integer[::-1] for integer in integers)
    assert "big-endian" in difference(dump[:48] + swapped, dump)
    turned = b"".join(integers[c * 4 + s] for s in range(4) for c in range(14))
    assert "slot by slot" in difference(dump[:48] + turned, dump)
    assert "another order" in difference(dump[:48] + b"".join(reversed(integers)), dump)


def test_channels_have_the_names_of_the_spec():
    assert [channel_name(c) for c in (0, 6, 10)] == ["position x", "rotation z", "opacity"]
    assert channel_name(11) == "SH 0 R (band 0)"
    assert channel_name(11 + 3 * 9 + 2) == "SH 9 B (band 3)"


# --- the contract's lines -------------------------------------------------------------------------


def test_lines_of_the_contract_are_read_strictly():
    assert read_fault('{"code": "E_CRC", "offset": 371}\n') == ("E_CRC", 371)
    assert read_entry(b'{"id": 5, "exit": 3}', 5) == (3, None, None)
    for line in ("", "\n", "[]", "{", '{"code": 1}', '{"why": ""}', "{}\n{}", '{"offset": true}'):
        with pytest.raises(AnswerError):
            read_fault(line)
    for entry in (b'{"id": 4, "exit": 0}', b'{"exit": 0}', b'{"id": 5}', b"[5, 0]", b"\xff"):
        with pytest.raises(AnswerError):
            read_entry(entry, 5)
    for status in ("2", "true", "-11", '"0"'):
        with pytest.raises(AnswerError, match="means nothing"):
            read_entry(b'{"id": 5, "exit": %s}' % status.encode(), 5)


# --- no vacuous pass ------------------------------------------------------------------------------


def test_a_right_decoder_passes(made_suite, capsys):
    assert run(made_suite, "right", "--family", "core", "--family", "crc") == 0
    assert "PASS: the decoder is right in all runs of this selection" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: (folder / "manifest.json").unlink(), "manifest.json"),
        (lambda folder: (folder / "manifest.json").write_text("{}"), "no list of vectors"),
        (lambda folder: next((folder / "goldens").iterdir()).unlink(), "golden"),
        (
            lambda folder: next((folder / "goldens").iterdir()).write_bytes(b"x"),
            "golden",
        ),
        (
            lambda folder: (folder / "core" / "core-example.evogs").write_bytes(EXAMPLE[:-1]),
            "is not the file of the manifest",
        ),
        (lambda folder: (folder / "core" / "core-example.evogs").unlink(), "No such file"),
        (lambda folder: change(folder, lambda m: m.update(extra=1)), "unknown keys extra"),
        (lambda folder: change(folder, lambda m: m["vectors"][0].update(weight=1)), "weight"),
        (lambda folder: change(folder, lambda m: m["vectors"][0].pop("tests")), "tests"),
        (lambda folder: change(folder, lambda m: m["vectors"][0].update(runs=[])), "no runs"),
        (lambda folder: change(folder, lambda m: m["vectors"][0]["runs"][0].update(x=1)), "x"),
        (lambda folder: change(folder, lambda m: m["vectors"][0]["runs"][0].update(exit=2)), "2"),
        (
            lambda folder: change(folder, lambda m: m["vectors"][0]["runs"][0].update(dump=None)),
            "no dump",
        ),
        (lambda folder: change(folder, lambda m: m.update(vectors=[], families=[])), "nothing was"),
        (
            lambda folder: change(folder, lambda m: m.update(vectors=m["vectors"] * 2)),
            "two vectors",
        ),
        (
            lambda folder: change(folder, lambda m: m["families"][0].update(rule="every")),
            "not known",
        ),
        (lambda folder: change(folder, lambda m: m["families"][0].pop("dumps")), "missing"),
        (
            lambda folder: change(folder, lambda m: m["families"][0]["dumps"].pop()),
            "each number of packets",
        ),
    ],
)
def test_a_damaged_suite_lets_nobody_pass(suite_folder, capsys, damage, words):
    damage(suite_folder)
    assert run(suite_folder) == 3
    said = capsys.readouterr().out
    assert "INCOMPLETE" in said
    assert words in said
    assert "PASS" not in said


def change(folder, edit):
    told = tiny.read_manifest(folder)
    edit(told)
    (folder / "manifest.json").write_text(json.dumps(told))


def test_nothing_selected_is_no_pass(made_suite, capsys):
    assert run(made_suite, "right", "--id", "no-such-*") == 3
    assert "nothing was asked" in capsys.readouterr().out


def test_all_skipped_is_no_pass(suite_folder, capsys):
    def keep_progressive(told):
        entry = told["vectors"][0]
        kept = [run for run in entry["runs"] if run["mode"] == "progressive"]
        told["vectors"] = [entry | {"runs": [*kept, entry["runs"][0]]}]
        told["families"] = []

    change(suite_folder, keep_progressive)
    assert run(suite_folder, "modest") == 0
    capsys.readouterr()
    change(suite_folder, lambda told: told["vectors"][0]["runs"].pop())
    assert run(suite_folder, "modest") == 3
    assert "canaries cannot be made" in capsys.readouterr().out


def test_fresh_vectors_that_were_asked_for_and_cannot_be_made_are_no_pass(made_suite, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    command = ["--decoder", "true", "--vectors", str(made_suite), "--fresh", "3"]
    assert main(["run", *command]) == 3


def test_a_command_that_cannot_be_started_fails(made_suite, capsys):
    assert main(["run", "--decoder", "/nowhere/decoder", "--vectors", str(made_suite)]) == 1
    assert "cannot be started" in capsys.readouterr().out


# --- families and canaries ------------------------------------------------------------------------


def test_families_expand_to_every_prefix_and_every_bit(made_suite):
    cases = list(expand(manifest.load(made_suite)))
    ids = [case.id for case in cases]
    assert len(set(ids)) == len(ids) == 2 * 519 + 1 + 8 * 519
    by_id = dict(zip(ids, cases, strict=True))
    for size, offset in ((0, 0), (63, 0), (64, 64), (370, 64), (371, 371), (457, 457), (518, 457)):
        case = by_id[f"prefix-example@{size}#0"]
        assert (case.run.code, case.run.offset) == ("E_TRUNCATED", offset)
        assert case.data == EXAMPLE[:size]
    assert by_id["prefix-example@370#1"].run.dump is None
    assert by_id["prefix-example@371#1"].run.exit == 3
    assert by_id["prefix-example@519#1"].run.exit == 0
    assert by_id["flip-example@8#0"].data[1] == EXAMPLE[1] ^ 1


def test_canaries_are_new_each_time_and_the_same_for_a_seed(made_suite):
    suite = manifest.load(made_suite)
    critical, ancillary = canaries(suite, 1)
    assert (critical.run.exit, ancillary.run.exit) == (127, 0)
    assert critical.data != canaries(suite, 2)[0].data
    assert critical.data == canaries(suite, 1)[0].data
    assert critical.data[64:65].isupper()
    assert ancillary.data[64:65].islower()


# --- diagnosis ------------------------------------------------------------------------------------


def results_of(folder, answers):
    """Results of the cases with right answers but for some."""
    suite = manifest.load(folder)
    results = []
    for case in suite.cases():
        run = case.run
        dump = None if run.dump is None else suite.golden(run.dump)
        answer = answers.get(case.id, Answer(run.exit, dump, run.code, run.offset))
        results.append(judge(case, answer, [], suite.golden, codes=True))
    return results


def test_a_decoder_is_told_which_known_wrong_one_it_looks_like(made_suite):
    dump = golden_of(made_suite, "core-example#2")
    wrong = Answer(0, dump[:-4] + bytes(4))
    answers = {"core-example#0": wrong, "core-example#2": wrong}
    results = results_of(made_suite, answers)
    text = "0:" + hashlib.sha256(wrong.output or b"").hexdigest()[:12]
    both = {"core-example#0": text, "core-example#2": text}
    fingerprints = {
        "off": Fingerprint("one thing", both, {}),
        "near": Fingerprint("another", {"core-example#0": text}, {}),
        "far": Fingerprint("a third", {"crc-of-a-packet#0": "0:-"}, {}),
    }
    first, second = likenesses(results, fingerprints, codes=True)
    assert (first.name, first.share, second.name, second.share) == ("off", 1.0, "near", 0.5)
    assert "this looks like off: one thing (explains all wrong runs)" in first.sentence()
    assert "core-example#2, level 1, tile 0, slot 3" in first.sentence()
    assert likenesses(results_of(made_suite, {}), fingerprints, codes=True) == []


def test_codes_tell_wrong_decoders_apart_if_they_are_reported(made_suite):
    results = results_of(made_suite, {"crc-of-a-packet#0": Answer(1, code="E_ZSTD", offset=457)})
    crash = results_of(made_suite, {"core-example#0": Answer(None, trouble="timeout")})
    fingerprints = {
        "late": Fingerprint("checks late", {}, {"crc-of-a-packet#0": "E_ZSTD@457"}),
        "loop": Fingerprint("never ends", {"core-example#0": "crash"}, {}),
    }
    (found,) = likenesses(results, fingerprints, codes=True)
    assert (found.name, found.share) == ("late", 1.0)
    assert likenesses(results, fingerprints, codes=False) == []
    (found,) = likenesses(crash, fingerprints, codes=True)
    assert found.name == "loop"


# --- reports --------------------------------------------------------------------------------------


def test_reports_say_the_same_in_all_forms(made_suite, tmp_path, capsys):
    paths = {name: tmp_path / f"report.{name}" for name in ("json", "junit", "html")}
    options = [word for name, path in paths.items() for word in (f"--{name}", str(path))]
    selection = ["--family", "core", "--family", "crc", "--family", "critical"]
    assert run(made_suite, "last-off-by-one", *selection, "--seed", "5", *options) == 1
    text = capsys.readouterr().out
    assert "FAIL" in text
    assert "seed 5" in text
    report = json.loads(paths["json"].read_text())
    wrong = [entry["id"] for entry in report["results"] if entry["kind"] == "wrong dump"]
    assert "core-example#0" in wrong
    assert report["requirements"]["R-4.1-2"] == "fail"
    assert report["requirements"]["R-6.3-1"] == "fail"
    assert report["requirements"]["R-8.1-1"] == "pass"
    assert (report["claim"], report["footer"]["complete"]) == (None, False)
    assert errors(report, SCHEMA) == []
    root = ElementTree.fromstring(paths["junit"].read_text())
    failed = [
        test.get("name") for test in root.iter("testcase") if test.find("failure") is not None
    ]
    assert {"core-example", "crc-of-a-packet", "canary-ancillary"} == set(failed)
    assert root.get("tests") == str(len(list(root.iter("testcase"))))
    page = paths["html"].read_text()
    assert "core-example#0" in page
    assert "http" not in page.replace("http-equiv", "")


def test_a_report_of_a_trial_that_could_not_begin_is_a_report(tmp_path):
    path = tmp_path / "r.json"
    options = ["--vectors", str(tmp_path), "--json", str(path), "--html", str(tmp_path / "r.html")]
    options += ["--junit", str(tmp_path / "r.xml")]
    assert main(["run", "--decoder", "true", *options]) == 3
    report = json.loads(path.read_text())
    assert errors(report, SCHEMA) == []
    assert report["footer"] == report["footer"] | {"exit": 3, "complete": False}
    assert errors(report | {"more": 1}, SCHEMA) == ["$: unknown key more"]
    assert ElementTree.parse(tmp_path / "r.xml").getroot().get("errors") == "1"


def test_a_claim_is_made_only_of_a_whole_suite(made_suite, tmp_path):
    path = tmp_path / "r.json"
    folder = shutil.copytree(made_suite, tmp_path / "suite")
    change(folder, lambda told: told.update(families=[]))
    assert run(folder, "right in batches", "--json", str(path)) == 0
    report = json.loads(path.read_text())
    assert report["footer"]["complete"]
    assert report["claim"].startswith(
        "right 0 decodes EvoGS 1.0-draft (file, progressive) to tier 3"
    )
    assert run(folder, "right", "--quick", "--json", str(path)) == 0
    assert json.loads(path.read_text())["claim"] is None


def test_what_a_decoder_says_does_not_get_into_the_page_as_markup(made_suite, tmp_path):
    from conformance.harness.page import _embedded

    assert "</script>" not in _embedded({"says": "</script><script>alert(1)</script>"})


def test_parts_of_the_suite_are_selected_by_family_and_pattern(made_suite, tmp_path):
    path = tmp_path / "r.json"
    assert run(made_suite, "right", "--id", "c*-of-*", "--json", str(path)) == 0
    ids = {entry["id"] for entry in json.loads(path.read_text())["results"]}
    assert ids == {"crc-of-a-packet#0", "crc-of-a-packet#1", "canary-critical#0"} | {
        "canary-ancillary#0"
    }


# --- the texts ------------------------------------------------------------------------------------


@pytest.mark.skipif(not VECTORS.is_file(), reason="no vectors are there")
@pytest.mark.parametrize("name", ["conformance/README.md", "docs/implementers-guide.md"])
def test_selections_in_the_texts_select_something(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    told = json.loads(VECTORS.read_text())
    ids = [entry["id"] for entry in told["vectors"]]
    families = {entry["family"] for entry in told["vectors"]}
    patterns = re.findall(r"--id '([^']+)'", text)
    assert all(fnmatch.filter(ids, pattern) for pattern in patterns), patterns
    named = re.findall(r"--family ([a-z-]+)", text)
    assert set(named) <= families, named


def test_the_texts_name_every_verdict_and_the_capabilities():
    text = (ROOT / "conformance" / "README.md").read_text(encoding="utf-8")
    assert all(f"`{kind}`" in text for kind in KINDS)
    (block,) = re.findall(r"```json\n(.*?)```", text, re.DOTALL)
    assert set(json.loads(block)) == set(Capabilities.__dataclass_fields__)
