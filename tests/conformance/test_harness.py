"""The harness: its verdicts, what it refuses to conclude, its reports."""

import ast
import fnmatch
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest

from conformance.harness.cli import main
from conformance.harness.judging.judging import KINDS
from conformance.harness.running import process
from conformance.harness.running.capabilities import Capabilities
from conformance.harness.running.keepers import Keeper
from conformance.harness.selftest import BAD
from tests.conformance import tiny
from tests.conformance.schemas import errors
from tests.conformance.tiny import EXAMPLE, ROOT

SCHEMA = json.loads((ROOT / "conformance/harness/reporting/report.schema.json").read_text())
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


@pytest.mark.parametrize(
    ("says", "asked", "code"),
    [
        ("ModuleNotFoundError: No module named 'zstandard'", [], 0),
        ("ModuleNotFoundError: No module named 'zstandard'", ["--fresh", "3"], 3),
        ("DisagreementError: oracle and codec", [], 3),
    ],
)
def test_fresh_vectors_may_be_lacking_but_not_fail(
    suite_folder, tmp_path, monkeypatch, capsys, says, asked, code
):
    change(suite_folder, lambda told: told.update(families=[]))
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\necho "{says}" >&2\nexit 1\n')
    python.chmod(0o755)
    decoder = ["--decoder", bad("right in batches", suite_folder), "--vectors", str(suite_folder)]
    monkeypatch.setattr(sys, "executable", str(python))
    assert main(["run", *decoder, "--again", "1", *asked]) == code
    assert "no fresh vectors" in capsys.readouterr().out


def test_a_command_that_cannot_be_started_fails(made_suite, capsys):
    options = ["--vectors", str(made_suite), "--fresh", "0"]
    assert main(["run", "--decoder", "/nowhere/decoder", *options]) == 1
    assert "cannot be started" in capsys.readouterr().out


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


@pytest.mark.thorough
def test_a_claim_is_made_only_of_a_whole_suite(made_suite, tmp_path):
    path = tmp_path / "r.json"
    folder = shutil.copytree(made_suite, tmp_path / "suite")
    change(folder, lambda told: told.update(families=[]))
    assert run(folder, "right in batches", "--json", str(path)) == 0
    report = json.loads(path.read_text())
    assert report["footer"]["complete"]
    assert report["claim"].startswith(
        "right 0 decodes EvoGS 1.0-draft 5 (file, progressive) to tier 3"
    )
    assert run(folder, "right", "--quick", "--json", str(path)) == 0
    assert json.loads(path.read_text())["claim"] is None


def test_what_a_decoder_says_does_not_get_into_the_page_as_markup(made_suite, tmp_path):
    from conformance.harness.reporting.page import _embedded

    assert "</script>" not in _embedded({"says": "</script><script>alert(1)</script>"})


def test_parts_of_the_suite_are_selected_by_family_and_pattern(made_suite, tmp_path):
    path = tmp_path / "r.json"
    assert run(made_suite, "right", "--id", "c*-of-*", "--json", str(path)) == 0
    ids = {entry["id"] for entry in json.loads(path.read_text())["results"]}
    assert ids == {"crc-of-a-packet#0", "crc-of-a-packet#1", "canary-critical#0"} | {
        "canary-ancillary#0"
    }


# --- the texts ------------------------------------------------------------------------------------


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


def test_the_first_decoder_of_the_guide_is_asked_and_judged(made_suite, tmp_path):
    text = (ROOT / "docs" / "implementers-guide.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    path, report = tmp_path / "decoder.py", tmp_path / "report.json"
    path.write_text(program)
    options = ["--vectors", str(made_suite), "--quick", "--fresh", "0", "--json", str(report)]
    assert main(["run", "--decoder", shlex.join([sys.executable, str(path)]), *options]) == 1
    kinds = {entry["id"]: entry["kind"] for entry in json.loads(report.read_text())["results"]}
    assert kinds["core-example#0"] == "wrong verdict"
    assert kinds["core-example#3"] == "skipped"
    assert kinds["crc-of-a-packet#0"] == "pass"
    assert set(kinds.values()) == {"wrong verdict", "skipped", "not asked", "pass"}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="looks at memory in /proc")
def test_the_memory_counted_is_that_of_the_decoder_and_not_of_the_harness(tmp_path):
    ours = b"x" * (200 << 20)
    command = [
        sys.executable,
        "-I",
        "-S",
        "-c",
        "x = b'x' * (40 << 20); import time; time.sleep(1)",
    ]
    ended = process.run(
        command,
        tmp_path,
        process.clean_environment(tmp_path),
        process.Bounds(),
    )
    assert 40 << 20 < ended.peak < 100 << 20 < len(ours)


@pytest.mark.thorough
def test_an_interrupt_ends_what_was_started(made_suite, tmp_path):
    command = [sys.executable, "-m", "conformance.harness", "run", "--decoder"]
    command += [bad("hang", made_suite), "--vectors", str(made_suite), "--fresh", "0"]
    with subprocess.Popen(
        [*command, "--timeout", "5"],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # What a shell starts in the background ignores interrupts, and so would this.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:
        time.sleep(1.5)
        running.send_signal(signal.SIGINT)
        assert running.wait(30) != 0
    deadline = time.monotonic() + 5
    while _asked_about(made_suite) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _asked_about(made_suite)


@pytest.mark.parametrize("starts", [True, False])
def test_an_interrupt_while_a_process_starts_leaves_none(starts, tmp_path, monkeypatch):
    used = []

    def begin(keeper, *args):
        signal.raise_signal(signal.SIGINT)
        used.append(keeper)
        if not starts:
            raise OSError("no more processes")
        begin_as_usual(keeper, *args)
        assert keeper.processes()

    begin_as_usual = Keeper.start
    command = [sys.executable, "-c", "import time; time.sleep(60)"]
    # What a shell starts in the background ignores interrupts, and so would this.
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    with monkeypatch.context() as patched:
        patched.setattr(Keeper, "start", begin)
        try:
            with pytest.raises(KeyboardInterrupt):
                process.Watched(command, tmp_path, os.environ, process.Bounds(), files=(0, 1, 2))
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        finally:
            signal.signal(signal.SIGINT, usual)
    assert [keeper.processes() for keeper in used] == [[]]


def _asked_about(folder):
    """Decoders still running, of those that were given this folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().split(b"\0")
        except OSError:
            continue
        if str(folder).encode() in words and b"hang" in words:
            found.append(words)
    return found
