"""Folders that cannot be used are refused in one line that says what is wrong, and where."""

import math

import numpy as np
import pytest
from PIL import Image

from evogs_codec import InputError
from reference_trainer.data import load_views
from tests.trainer.views_folders import edit_json, folder_of


def refusal(folder, **options):
    """The one line of the error."""
    with pytest.raises(InputError) as caught:
        load_views(folder, **options)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(str(folder))
    return line


def frame_with(**values):
    """A change of the second frame; a value of None removes it."""

    def change(top):
        frame = top["frames"][1]
        for key, value in values.items():
            if value is None:
                del frame[key]
            else:
                frame[key] = value

    return change


def pose_with(row, column, value):
    def change(top):
        top["frames"][1]["transform_matrix"][row][column] = value

    return change


def top_with(**values):
    return lambda top: top.update(values)


FRAMES = {
    "path with a zero": (frame_with(file_path="a\0b"), "no picture that can be read"),
    "no file_path": (frame_with(file_path=None), "frame 1 has no 'file_path'"),
    "wrong size": (frame_with(w=21), "has 20 x 12 pixels, its camera 21 x 12"),
    "NaN pose": (pose_with(0, 3, math.nan), "has a number that is not finite"),
    "infinite pose": (pose_with(1, 1, math.inf), "has a number that is not finite"),
    "null in a pose": (pose_with(1, 1, None), "has a number that is not finite"),
    "text in a pose": (pose_with(1, 1, "x"), "is not 4 rows of 4 numbers"),
    "scaled pose": (pose_with(0, 0, 3.0), "rotation is not a rotation matrix"),
    "huge pose": (pose_with(0, 0, 1e300), "rotation is not a rotation matrix"),
    "projective pose": (pose_with(3, 0, 0.5), "last row of 'transform_matrix' is not 0 0 0 1"),
    "no pose": (frame_with(transform_matrix=None), "is not 4 rows of 4 numbers"),
    "short pose": (frame_with(transform_matrix=[[1, 0], [0, 1]]), "is not 4 rows of 4 numbers"),
    "no focal": (frame_with(fl_x=None, fl_y=None), "neither fl_x nor camera_angle_x"),
    "zero focal": (frame_with(fl_x=0), "are not positive"),
    "huge number": (frame_with(cx=10**400), "cx is inf, expected a finite number"),
    "text number": (frame_with(cx="9"), "cx is '9', expected a finite number"),
    "true number": (frame_with(k1=True), "k1 is True, expected a finite number"),
    "angle": (frame_with(fl_x=None, camera_angle_x=4.0), "camera_angle_x is 4.0, expected radians"),
    "fisheye": (frame_with(camera_model="OPENCV_FISHEYE"), "model OPENCV_FISHEYE is not supported"),
    "ngp fisheye": (top_with(is_fisheye=True), "model is_fisheye is not supported"),
    "k3": (frame_with(k3=0.1), "k3 is not 0"),
    "twice": (frame_with(file_path="images/view_0002.png"), "images/view_0002 is there twice"),
    "no frames": (lambda top: top.pop("frames"), "no cameras: 'frames' is missing or empty"),
    "empty frames": (top_with(frames=[]), "no cameras: 'frames' is missing or empty"),
    "frame of text": (top_with(frames=["x"]), "frame 0 is not an object"),
    "split of numbers": (top_with(test_filenames=[1]), "'test_filenames' is not a list of names"),
    "unknown split": (top_with(test_filenames=["x.png"]), "x is held out but is no frame"),
    "no points": (top_with(ply_file_path="no.ply"), "no.ply: cannot be read"),
    "points": (top_with(ply_file_path="transforms.json"), "no .ply of points"),
}


@pytest.mark.parametrize(("change", "words"), FRAMES.values(), ids=FRAMES)
def test_a_damaged_transforms_json_is_refused(tmp_path, change, words):
    folder = folder_of(tmp_path, "nerfstudio", n=5)
    edit_json(folder / "transforms.json", change)
    assert words in refusal(folder)


def test_a_split_of_everything_leaves_nothing_to_train_on(tmp_path):
    folder = folder_of(tmp_path, "nerfstudio", n=1)
    assert "none is left to train on" in refusal(folder)


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"frames": [', "[" * 100_000, "\ufeff{}"])
def test_what_is_not_json_is_refused(tmp_path, text):
    (tmp_path / "transforms.json").write_text(text, encoding="utf-8")
    assert "transforms.json: not " in refusal(tmp_path)


def test_bytes_that_are_not_text_are_refused(tmp_path):
    (tmp_path / "transforms_train.json").write_bytes(b"\xff\xfe\x00")
    assert "transforms_train.json: not JSON" in refusal(tmp_path)


def test_a_folder_without_cameras_says_what_was_expected(tmp_path):
    assert "expected transforms_train.json, transforms.json or a COLMAP model" in refusal(tmp_path)
    assert "not a folder" in refusal(tmp_path / "nowhere")


def test_a_damaged_photograph_is_refused(tmp_path):
    folder = folder_of(tmp_path, "blender", n=3)
    path = folder / "train" / "r_1.png"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "r_1.png: the picture is damaged" in refusal(folder)
    path.write_bytes(b"no picture")
    assert "r_1.png: no picture that can be read" in refusal(folder)


def test_sixteen_bits_of_grey_are_refused_rather_than_clipped(tmp_path):
    folder = folder_of(tmp_path, "blender", n=2)
    Image.fromarray(np.zeros((4, 4), np.uint16)).save(folder / "train" / "r_0.png")
    assert "expected 8 bits a channel" in refusal(folder)


@pytest.mark.parametrize("argument", [{"size": 0}, {"test_every": -1}, {"test_every": 1}])
def test_impossible_arguments_are_refused(tmp_path, argument):
    with pytest.raises(ValueError, match=r"is -?\d+, expected"):
        load_views(tmp_path, **argument)


@pytest.mark.parametrize("background", ["pink", (0, 0, 2), (0, 0, math.nan)])
def test_impossible_backgrounds_are_refused(tmp_path, background):
    with pytest.raises(ValueError, match=r"background .* is not"):
        load_views(tmp_path, background=background)


# ----------------------------------------------------------------------------------------- COLMAP


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_every_prefix_of_a_binary_model_is_refused(tmp_path, stem):
    folder = folder_of(tmp_path, "colmap", n=2)
    path = folder / "sparse" / "0" / f"{stem}.bin"
    whole = path.read_bytes()
    for end in range(len(whole)):
        path.write_bytes(whole[:end])
        assert f"{stem}.bin: cut short" in refusal(folder)
    path.write_bytes(whole + b"\0")
    assert f"{stem}.bin: 1 bytes too many" in refusal(folder)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_a_count_beyond_the_file_costs_nothing(tmp_path, stem):
    folder = folder_of(tmp_path, "colmap", n=2)
    path = folder / "sparse" / "0" / f"{stem}.bin"
    path.write_bytes(b"\xff" * 8 + path.read_bytes()[8:])
    assert stem in refusal(folder)


def replaced(old, new):
    def change(text):
        assert old in text
        return text.replace(old, new, 1)

    return change


def second_row(new):
    def change(text):
        lines = text.split("\n")
        lines[next(i for i, line in enumerate(lines) if line.startswith("2 "))] = new
        return "\n".join(lines)

    return change


TEXTS = {
    "model": ("cameras", replaced("PINHOLE", "FOV"), "4 parameters, FOV has 5"),
    "fisheye": (
        "cameras",
        second_row("2 SIMPLE_RADIAL_FISHEYE 20 12 21 9 6 0"),
        "model SIMPLE_RADIAL_FISHEYE is not supported, only SIMPLE_PINHOLE",
    ),
    "unheard of": ("cameras", second_row("2 MAGIC 20 12 1"), "camera model MAGIC is not supported"),
    "few parameters": ("cameras", second_row("2 PINHOLE 20 12 21"), "1 parameters, PINHOLE has 4"),
    "no number": ("cameras", second_row("2 PINHOLE 20 x 1 2 3 4"), "line 3 is not a camera"),
    "wrong size": ("cameras", second_row("2 PINHOLE 21 12 9 9 9 9"), "pixels, its camera 21 x 12"),
    "bad focal": ("cameras", second_row("2 PINHOLE 20 12 -9 9 9 9"), "are not positive"),
    "NaN focal": ("cameras", second_row("2 PINHOLE 20 12 nan 9 9 9"), "that is not finite"),
    "no camera": ("cameras", second_row(""), "names camera 2, not there"),
    "no images": ("images", lambda text: "# nothing\n", "no cameras: the model has no image"),
    "short image": ("images", second_row("2 1 0 0 0 0 0 0 2"), "is not an image"),
    "NaN pose": ("images", second_row("2 1 0 0 0 nan 0 0 2 view_0001.png"), "that is not finite"),
    "no rotation": (
        "images",
        second_row("2 2 0 0 0 0 0 0 2 view_0001.png"),
        "quaternion [2.0, 0.0, 0.0, 0.0] is no rotation",
    ),
    "half a sight": ("images", replaced(" 7\n2 ", " 7 2.5\n2 "), "is not a list of points"),
    "short point": ("points3D", second_row("2 1 1 1 9"), "line 3 is not a point"),
    "text point": ("points3D", second_row("2 1 1 x 9 9 9 0"), "line 3 is not a point"),
    "huge quaternion": (
        "images",
        second_row("2 1e300 0 0 0 0 0 0 2 view_0001.png"),
        "is no rotation",
    ),
    "huge point": ("points3D", second_row("2 1 1 1e300 9 9 9 0"), "a point is not finite"),
    "NaN point": ("points3D", second_row("2 1 1 nan 9 9 9 0"), "a point is not finite"),
}


@pytest.mark.parametrize(("stem", "change", "words"), TEXTS.values(), ids=TEXTS)
def test_a_damaged_text_model_is_refused(tmp_path, stem, change, words):
    folder = folder_of(tmp_path, "colmap-text", n=3)
    path = folder / "sparse" / "0" / f"{stem}.txt"
    path.write_text(change(path.read_text()))
    assert words in refusal(folder)


def test_a_model_of_an_unknown_number_is_refused(tmp_path):
    folder = folder_of(tmp_path, "colmap", n=1)
    path = folder / "sparse" / "0" / "cameras.bin"
    data = bytearray(path.read_bytes())
    data[12] = 77
    path.write_bytes(data)
    assert "camera 1 is of unknown model 77" in refusal(folder)


def test_a_model_without_images_says_which_file_is_missing(tmp_path):
    folder = folder_of(tmp_path, "colmap", n=1)
    (folder / "sparse" / "0" / "images.bin").unlink()
    assert "images.bin: missing from the COLMAP model" in refusal(folder)
