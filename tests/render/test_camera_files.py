"""Cameras that other programs wrote, as `--camera` takes them."""

import json

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from PIL import Image

from evogs_codec import InputError
from evogs_codec.render import load_cameras, orbit
from tests.trainer.views_folders import HEIGHT, WIDTH, edit_json, folder_of, shots_of

CAMERAS = orbit(3, (1, 2, 3), radius=2, elevation=0.4, width=30, height=20, fov_x=0.9)


def same(ours, theirs):
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        assert (one.width, one.height) == (other.width, other.height)
        np.testing.assert_allclose(
            [one.fx, one.fy, one.cx, one.cy], [other.fx, other.fy, other.cx, other.cy]
        )
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-12)
        np.testing.assert_allclose(one.translation, other.translation, atol=1e-12)


def backward(camera):
    """4 x 4 camera to world, y up and z backward."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.rotation.T @ np.diag([1, -1, -1])
    matrix[:3, 3] = camera.position
    return matrix


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap", "colmap-text"])
def test_a_folder_of_photographs_gives_its_cameras(kind, tmp_path):
    folder = folder_of(tmp_path / "x", kind)
    cameras = [shot.camera for shot in shots_of()]
    same(load_cameras(folder), cameras)
    inside = "transforms.json" if kind == "nerfstudio" else "sparse/0"
    same(load_cameras(folder / inside), cameras)


@pytest.mark.parametrize(("kind", "ending"), [("colmap", ".bin"), ("colmap-text", ".txt")])
def test_a_file_of_a_colmap_model_stands_for_all_of_it(kind, ending, tmp_path):
    folder = folder_of(tmp_path / "x", kind)
    same(load_cameras(folder / f"sparse/0/images{ending}"), [s.camera for s in shots_of()])


def test_frames_without_a_size_have_that_of_their_pictures(tmp_path):
    folder = folder_of(tmp_path / "x", "blender")
    shots = [shot for shot in shots_of(centred=True) if not shot.test]
    same(load_cameras(folder / "transforms_train.json"), [shot.camera for shot in shots])
    for path in (folder / "train").iterdir():
        with Image.open(path) as image:
            image.convert("RGB").save(path.with_suffix(".jpg"), comment=b"x" * 70)
        path.unlink()
    assert {(c.width, c.height) for c in load_cameras(folder)} == {(WIDTH, HEIGHT)}


def test_frames_of_which_nobody_knows_the_size_are_those_of_nerf_synthetic(tmp_path):
    folder = folder_of(tmp_path / "x", "blender")
    for path in (folder / "train").iterdir():
        path.unlink()
    assert {(c.width, c.height) for c in load_cameras(folder)} == {(800, 800)}


def path_of_nerfstudio():
    return {
        "camera_type": "perspective",
        "render_width": 30,
        "render_height": 20,
        "camera_path": [
            {
                "camera_to_world": backward(camera).ravel().tolist(),
                "fov": float(np.degrees(2 * np.arctan(camera.height / 2 / camera.fy))),
                "aspect": 1.5,
            }
            for camera in CAMERAS
        ],
    }


def test_a_path_of_the_viewer_of_nerfstudio_is_taken(tmp_path):
    (tmp_path / "path.json").write_text(json.dumps(path_of_nerfstudio()))
    same(load_cameras(tmp_path / "path.json"), CAMERAS)


def rows_of_a_trainer():
    return [
        {
            "id": k,
            "img_name": f"{k:05}",
            "width": camera.width,
            "height": camera.height,
            "position": camera.position.tolist(),
            "rotation": camera.rotation.T.tolist(),
            "fy": camera.fy,
            "fx": camera.fx,
        }
        for k, camera in enumerate(CAMERAS)
    ]


def test_the_cameras_beside_the_splats_of_a_trainer_are_taken(tmp_path):
    (tmp_path / "cameras.json").write_text(json.dumps(rows_of_a_trainer()))
    same(load_cameras(tmp_path / "cameras.json"), CAMERAS)
    same(load_cameras(tmp_path), CAMERAS)


@pytest.mark.parametrize(
    "change",
    [
        {"position": [0, 0]},
        {"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]},
        {"rotation": "x"},
        {"width": 0},
        {"width": None},
        {"fx": "1"},
        {"fx": float("nan")},
    ],
)
def test_an_impossible_row_is_named(change, tmp_path):
    rows = rows_of_a_trainer()
    rows[1] |= change
    (tmp_path / "x.json").write_text(json.dumps(rows))
    with pytest.raises(InputError, match=r"x\.json: camera 1"):
        load_cameras(tmp_path / "x.json")
    del rows[1]["position"]
    (tmp_path / "x.json").write_text(json.dumps(rows))
    with pytest.raises(InputError, match=r"x\.json: camera 1"):
        load_cameras(tmp_path / "x.json")


@pytest.mark.parametrize(
    "top",
    [
        {"camera_path": []},
        {"camera_path": {}},
        {"camera_path": [3]},
        {"camera_path": [{}]},
        {"camera_path": [{"camera_to_world": [0] * 15, "fov": 50}]},
        {"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": 180}]},
        {"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": "x"}]},
        {"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": 50}], "render_width": 0},
        {"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": 50}], "render_height": 0},
        {"camera_type": "equirectangular", "camera_path": [{}]},
        {"frames": []},
        {"frames": [3]},
        {"frames": [{}]},
        {"frames": [{"file_path": "../x", "transform_matrix": np.eye(4).tolist()}]},
        [3],
        [[3]],
        ["position"],
        [None],
        3,
        None,
    ],
)
def test_files_of_something_else_are_refused_in_a_line(top, tmp_path):
    if isinstance(top, dict):
        top = {"render_width": 8, "render_height": 8} | top
    (tmp_path / "x.json").write_text(json.dumps(top))
    with pytest.raises(InputError, match=r"x\.json") as refused:
        load_cameras(tmp_path / "x.json")
    assert "\n" not in str(refused.value)


def test_a_lens_that_no_pinhole_stands_for_is_refused(tmp_path):
    folder = folder_of(tmp_path / "x", "nerfstudio")
    edit_json(folder / "transforms.json", lambda top: top.update(camera_model="OPENCV_FISHEYE"))
    with pytest.raises(InputError, match="OPENCV_FISHEYE is not supported"):
        load_cameras(folder)


def test_a_folder_without_cameras_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no cameras: expected transforms\.json"):
        load_cameras(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        load_cameras(tmp_path / "missing.json")
