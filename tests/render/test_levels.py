"""Levels of lifted scenes, seen: against as many splats at random and against free parents.

And what the palette costs them, whose coarse splats share SH.
"""

import pytest

from evogs_codec import read_ply
from evogs_codec.render.demo_scene import make_scene
from tools.bench.pictures import levels

pytestmark = pytest.mark.slow
EIGHTH, QUARTER, HALF = 1, 2, 3  # levels of five


def assert_good(rows):
    for level in (EIGHTH, QUARTER):
        assert gain(rows[level], "random subset") >= 1.0
    assert gain(rows[HALF], "random subset") >= 0.0
    for level in (EIGHTH, QUARTER, HALF):
        assert gain(rows[level], "free parents") >= -1.5
    for row in rows:
        assert row["with palette, dB"] == "" or gain(row, "with palette") <= 1.0


def gain(row, other):
    return float(row["lifted, dB"]) - float(row[f"{other}, dB"])


def test_levels_of_a_trained_scene(shared):
    splats = read_ply(shared / "data" / "playbot" / "playbot.ply")
    rows = levels(splats, "playbot", "-y")
    assert all(row["with palette, dB"] for row in rows)
    assert_good(rows)


def test_levels_of_the_shipped_scene():
    assert_good(levels(make_scene(), "shipped", "z"))
