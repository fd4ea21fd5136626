"""A decoder may do what it likes: it is judged, and nothing of it is left."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conformance.harness import selftest
from conformance.harness.bad.escapes import ALIVE
from conformance.harness.running import process
from conformance.harness.running.process import Bounds, clean_environment
from conformance.harness.running.scratch import MAX_DEPTH, read_regular, scratch, written_too_much
from tests.conformance.test_harness import run
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
from conformance.harness.running.process import Bounds, run
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


@pytest.mark.thorough
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


@pytest.mark.parametrize(("name", "depth"), [("x", MAX_DEPTH + 2), ("x" * 250, 30)])
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
