"""Damaged folders of photographs: right data or InputError, nothing else."""

import os
import random
import warnings
from collections import Counter
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from PIL import Image

from evogs_codec import InputError
from reference_trainer.data import load_views
from tests.support import damaged_files as damage
from tests.trainer.views_folders import LENS, WIDTH, edit_json, folder_of

Damage: TypeAlias = Callable[[bytes, random.Random], bytes]
BYTES: list[Damage] = [damage.flipped, damage.cut_short]
TEXTS = [*BYTES, damage.with_edited_text]
JSONS = [*TEXTS, damage.with_another_value, damage.with_another_value, damage.with_deep_nesting]
MODEL = [f"sparse/0/{stem}" for stem in ("cameras", "images", "points3D")]
# Kind of a folder: what is damaged there, and how.
KINDS: dict[str, dict[str, list[Damage]]] = {
    "blender": {"transforms_train.json": JSONS, "transforms_test.json": JSONS},
    "nerfstudio": {"transforms.json": JSONS, "points.ply": [*BYTES, damage.with_edited_ply_header]},
    "colmap": {f"{name}.bin": BYTES for name in MODEL},
    "colmap-text": {f"{name}.txt": TEXTS for name in MODEL},
}
MAX_SAID = 1000  # characters of a message, after the folder


def refusal(folder, **options):
    """The one line of the error."""
    with pytest.raises(InputError) as caught:
        load_views(folder, **options)
    said = str(caught.value)
    assert said.isprintable()
    assert said.startswith(str(folder))
    assert len(said) < len(str(folder)) + MAX_SAID
    return said


def outcome(folder, cache):
    """What becomes of a folder: its views, or None where it is refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of photographs that are missing
        try:
            return load_views(folder, cache=cache), ""
        except InputError as error:
            return None, str(error)


def check(tmp_path, n, random_):
    folders = {}
    for kind in KINDS:
        lens = {"distortion": LENS} if kind != "blender" else {}
        folders[kind] = folder_of(tmp_path / kind, kind, n=4, **lens)
    wholes = {
        (kind, name): (folders[kind] / name).read_bytes() for kind in KINDS for name in KINDS[kind]
    }
    counts = Counter[tuple[str, str]]()
    for number in range(n):
        kind = random_.choice(list(KINDS))
        name = random_.choice(list(KINDS[kind]))
        change = random_.choice(KINDS[kind][name])
        path, whole = folders[kind] / name, wholes[kind, name]
        path.write_bytes(data := change(whole, random_))
        try:
            found, said = outcome(folders[kind], tmp_path / "cache")
        except BaseException:
            print(f"file {number}, {kind}, {name}, {change.__name__}: {data!r}")
            raise
        path.write_bytes(whole)
        if found is None:
            assert said.isprintable(), ascii(said)
            assert len(said) < len(str(path)) + MAX_SAID, said
        else:
            for view in (*found.train, *found.test):
                assert np.isfinite(view.image).all()
            assert found.points is None or np.isfinite(found.points).all()
        counts[kind, "refused" if found is None else "read"] += 1
    print({" ".join(key): count for key, count in sorted(counts.items())})
    assert sum(count for (_, what), count in counts.items() if what == "refused") > n / 4


def test_damaged_cameras_are_refused_or_read(tmp_path):
    check(tmp_path, 200, random.Random(3))


@pytest.mark.slow
def test_two_thousand_damaged_cameras(tmp_path):
    check(tmp_path, 2000, random.Random(2))


def check_photographs(tmp_path, n, random_):
    folder, counts = folder_of(tmp_path, "nerfstudio", n=3), Counter[tuple[str, str]]()
    path, other = folder / "images" / "view_0001.png", tmp_path / "other"
    wholes = [("PNG", path.read_bytes())]
    with Image.open(path) as image:
        for kind in ("JPEG", "GIF", "TIFF", "BMP"):
            image.save(other, kind)
            wholes.append((kind, other.read_bytes()))
        image.convert("P").save(other, "PNG", transparency=3)
        wholes.append(("PNG", other.read_bytes()))
    for _ in range(n):
        kind, whole = random_.choice(wholes)
        path.write_bytes(random_.choice(BYTES)(whole, random_))
        found, said = outcome(folder, None)
        assert said.isprintable(), ascii(said)
        assert found is None or kind in ("PNG", "JPEG")
        counts[kind, "refused" if found is None else "read"] += 1
    print({" ".join(key): count for key, count in sorted(counts.items())})
    assert counts["JPEG", "read"]
    assert counts["PNG", "refused"] > n / 6


def test_damaged_photographs_are_refused_or_read(tmp_path):
    check_photographs(tmp_path, 100, random.Random(3))


@pytest.mark.slow
def test_two_thousand_damaged_photographs(tmp_path):
    check_photographs(tmp_path, 2000, random.Random(4))


def file_path(name):
    def change(top):
        top["frames"][1]["file_path"] = name

    return change


def value(key, found):
    def change(top):
        top["frames"][1][key] = found

    return change


PATHS = {
    "5,000 characters": ("x" * 5000, "File name too long"),
    "5,000 folders": ("x/" * 5000, "File name too long"),
    "a zero": ("a\0b", "no picture that can be read"),
    "half a character": ("\ud800", "no picture that can be read"),
    "a folder": ("images", "no picture that can be read: it is not a file"),
    "the folder itself": ("", "no picture that can be read: it is not a file"),
    "a device": ("/dev/zero", "no picture that can be read: it is not a file"),
    "the cameras": ("transforms.json", "no picture that can be read, expected PNG or JPEG"),
}


@pytest.mark.parametrize(("name", "words"), PATHS.values(), ids=PATHS)
def test_what_cannot_be_a_photograph_is_refused(tmp_path, name, words):
    folder = folder_of(tmp_path, "nerfstudio", n=5)
    edit_json(folder / "transforms.json", file_path(name))
    with pytest.raises(InputError) as caught:
        load_views(folder)
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


VALUES = {
    "an angle of almost nothing": ({"fl_x": None, "camera_angle_x": 5e-324}, "camera_angle_x is"),
    "a nested number": ({"cx": [[[[1.0]]]]}, "cx is no number, expected a finite number"),
    "a long number": ({"cx": "9" * 5000}, "cx is '999"),
    "a nested camera model": ({"camera_model": [["x"]]}, "camera model of another kind than text"),
    "a name of many lines": ({"camera_model": "a\nb" * 999}, "camera model a\\nba\\nb"),
}


@pytest.mark.parametrize(("values", "words"), VALUES.values(), ids=VALUES)
def test_a_value_that_is_hard_to_print_is_refused_in_a_line(tmp_path, values, words):
    folder = folder_of(tmp_path, "nerfstudio", n=5)
    for key, found in values.items():
        edit_json(folder / "transforms.json", value(key, found))
    edit_json(folder / "transforms.json", lambda top: top["frames"][1].pop("fl_y"))
    assert words in refusal(folder)


@pytest.mark.parametrize("depth", [100, 400, 900])
def test_a_nested_pose_is_refused(tmp_path, depth):
    folder = folder_of(tmp_path, "nerfstudio", n=2)
    pose: object = 1.0
    for _ in range(depth):
        pose = [pose]
    edit_json(folder / "transforms.json", value("transform_matrix", pose))
    assert "is not 4 rows of 4 numbers" in refusal(folder)


PIPES = [
    ("nerfstudio", "images/view_0001.png"),
    ("nerfstudio", "points.ply"),
    ("nerfstudio", "transforms.json"),
    ("blender", "transforms_test.json"),
    ("colmap", "images/view_0001.png"),
    ("colmap", "sparse/0/cameras.bin"),
    ("colmap", "sparse/0/images.bin"),
    ("colmap-text", "sparse/0/points3D.txt"),
]


@pytest.mark.parametrize(("kind", "name"), PIPES)
def test_a_pipe_is_refused_rather_than_waited_for(tmp_path, kind, name):
    folder = folder_of(tmp_path, kind, n=3)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    assert "that can be read: it is not a file" in refusal(folder)


@pytest.mark.parametrize("kind", ["colmap", "colmap-text"])
def test_a_photograph_that_a_colmap_model_names_twice_is_refused(tmp_path, kind):
    folder = folder_of(tmp_path, kind, n=3)
    path = next((folder / "sparse/0").glob("images.*"))
    path.write_bytes(path.read_bytes().replace(b"view_0002.png", b"view_0001.png"))
    assert "view_0001 is there twice" in refusal(folder)


def test_a_camera_that_a_colmap_model_has_twice_is_refused(tmp_path):
    folder = folder_of(tmp_path, "colmap-text", n=3)
    path = folder / "sparse/0/cameras.txt"
    path.write_text(path.read_text() + f"1 PINHOLE {WIDTH} 12 9 9 9 9\n")
    assert "camera 1 is there twice" in refusal(folder)
