"""A decoder may do and say what it likes: it is judged, and its words harm no reader."""

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from conformance.harness import process, selftest
from conformance.harness.answers import AnswerError, read_entry, read_fault
from conformance.harness.bad.escapes import ALIVE
from conformance.harness.cli import main
from conformance.harness.plain import plain, read_json, say
from conformance.harness.process import Bounds, clean_environment
from conformance.harness.runner import N_ALIKE
from conformance.harness.scratch import MOST_DEPTH, read_regular, scratch, written_too_much
from tests.conformance import tiny
from tests.conformance.test_harness import bad, run
from tests.conformance.tiny import ROOT

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="looks at processes in /proc")
PYTHON = [sys.executable, "-I", "-S", "-c"]


def test_the_end_of_a_batch_process_is_heard_at_once(made_suite, capsys):
    assert run(made_suite, "dies-half-way", "--quick", "--jobs", "1", "--again", "0") == 1
    said = capsys.readouterr().out
    assert "its output ended without an answer" in said
    assert "timeout" not in said


# --- its memory -----------------------------------------------------------------------------------


def ended(folder, program, **bounds):
    """How a program of Python ends."""
    folder.mkdir(exist_ok=True)
    environment = clean_environment(folder)
    return process.run([*PYTHON, program], folder, environment, Bounds(**bounds), written=[folder])


@LINUX
@pytest.mark.parametrize(
    "name", [b"VmHWM: 1 kB", b"VmHWM:", b"\xff\xfe", b"a\nVmHWM: 1", b"VmHWM:\t"]
)
def test_memory_is_read_from_its_line_whatever_the_process_is_called(tmp_path, name):
    program = f"open('/proc/self/comm', 'wb').write({name!r})\n"
    program += "x = b'x' * (60 << 20)\nimport time\ntime.sleep(30)"
    came = ended(tmp_path, program, memory=50 << 20)
    assert came.over == "memory"


@LINUX
def test_processes_are_bounded_as_memory_is(tmp_path):
    program = "import os, time\nfor _ in range(64):\n    if not os.fork(): time.sleep(30)\n"
    program += "time.sleep(30)"
    assert ended(tmp_path, program, memory=48 << 20).over == "memory"


# --- what it leaves -------------------------------------------------------------------------------

DAEMON = """
import os, sys, time
if os.fork():
    os.wait()
else:
    os.setsid()
    if os.fork():
        os._exit(0)
    open({mark!r}, "w").write(str(os.getpid()))
    time.sleep(60)
while not os.path.exists({mark!r}) or not open({mark!r}).read():
    time.sleep(0.001)
"""


@LINUX
def test_a_daemon_has_ended_when_its_run_has(tmp_path):
    mark = tmp_path / "mark"
    came = ended(tmp_path / "home", DAEMON.format(mark=str(mark)))
    assert (came.status, came.over) == (0, "")
    assert not Path("/proc", mark.read_text()).exists()


@LINUX
def test_a_daemon_ends_when_the_harness_is_killed(tmp_path):
    mark = tmp_path / "mark"
    program = DAEMON.format(mark=str(mark)) + "time.sleep(60)"
    harness = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(ROOT)!r})
from conformance.harness.process import Bounds, run
run({[*PYTHON, program]!r}, Path({str(tmp_path)!r}), {{}}, Bounds())
"""
    with subprocess.Popen([*PYTHON, harness]) as running:
        while not mark.exists() or not mark.read_text():
            time.sleep(0.01)
        running.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 20
    while Path("/proc", mark.read_text()).exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not Path("/proc", mark.read_text()).exists()


def test_a_decoder_that_ends_its_keeper_is_said_to_and_the_next_one_gets_another(tmp_path):
    program = "import os, signal, time\nos.kill(os.getppid(), signal.SIGKILL)\ntime.sleep(60)"
    assert ended(tmp_path, program).over == "keeper"
    assert ended(tmp_path, "print('here')").stdout == b"here\n"


def test_the_self_test_finds_a_process_that_was_left(tmp_path):
    assert list(selftest._left(tmp_path)) == []
    program = f"import fcntl, sys\nx = open({str(tmp_path / ALIVE)!r}, 'w')\n"
    program += "fcntl.flock(x, fcntl.LOCK_SH)\nprint(flush=True)\nsys.stdin.read()"
    with subprocess.Popen(
        [*PYTHON, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as running:
        assert running.stdout is not None
        running.stdout.readline()
        assert list(selftest._left(tmp_path)) == ["a process that it started is still there"]


# --- its files ------------------------------------------------------------------------------------


def test_files_in_folders_below_count_and_links_are_not_followed(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "file").write_bytes(bytes(100_000))
    assert written_too_much([tmp_path], 100_000, 100)
    assert not written_too_much([tmp_path], 200_000, 100)
    assert written_too_much([tmp_path], 200_000, 2)
    other = tmp_path / "other"
    other.mkdir()
    (other / "link").symlink_to(tmp_path / "a", target_is_directory=True)
    assert not written_too_much([other], 50_000, 2)
    assert not written_too_much([tmp_path / "gone"], 0, 0)


@pytest.mark.parametrize(("name", "depth"), [("x", MOST_DEPTH + 2), ("x" * 250, 30)])
def test_folders_too_deep_to_be_looked_at_are_too_much_and_can_be_removed(name, depth):
    before = Path.cwd()
    with scratch() as folder:
        try:
            os.chdir(folder)
            for _ in range(depth):
                Path(name).mkdir()
                os.chdir(name)
            Path("file").touch()
        finally:
            os.chdir(before)
        assert written_too_much([folder], 1 << 30, 10_000)
    assert not folder.exists()


def test_a_nesting_deeper_than_python_can_follow_is_removed(tmp_path):
    before = Path.cwd()
    with scratch(tmp_path) as folder:
        try:
            os.chdir(folder)
            for _ in range(2 * sys.getrecursionlimit()):
                Path("x").mkdir()
                os.chdir("x")
        finally:
            os.chdir(before)
    assert list(tmp_path.iterdir()) == []


def test_only_a_regular_file_is_read(tmp_path):
    pipe, link, file = tmp_path / "pipe", tmp_path / "link", tmp_path / "file"
    os.mkfifo(pipe)
    file.write_bytes(b"12345")
    link.symlink_to(file)
    assert read_regular(file, 3) == b"1234"
    found = [read_regular(path, 9) for path in (pipe, link, tmp_path, Path("/dev/zero"))]
    assert found == [None] * 4


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EMFILE])
def test_a_full_disk_is_no_fault_of_the_decoder_and_what_came_is_reported(
    made_suite, tmp_path, monkeypatch, capsys, number
):
    n_read = []

    def read(path, most):
        n_read.append(path)
        if len(n_read) > 6:
            raise OSError(number, os.strerror(number))
        return read_regular(path, most)

    monkeypatch.setattr("conformance.harness.runner.read_regular", read)
    options = ["--quick", "--jobs", "1", "--again", "0", "--json", str(tmp_path / "r.json")]
    assert run(made_suite, "right in batches", *options) == 3
    said = capsys.readouterr().out
    assert "the harness failed on" in said
    assert os.strerror(number) in said
    assert len(json.loads((tmp_path / "r.json").read_text())["results"]) == 6


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


def test_the_rest_is_not_asked_if_all_runs_fail_alike(made_suite, capsys, tmp_path):
    path = tmp_path / "r.json"
    options = ["--jobs", "1", "--json", str(path)]
    assert run(made_suite, "banner", *options) == 1
    said = capsys.readouterr().out
    assert "ended early, because all of the first 12 runs failed alike (protocol)" in said
    assert 'seen: answer "EvoGS decoder' in said
    assert "expected: a line for each request, and no other" in said
    report = json.loads(path.read_text())
    assert len(report["results"]) == N_ALIKE < report["summary"]["cases"]
    assert run(made_suite, "last-off-by-one", "--quick") == 1
    assert "ended early" not in capsys.readouterr().out


def test_a_decoder_with_a_memory_is_told_so(made_suite, tmp_path, capsys):
    path = tmp_path / "r.json"
    assert run(made_suite, "stale-verdict", "--quick", "--json", str(path)) == 1
    hint = json.loads(path.read_text())["diagnosis"]["hint"]
    assert "the decoder keeps something from one request to the next" in hint
    assert "--no-batch" in hint
    assert hint in capsys.readouterr().out
    assert run(made_suite, "last-off-by-one", "--quick", "--json", str(path)) == 1
    assert json.loads(path.read_text())["diagnosis"]["hint"] == ""


def test_output_that_is_not_flushed_is_told_so(made_suite, capsys):
    options = ["--id", "crc-*", "--timeout", "1", "--jobs", "4"]
    assert run(made_suite, "flushes-at-the-end", *options) == 1
    assert "flush standard output after each line" in capsys.readouterr().out
    assert run(made_suite, "hang", *options) == 1
    assert "flush standard output" not in capsys.readouterr().out.replace(
        "a line that is flushed", ""
    )


def test_a_family_that_does_not_exist_lists_those_that_do(made_suite, capsys):
    assert run(made_suite, "right", "--family", "core", "--family", "corre\x1b") == 2
    assert capsys.readouterr().err == (
        "run: --family: no corre\\x1b among"
        " core, crc, critical, digest, every-bit-flip, every-prefix, signature, trailing\n"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--decoder", ""], "no command"),
        (["--decoder", "'x"], "No closing quotation"),
        (["--decoder", "x", "--jobs", "0"], "--jobs"),
        (["--decoder", "x", "--timeout", "nan"], "--timeout"),
        (["--decoder", "x", "--json", "/nowhere/r.json"], "--json"),
        (["--decoder", "x", "--html", "/"], "--html"),
    ],
)
def test_what_cannot_be_asked_or_written_is_told_at_once(made_suite, capsys, options, words):
    assert main(["run", "--vectors", str(made_suite), *options]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert words in said.err
