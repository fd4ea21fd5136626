"""A decoder may say what it likes: its words harm no reader, and it is told what is wrong."""

import io
import json
import sys
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from conformance.harness.cli import main
from conformance.harness.runner import N_ALIKE
from conformance.harness.running.answers import AnswerError, read_entry, read_fault
from conformance.harness.running.plain import plain, read_json, say
from conformance.renders.cli import main as renders
from tests.conformance import tiny
from tests.conformance.test_harness import bad, run

# --- its words ------------------------------------------------------------------------------------

HOSTILE = "\ud800\x1b[2J\0\u202e\x85</script><script>alert(1)</script><b>]]>&\ufffe"


def test_what_is_not_printable_is_escaped_and_what_is_long_is_cut():
    assert plain("a b\té\x1b[2J\0\ud800\u202e\n") == r"a b\té\x1b[2J\x00\ud800\u202e\n"
    assert plain(b"\xff\xc3\xa9\x9b") == r"\xffé\x9b"
    assert plain("x" * 300) == "x" * 197 + "..."
    assert plain("\0" * 300, 20) == r"\x00\x00\x00\x00\..."
    assert plain(plain(HOSTILE)) == plain(HOSTILE)


def test_output_shows_what_its_coding_can(monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", out)
    say("é→x")
    assert out.buffer.getvalue() == rb"\xe9\u2192x" + b"\n"


@pytest.mark.parametrize(
    "raw",
    [
        b"[" * 60_000,
        b'{"a":' * 60_000,
        b'{"code": ' + b"[" * 20_000 + b"]" * 20_000 + b"}",
        b"9" * 5000,
        b"\xff",
        b"\0",
        b"",
        "é".encode("utf-16"),
    ],
    ids=["lists", "objects", "whole", "digits", "bytes", "zero", "nothing", "utf-16"],
)
def test_json_that_cannot_be_read_is_an_error_of_value(raw):
    with pytest.raises(ValueError, match=r"\S"):
        read_json(raw)
    with pytest.raises(AnswerError):
        read_entry(raw, 5)
    with pytest.raises(AnswerError):
        read_fault(raw)


def test_what_a_decoder_says_is_told_plain_and_short():
    for entry in (
        {"id": HOSTILE, "exit": 0},
        {"id": [[[HOSTILE]]], "exit": 0},
        {"id": 5, "exit": HOSTILE * 100},
        {"id": 5, "exit": 0, HOSTILE: 1},
        {"id": 5, "exit": 10**4000},
        {"id": 5, "exit": 1, "code": "E_CRC", "offset": 1 << 63},
        {"id": 5, "exit": 1, "code": "E_CRC", "offset": -1},
        {"id": 5.0, "exit": 0},
    ):
        with pytest.raises(AnswerError) as raised:
            read_entry(json.dumps(entry).encode(), 5)
        assert str(raised.value).isprintable()
        assert len(str(raised.value)) < 300
    _, code, _ = read_entry(json.dumps({"id": 5, "exit": 1, "code": HOSTILE}).encode(), 5)
    assert code is not None
    assert code.isprintable()
    assert len(code) <= 40


class Tags(HTMLParser):
    """The elements of a page."""

    def __init__(self):
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.found.append(tag)


@pytest.mark.thorough
def test_no_report_is_broken_by_what_a_decoder_or_a_suite_says(suite_folder, tmp_path, capsys):
    told = tiny.read_manifest(suite_folder)
    told["vectors"][1] |= {"id": HOSTILE, "family": HOSTILE, "tests": HOSTILE, "faulty": HOSTILE}
    told["vectors"][1]["requirements"] = [HOSTILE]
    told["families"] = []
    (suite_folder / "manifest.json").write_text(json.dumps(told))
    paths = {kind: tmp_path / f"r.{kind}" for kind in ("json", "junit", "html")}
    pages = {}
    for name in ("wrong-codes in batches", "strange-name-and-codes"):
        options = [word for kind, path in paths.items() for word in (f"--{kind}", str(path))]
        assert run(suite_folder, name, *options, "--seed", "1") == 1
        texts = {kind: path.read_text(encoding="utf-8") for kind, path in paths.items()}
        for text in (*texts.values(), capsys.readouterr().out):
            assert {c for c in text if c != "\n" and not c.isprintable()} == set()
        assert ElementTree.fromstring(texts["junit"]).tag == "testsuites"
        report = json.loads(texts["json"])
        assert all(ord(c) < 0xD800 or ord(c) > 0xDFFF for c in str(report))
        assert len(report["header"]["capabilities"]["name"]) <= 80
        tags = Tags()
        tags.feed(texts["html"])
        pages[name] = tags.found
    first, second = pages.values()
    assert first == second
    assert first.count("script") == 2


def test_an_argument_that_is_not_utf_8_can_be_reported(made_suite, tmp_path):
    decoder = bad("right", made_suite) + " \udcff\x1b"
    path = tmp_path / "r.html"
    options = ["--vectors", str(made_suite), "--quick", "--html", str(path)]
    main(["run", "--decoder", decoder, *options])
    assert r"\udcff" in path.read_text(encoding="utf-8")


# --- what is said of it ---------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_rest_is_not_asked_if_all_runs_fail_alike(made_suite, capsys, tmp_path):
    path = tmp_path / "r.json"
    options = ["--jobs", "1", "--json", str(path)]
    assert run(made_suite, "banner", *options) == 1
    said = capsys.readouterr().out
    assert "ended early, because all of the first 12 runs failed alike (protocol)" in said
    assert 'seen: answer "EvoGS decoder' in said
    assert "looks like" not in said
    assert "no legal stream" not in said
    assert "expected: a line for each request, and no other" in said
    report = json.loads(path.read_text())
    assert len(report["results"]) == N_ALIKE < report["summary"]["cases"]
    assert run(made_suite, "last-off-by-one", "--quick") == 1
    assert "ended early" not in capsys.readouterr().out


@pytest.mark.thorough
def test_a_decoder_with_a_memory_is_told_so(made_suite, tmp_path, capsys):
    path = tmp_path / "r.json"
    assert run(made_suite, "stale-verdict", "--quick", "--json", str(path)) == 1
    hint = json.loads(path.read_text())["diagnosis"]["hint"]
    assert "the decoder keeps something from one request to the next" in hint
    assert "--no-batch" in hint
    assert hint in capsys.readouterr().out
    assert run(made_suite, "last-off-by-one", "--quick", "--json", str(path)) == 1
    assert json.loads(path.read_text())["diagnosis"]["hint"] == ""


@pytest.mark.thorough
def test_output_that_is_not_flushed_is_told_so(made_suite, capsys):
    options = ["--id", "crc-*", "--timeout", "2", "--jobs", "4"]
    assert run(made_suite, "flushes-at-the-end", *options) == 1
    assert "flush standard output after each line" in capsys.readouterr().out
    assert run(made_suite, "hang", *options) == 1
    assert "flush standard output" not in capsys.readouterr().out.replace(
        "a line that is flushed", ""
    )


def test_a_family_that_does_not_exist_lists_those_that_do(made_suite, capsys):
    assert run(made_suite, "right", "--family", "core", "--family", "corre\x1b") == 2
    told = tiny.read_manifest(made_suite)
    names = {entry["family"] for entry in told["vectors"]} | {"every-bit-flip", "every-prefix"}
    said = f"run: --family: no corre\\x1b among {', '.join(sorted(names))}\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--decoder", ""], "no command"),
        (["--decoder", "'x"], "No closing quotation"),
        (["--decoder", "x", "--jobs", "0"], "--jobs"),
        (["--decoder", "x", "--timeout", "nan"], "--timeout"),
        (["--decoder", "x", "--json", "/nowhere/r.json"], "folder is not there"),
        (["--decoder", "x", "--junit", f"/{'x' * 300}/r.xml"], "--junit"),
        (["--decoder", "x", "--html", "/"], "it is a folder"),
    ],
)
def test_what_cannot_be_asked_or_written_is_told_at_once(made_suite, capsys, options, words):
    assert main(["run", "--vectors", str(made_suite), *options]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert words in said.err
    renderer = [{"--decoder": "--renderer"}.get(word, word) for word in options]
    if "--junit" not in options:
        assert renders(["run", *renderer]) == 2
        assert words in capsys.readouterr().err


def test_a_program_in_the_command_may_be_longer_than_a_path(made_suite, capsys):
    decoder = bad("right", made_suite) + " " + "x" * 1000
    assert main(["run", "--vectors", str(made_suite), "--quick", "--decoder", decoder]) == 1
    assert "unrecognized arguments" in capsys.readouterr().out


def test_a_fault_of_the_harness_ends_in_a_report(made_suite, tmp_path, monkeypatch, capsys):
    def fail(*args, **options):
        raise ZeroDivisionError("here")

    monkeypatch.setattr("conformance.harness.trial.diagnose", fail)
    path = tmp_path / "r.json"
    assert run(made_suite, "right in batches", "--quick", "--json", str(path)) == 3
    assert "INCOMPLETE: the harness failed: ZeroDivisionError" in capsys.readouterr().out
    assert json.loads(path.read_text())["summary"]["runs"] > 10


@pytest.mark.parametrize("vectors", ["[" * 5000, '{"vectors": [{"id": []}]}', '{"vectors": [3]}'])
def test_a_manifest_of_any_form_is_told_in_a_line(tmp_path, capsys, vectors):
    (tmp_path / "manifest.json").write_text(vectors)
    assert main(["run", "--decoder", "true", "--vectors", str(tmp_path)]) == 3
    assert "INCOMPLETE: " in capsys.readouterr().out
