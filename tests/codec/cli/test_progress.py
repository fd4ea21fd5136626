"""How far a command is: a bar on a terminal, a line now and then in a log."""

import sys
import time
from io import StringIO

import pytest

from evogs_codec.cli import terminal
from evogs_codec.cli.terminal import progress_bar


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass when a test says so."""
    now = [100.0]
    monkeypatch.setattr(terminal, "SECONDS_OF_A_LINE", 30)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_a_log_gets_a_line_now_and_then_that_says_how_long_is_left(clock, capsys):
    with progress_bar() as progress:
        for step in range(1001):  # 250 s
            progress("draw", step / 1000)
            clock[0] += 0.25
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 8
    assert lines[0] == "evogs: draw: 12 %, 0:30 so far, 3:40 left of this step"
    assert lines[-1].startswith("evogs: draw: 96 %, 4:00 so far, 0:10 left")


def test_what_is_left_is_of_the_stage_and_is_not_said_before_it_is_known(clock, capsys):
    with progress_bar() as progress:
        progress("lift", 0.0)
        clock[0] += 40
        progress("draw", 0.0)
        clock[0] += 31
        progress("draw", 0.5)
        clock[0] += 31
        progress("draw", 0.25)  # it begins again
    assert capsys.readouterr().err.splitlines() == [
        "evogs: draw: 0 %, 0:40 so far",
        "evogs: draw: 50 %, 1:11 so far, 0:31 left of this step",
        "evogs: draw: 25 %, 1:42 so far",
    ]


def test_what_takes_little_says_nothing(clock, capsys):
    with progress_bar() as progress:
        for step in range(1001):
            progress("decode", step / 1000)
    assert capsys.readouterr().err == ""


def test_a_terminal_has_a_bar_that_says_how_long_is_left(monkeypatch):
    class Terminal(StringIO):
        def isatty(self):
            return True

    err = Terminal()
    monkeypatch.setattr(sys, "stderr", err)
    monkeypatch.setattr(terminal._Clock, "left", lambda *_: 75.0)
    monkeypatch.setattr(terminal, "tqdm", lambda **named: _undelayed(**named))
    with progress_bar() as progress:
        progress("draw", 0.4)
        assert "draw:  40%" in err.getvalue()
        assert "1:15 left" in err.getvalue()


def _undelayed(**named):
    from tqdm import tqdm

    return tqdm(**{**named, "delay": 0})
