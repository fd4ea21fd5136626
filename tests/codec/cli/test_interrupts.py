"""Ctrl-C at any time ends `evogs` with one line or none, never with a traceback."""

import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MODULE, FUNCTION = PROJECT["scripts"]["evogs"].split(":")

# What the installed script does, in a process that interrupts itself once: where a module is
# imported, or as Python ends.
PROGRAM = f"""
import atexit, os, signal, sys

place, sys.argv = sys.argv[1], ["evogs", *sys.argv[2:]]


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


class Place:
    def find_spec(self, name, path=None, target=None):
        if name == place:
            interrupt()


sys.meta_path.insert(0, Place())
if place == "the end":
    atexit.register(interrupt)
from {MODULE} import {FUNCTION}
sys.exit({FUNCTION}())
"""
# Modules, and the commands that import them.
PLACES = [
    ("scipy", "info"),
    ("the end", "info"),
    ("numba", "render"),
    *(
        pytest.param(*place, marks=pytest.mark.thorough)
        for place in (
            *((name, "info") for name in ("numpy", "plyfile", "evogs_codec.cli.commands")),
            ("conformance.commands", "conformance"),
            ("reference_trainer.cli", "train"),
            *((name, "render") for name in ("llvmlite.binding", "evogs_codec.render.tiles")),
        )
    ),
]


# Tests that run in the background of a script start with interrupts ignored.
NOT_IGNORED = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"


def run_interrupted(place, *arguments):
    return subprocess.run(
        [sys.executable, "-c", f"{NOT_IGNORED}\n{PROGRAM}", place, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize(("place", "command"), PLACES)
def test_an_interrupt_of_an_import_or_at_the_end_shows_no_traceback(place, command, made, tmp_path):
    output = [tmp_path / "x.png"] if command == "render" else []
    done = run_interrupted(place, command, made / "scene.evogs", *output)
    assert done.returncode in (-signal.SIGINT, 130)
    assert done.stderr in ("", "evogs: interrupted\n")
    assert not list(tmp_path.iterdir())


def test_a_command_that_is_not_interrupted_ends_as_always(made):
    done = run_interrupted("no place", "validate", made / "scene.evogs")
    assert (done.returncode, done.stderr) == (0, "")
    assert run_interrupted("no place").returncode == 2


def test_an_interrupt_that_is_ignored_stays_ignored(made):
    program = f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n{PROGRAM}"
    done = subprocess.run(
        [sys.executable, "-c", program, "evogs_codec.cli.commands", "info", made / "scene.evogs"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "splats" in done.stdout
