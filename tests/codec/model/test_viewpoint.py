"""Values of the metadata keys `camera` and `cameras`: what is written is read, the rest is none."""

import json
import re
from pathlib import Path

import pytest

from evogs_codec.model.viewpoint import (
    MAX_POSES,
    Viewpoint,
    default_viewpoint,
    poses,
    poses_text,
)

SPEC = (Path(__file__).resolve().parents[3] / "spec" / "evogs.md").read_text(encoding="utf-8")
RIGHT = {"position": [0, -2, 0.5], "target": [0, 0, 0.25], "up": [0, 0, 1], "fov_y": 45}


def of(members):
    return default_viewpoint({"camera": json.dumps(members)})


def test_the_example_of_the_spec_is_read():
    (example,) = re.findall(r"^> Example\. `(\{.*\})`$", SPEC, re.MULTILINE)
    found = default_viewpoint({"camera": example})
    assert found == Viewpoint((0, -2, 0.5), (0, 0, 0.25), 45, (0, 0, 1))


def test_what_is_written_is_read():
    for view in (
        Viewpoint((1e-7, 2.5, -3e6), (4.0, 5.0, 6.0), 33.25, (0.0, -1.0, 0.5)),
        Viewpoint((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 179.5),
    ):
        assert default_viewpoint({"camera": str(view)}) == view
        assert poses({"cameras": poses_text([view] * MAX_POSES)}) == [view] * MAX_POSES
    with pytest.raises(ValueError, match="at most 256"):
        poses_text([view] * (MAX_POSES + 1))


def test_other_members_have_no_meaning():
    assert of(RIGHT | {"name": "front", "rotation": [1, 2]}) == of(RIGHT)
    assert of(RIGHT) is not None


@pytest.mark.parametrize(
    "change",
    [
        {"position": None},
        {"position": [0, -2]},
        {"position": [0, -2, "1"]},
        {"position": [0, -2, True]},
        {"position": [0, -2, 1e31]},
        {"position": [0, 0, 0.25]},  # that of the target
        {"target": {"x": 1}},
        {"up": None},
        {"up": [0, 0, 0]},
        {"up": [0, 4, -0.5]},  # along the line
        {"fov_y": 0},
        {"fov_y": 180},
        {"fov_y": "45"},
        {"fov_y": None},
    ],
)
def test_a_malformed_camera_is_none_and_spoils_a_list(change):
    assert of(RIGHT | change) is None
    assert poses({"cameras": json.dumps([RIGHT, RIGHT | change])}) == []


@pytest.mark.parametrize(
    "value",
    ["", "x", "[]", "7", "null", "[" * 60_000, '{"position":', '{"fov_y": NaN}', "9" * 60_000],
)
def test_what_is_no_json_object_is_none(value):
    assert default_viewpoint({"camera": value}) is None
    assert poses({"cameras": value}) == []


def test_numbers_that_json_does_not_have_are_none():
    text = json.dumps(RIGHT)
    for number in ("NaN", "Infinity", "1e999"):
        assert default_viewpoint({"camera": text.replace("45", number)}) is None


def test_too_many_poses_are_none():
    assert poses({"cameras": json.dumps([RIGHT] * (MAX_POSES + 1))}) == []
    assert poses({}) == []
