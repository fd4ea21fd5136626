"""Folders of photographs: what was written is read, whatever the format; and what is held out."""

import re
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from evogs_codec import write_ply
from evogs_codec.io.colmap_files import read_model
from evogs_codec.render import psnr, render
from evogs_codec.render.demo_scene import make_scene
from reference_trainer.data import load_views
from reference_trainer.data.points import read_points
from tests.trainer.views_folders import HEIGHT, WIDTH, cloud_of, edit_json, folder_of, shots_of
from tools.photos import main as photos_main

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("blender", "nerfstudio", "colmap", "colmap-text")
POINT_KINDS = KINDS[1:]


def views_in_order(dataset, n):
    """Views as they were written: test views are every 4th of Blender and nerfstudio folders."""
    test, train = iter(dataset.test), iter(dataset.train)
    every = 8 if dataset.name.startswith("colmap") else 4
    return [next(test if i % every == 0 else train) for i in range(n)]


@pytest.mark.parametrize("kind", KINDS)
def test_cameras_and_pixels_of_every_format_are_those_written(tmp_path, kind):
    dataset = load_views(folder_of(tmp_path / kind, kind))
    assert dataset.name == kind
    views = views_in_order(dataset, 10)
    for shot, view in zip(shots_of(centred=kind == "blender"), views, strict=True):
        for field in ("width", "height", "fx", "fy", "cx", "cy", "rotation", "translation"):
            written, read = getattr(shot.camera, field), getattr(view.camera, field)
            np.testing.assert_allclose(read, written, rtol=1e-12, atol=1e-12)
        assert view.image.dtype == np.float32
        np.testing.assert_array_equal(view.image, shot.pixels / np.float32(255))


@pytest.mark.parametrize("kind", POINT_KINDS)
def test_points_and_colours_are_those_written(tmp_path, kind):
    dataset = load_views(folder_of(tmp_path, kind))
    cloud = cloud_of()
    assert dataset.points is not None
    assert dataset.colours is not None
    np.testing.assert_array_equal(dataset.points, cloud.points.astype(np.float32))
    np.testing.assert_allclose(dataset.colours, cloud.colours / 255, atol=1e-7)
    assert dataset.points.dtype == dataset.colours.dtype == np.float32


def test_a_blender_folder_has_no_points(tmp_path):
    dataset = load_views(folder_of(tmp_path, "blender"))
    assert dataset.points is None
    assert dataset.colours is None


def test_text_and_binary_models_are_the_same(tmp_path):
    binary = read_model(folder_of(tmp_path / "a", "colmap") / "sparse" / "0")
    text = read_model(folder_of(tmp_path / "b", "colmap-text") / "sparse" / "0")
    assert binary.cameras == text.cameras
    assert binary.images == text.images
    np.testing.assert_array_equal(binary.points, text.points)


def test_binary_records_are_those_of_the_documentation_of_colmap(tmp_path):
    # One camera, SIMPLE_RADIAL; one image seen at two places; one point with a track of one.
    (tmp_path / "cameras.bin").write_bytes(
        struct.pack("<QiiQQ4d", 1, 7, 2, 64, 48, 50, 32, 24, 0.1)
    )
    image = struct.pack("<Qi7di", 1, 3, 1, 0, 0, 0, 1, 2, 3, 7) + b"a b/c.jpg\0"
    image += struct.pack("<Qddqddq", 2, 1.5, 2.5, -1, 3.5, 4.5, 9)
    (tmp_path / "images.bin").write_bytes(image)
    point = struct.pack("<QQ3d3BdQii", 1, 9, 4, 5, 6, 10, 20, 30, 0.25, 1, 3, 1)
    (tmp_path / "points3D.bin").write_bytes(point)
    model = read_model(tmp_path)
    camera = model.cameras[7]
    assert (camera.model, camera.width, camera.height) == ("SIMPLE_RADIAL", 64, 48)
    assert list(camera.params) == [50, 32, 24, 0.1]
    assert [(i.name, i.quaternion, i.translation, i.camera) for i in model.images] == [
        ("a b/c.jpg", (1, 0, 0, 0), (1, 2, 3), 7)
    ]
    assert (model.points.tolist(), model.colours.tolist()) == ([[4, 5, 6]], [[10, 20, 30]])


def test_a_binary_model_is_taken_before_one_in_text(tmp_path):
    folder = folder_of(tmp_path, "colmap", n=2)
    (folder / "sparse/0/cameras.txt").write_text("1 MAGIC 1 1\n")
    assert len(load_views(folder).train) == 1


@pytest.mark.parametrize(
    ("kind", "value", "shade"), [("uchar", "51", 0.2), ("float", "0.2", 0.2), (None, "", 0.5)]
)
def test_colours_of_points_may_be_bytes_or_floats_or_missing(tmp_path, kind, value, shade):
    names = ("red", "green", "blue") if kind else ()
    lines = ["ply", "format ascii 1.0", "element vertex 1"]
    lines += [f"property float {name}" for name in "xyz"]
    lines += [f"property {kind} {name}" for name in names]
    lines += ["end_header", "1 2 3 " + " ".join([value] * len(names))]
    path = tmp_path / "points.ply"
    path.write_text("\n".join(lines) + "\n")
    points, colours = read_points(path)
    assert points.tolist() == [[1, 2, 3]]
    np.testing.assert_allclose(colours, [[shade] * 3], rtol=1e-6)


@pytest.mark.parametrize("place", ["sparse", "."])
def test_a_model_may_lie_beside_its_photographs_and_have_no_points(tmp_path, place):
    folder = folder_of(tmp_path, "colmap")
    for file in (folder / "sparse" / "0").iterdir():
        if file.stem != "points3D":
            file.rename(folder / place / file.name)
    dataset = load_views(folder)
    assert len(dataset.train) == 8
    assert dataset.points is None


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_PINHOLE", (21.0, 9.0, 6.0)),
        ("PINHOLE", (21.0, 22.0, 9.0, 6.0)),
        ("SIMPLE_RADIAL", (21.0, 9.0, 6.0, 0.0)),
        ("RADIAL", (21.0, 9.0, 6.0, 0.0, 0.0)),
        ("OPENCV", (21.0, 22.0, 9.0, 6.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_every_supported_camera_model_of_colmap_is_the_same_pinhole(tmp_path, model, params):
    folder = folder_of(tmp_path, "colmap-text", n=1)
    numbers = " ".join(map(str, params))
    (folder / "sparse/0/cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {numbers}\n")
    camera = load_views(folder).train[0].camera
    fy = 22 if model in ("PINHOLE", "OPENCV") else 21
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (21, fy, 9, 6)


# ---------------------------------------------------------------------------------------- held out


def test_views_that_a_folder_names_are_held_out(tmp_path):
    for kind in ("blender", "nerfstudio"):
        dataset = load_views(folder_of(tmp_path / kind, kind), test_every=2)
        assert (len(dataset.train), len(dataset.test)) == (7, 3)


def test_otherwise_the_first_of_every_so_many_is_held_out(tmp_path):
    folder = folder_of(tmp_path, "colmap", n=10)
    names = [f"view_{i:04d}" for i in range(10)]
    for every, held_out in ((8, [0, 8]), (3, [0, 3, 6, 9]), (0, [])):
        dataset = load_views(folder, test_every=every)
        assert [view.name for view in dataset.test] == [names[i] for i in held_out]
        assert [view.name for view in dataset.train] == [
            name for i, name in enumerate(names) if i not in held_out
        ]


def test_validation_views_are_held_out_where_there_are_no_test_views(tmp_path):
    folder = folder_of(tmp_path / "a", "blender")
    (folder / "transforms_test.json").rename(folder / "transforms_val.json")
    assert [view.name for view in load_views(folder).test] == ["test/r_0", "test/r_1", "test/r_2"]
    (folder / "transforms_val.json").unlink()
    assert [view.name for view in load_views(folder).test] == ["train/r_0"]


def test_test_views_come_before_validation_views(tmp_path):
    blender = folder_of(tmp_path / "a", "blender")
    train = (blender / "transforms_train.json").read_text()
    (blender / "transforms_val.json").write_text(train)
    assert len(load_views(blender).test) == 3
    other = folder_of(tmp_path / "b", "nerfstudio")
    names = [f"images/view_{i:04d}.png" for i in (1, 2)]
    edit_json(other / "transforms.json", lambda top: top.update(val_filenames=names))
    assert len(load_views(other).test) == 3
    edit_json(other / "transforms.json", lambda top: top.update(test_filenames=[]))
    assert [view.name for view in load_views(other).test] == [
        "images/view_0001",
        "images/view_0002",
    ]


def test_a_folder_of_one_photograph_holds_nothing_out(tmp_path):
    dataset = load_views(folder_of(tmp_path, "colmap", n=1))
    assert (len(dataset.train), len(dataset.test)) == (1, 0)


# ---------------------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("background", ["white", "black", (0.25, 0.5, 1.0)])
def test_transparency_is_laid_on_the_background_before_pixels_are_averaged(tmp_path, background):
    folder = folder_of(tmp_path, "blender", channels=4, n=2)
    dataset = load_views(folder, background=background, size=WIDTH // 2)
    values = shots_of(channels=4, n=2, centred=True)[1].pixels / 255
    color = {"white": (1, 1, 1), "black": (0, 0, 0)}.get(background, background)
    laid = values[..., :3] * values[..., 3:] + np.array(color) * (1 - values[..., 3:])
    averaged = laid.reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean((1, 3))
    np.testing.assert_allclose(dataset.train[0].image, averaged, atol=1e-6)
    assert dataset.background == color


def test_no_alpha_takes_a_pixel_out_of_range(tmp_path):
    folder = folder_of(tmp_path, "blender", channels=4, n=2)
    pixels = np.full((256, 256, 4), 255, np.uint8)
    pixels[..., 3] = np.arange(256)
    pixels[..., :3] = np.arange(256)[:, None, None]
    Image.fromarray(pixels).save(folder / "train" / "r_0.png")
    image = load_views(folder).train[0].image
    assert image.min() >= 0
    assert image.max() == 1


@pytest.mark.parametrize("mode", ["L", "LA", "P", "1", "CMYK"])
def test_other_kinds_of_eight_bit_pictures_are_read(tmp_path, mode):
    folder = folder_of(tmp_path, "blender", n=2)
    path = folder / "train" / "r_0.png"
    grey = Image.fromarray(np.full((HEIGHT, WIDTH, 3), 255, np.uint8)).convert(mode)
    path.unlink()
    grey.save(path.with_suffix(".jpg" if mode == "CMYK" else ".png"))
    np.testing.assert_allclose(load_views(folder).train[0].image, 1, atol=0.01)


def test_transparency_of_a_palette_is_transparency(tmp_path):
    folder = folder_of(tmp_path, "blender", n=2)
    pixels = Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint8)).convert("P")
    pixels.save(folder / "train" / "r_0.png", transparency=0)
    assert load_views(folder, background=(0.25, 0.5, 1)).train[0].image[3, 3].tolist() == [
        0.25,
        0.5,
        1,
    ]


def test_an_angle_may_stand_for_a_focal_length_and_one_for_both(tmp_path):
    folder = folder_of(tmp_path, "nerfstudio", n=2)

    def angle_y(top):
        for frame in top["frames"]:
            del frame["fl_x"], frame["fl_y"]
            frame["camera_angle_y"] = 2 * np.arctan(HEIGHT / 2 / 30)

    edit_json(folder / "transforms.json", angle_y)
    camera = load_views(folder).train[0].camera
    assert (camera.fx, camera.fy) == pytest.approx((30, 30))


def test_names_stay_below_the_folder_that_results_are_written_to(tmp_path):
    folder = folder_of(tmp_path / "d" / "inner", "nerfstudio", n=2)
    (folder / "images").rename(tmp_path / "images")

    def move(top):
        top["frames"][0]["file_path"] = "../../images/view_0000.png"
        top["frames"][1]["file_path"] = str(tmp_path / "images" / "view_0001.png")
        del top["test_filenames"]

    edit_json(folder / "transforms.json", move)
    dataset = load_views(folder, test_every=0)
    assert dataset.train[0].name == "images/view_0000"
    assert dataset.train[1].name == f"{tmp_path}/images/view_0001"[1:]


def test_numbers_of_the_lens_may_stand_at_the_top_of_the_file(tmp_path):
    per_frame = load_views(folder_of(tmp_path / "a", "nerfstudio"))
    folder = folder_of(tmp_path / "b", "nerfstudio")

    def move(top):
        for key in ("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"):
            values = [frame.pop(key) for frame in top["frames"]]
            top[key] = values[0]

    edit_json(folder / "transforms.json", move)
    same = load_views(folder)
    for one, other in zip(per_frame.train, same.train, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        assert (one.camera.fx, one.camera.cy) == (other.camera.fx, other.camera.cy)


def test_a_size_above_that_of_the_photographs_changes_nothing(tmp_path):
    folder = folder_of(tmp_path, "colmap")
    assert load_views(folder, size=1000).train[0].image.shape == (HEIGHT, WIDTH, 3)
    assert load_views(folder, size=10).train[0].image.shape == (6, 10, 3)


# ------------------------------------------------------------------------------------ whole scenes


@pytest.mark.parametrize(("kind", "least"), [("blender", 55), ("colmap", 50)])
def test_photographs_of_the_procedural_scene_show_it(tmp_path, capsys, kind, least):
    arguments = ["--views", "9", "--size", "48", "--splats", "500", "--format", kind]
    photos_main([str(tmp_path / kind), *arguments])
    assert "9 photographs of 500 splats" in capsys.readouterr().out
    scene = make_scene(500)
    dataset = load_views(tmp_path / kind)
    assert (len(dataset.train), len(dataset.test)) == (7, 2)
    for view in (*dataset.train, *dataset.test):
        picture = np.clip(render(scene, view.camera, dataset.background), 0, 1)
        assert psnr(picture, view.image) > least


def test_cameras_frame_a_scene_of_any_size_and_place(tmp_path, capsys):
    scene = make_scene(500)
    far = scene.means * 100 + np.array([500, -300, 20], np.float32)
    scaled = replace(scene, means=far, log_scales=scene.log_scales + np.float32(np.log(100)))
    write_ply(tmp_path / "far.ply", scaled)
    arguments = ["--views", "3", "--size", "16", "--format", "colmap"]
    photos_main([str(tmp_path / "d"), "--scene", str(tmp_path / "far.ply"), *arguments])
    dataset = load_views(tmp_path / "d")
    assert dataset.points is not None
    centre = dataset.points.mean(0)
    for view in dataset.train:
        x, y, z = view.camera.rotation @ centre + view.camera.translation
        assert z > 100
        assert np.hypot(x, y) < 0.5 * z
    write_ply(tmp_path / "empty.ply", make_scene(0))
    for name, words in (("no", "no.ply: cannot be read"), ("empty", "no splats to photograph")):
        with pytest.raises(SystemExit) as exit_:
            photos_main([str(tmp_path / "d"), "--scene", str(tmp_path / f"{name}.ply")])
        assert exit_.value.code == 1
        assert words in capsys.readouterr().err


def test_a_lens_that_distorts_is_refused_where_the_format_cannot_say_it(tmp_path, capsys):
    with pytest.raises(SystemExit) as exit_:
        photos_main([str(tmp_path), "--distortion", "0.1", "0", "0", "0"])
    assert exit_.value.code == 2
    assert "choose another --format" in capsys.readouterr().err


@pytest.mark.thorough
def test_the_lego_photographs_are_read_as_their_tree_was_trained(shared):
    dataset = load_views(shared / "data" / "lego", size=50)
    assert dataset.name == "lego"
    assert (len(dataset.train), len(dataset.test)) == (87, 13)
    assert [view.name for view in dataset.test[:2]] == ["train/r_0", "train/r_8"]
    view = dataset.test[1]
    with Image.open(shared / "data" / "lego" / "train" / "r_8.png") as file:
        pixels = np.asarray(file, np.float64) / 255
    laid = pixels[..., :3] * pixels[..., 3:] + 1 - pixels[..., 3:]
    averaged = laid.reshape(50, 16, 50, 16, 3).mean((1, 3))
    np.testing.assert_allclose(view.image, averaged, atol=1e-5)
    # A corner of a Lego photograph is background; the camera looks at the model, 4 units away.
    np.testing.assert_array_equal(view.image[0, 0], [1, 1, 1])
    assert np.linalg.norm(view.camera.position) == pytest.approx(4.03, abs=0.01)


def test_the_example_of_the_page_on_datasets_runs(tmp_path, monkeypatch):
    text = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    folder_of(tmp_path / "photos", "colmap")
    monkeypatch.chdir(tmp_path)
    found: dict[str, Any] = {}
    exec(compile(block, "docs/datasets.md", "exec"), found)
    assert found["small"].image.shape == (HEIGHT // 4, WIDTH // 4, 3)
