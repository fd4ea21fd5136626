"""`evogs completion`: its scripts have all options, and shells run them."""

import argparse
import re
import shutil
import subprocess
import sys

import pytest

from evogs_codec.cli.commands import full_parser
from evogs_codec.cli.completion import SHELLS


@pytest.fixture
def script(evogs, tmp_path):
    """The file of a script, as the command prints it."""

    pytest.importorskip("shtab", reason="it makes the scripts")

    def of(shell):
        code, out, err = evogs("completion", shell)
        assert (code, err) == (0, "")
        path = tmp_path / f"evogs.{shell}"
        path.write_text(out, encoding="utf-8")
        return path

    return of


def ran(shell, *words):
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"there is no {shell} on this machine")
    return subprocess.run(
        [program, *map(str, words)], capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_finds_no_mistake_in_its_script(shell, script):
    done = ran(shell, "-n", script(shell))
    assert (done.returncode, done.stderr) == (0, "")


WORDS = {
    ("ed",): ["edit"],
    ("conformance", "self"): ["selftest"],
    ("convert", "--t"): ["--to"],
    ("convert", "--to", "s"): ["spz", "splat"],
    ("encode", "--preset", "sc"): ["scene"],
    ("convert", "some-fi"): ["some-file.ply"],
    ("frobnicate", "--to"): [],
}


@pytest.mark.parametrize("words", WORDS, ids=" ".join)
def test_bash_completes_commands_options_choices_and_files(words, script, tmp_path, monkeypatch):
    path = script("bash")
    (tmp_path / "some-file.ply").touch()
    monkeypatch.chdir(tmp_path)
    quoted = " ".join(f"'{word}'" for word in ("evogs", *words))
    run = (
        f"source '{path}'; COMP_WORDS=({quoted}); COMP_CWORD={len(words)};"
        ' "$(complete -p evogs | sed "s/.*-F \\([^ ]*\\) .*/\\1/")"; echo "${COMPREPLY[@]}"'
    )
    done = ran("bash", "--norc", "-c", run)
    assert done.returncode == 0
    assert done.stdout.split() == WORDS[words]


def test_fish_completes_commands_and_options(script):
    path = script("fish")
    for typed, word in (("evogs ed", "edit"), ("evogs convert --t", "--to")):
        done = ran("fish", "--no-config", "-c", f"source '{path}'; complete -C '{typed}'")
        assert word in done.stdout.split()


def commands_of(parser):
    """{words of a command: its options}, of all commands that help lists."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for listed in action._choices_actions:
                sub = action.choices[listed.dest]
                options = [o for a in sub._actions for o in a.option_strings]
                yield sub.prog.split()[1:], options
                yield from commands_of(sub)


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_and_option_is_in_the_script(shell, script):
    said = set(re.findall(r"[\w-]+", script(shell).read_text(encoding="utf-8")))
    known = {tuple(words): options for words, options in commands_of(full_parser())}
    assert len(known) > 15
    for words, options in known.items():
        long = {o.lstrip("-") if shell == "fish" else o for o in options if o.startswith("--")}
        assert {*words, *long} <= said, words


def test_without_shtab_a_line_says_what_to_install(monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "shtab", None)
    refused("completion", "bash", words=["pip install shtab"])


def test_a_shell_that_is_not_known_is_a_mistake_of_use(refused):
    refused("completion", "sh", code=2, words=["invalid choice"])
