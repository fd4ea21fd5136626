"""Lens distortion: the model, its inverse, and photographs without it."""

import math

import numpy as np
import pytest

from evogs_codec import InputError
from evogs_codec.render import Camera, psnr, render
from evogs_codec.render.demo_scene import make_scene
from reference_trainer.data import load_views
from reference_trainer.data.cache import cache_folder
from reference_trainer.data.colmap import read_colmap
from reference_trainer.data.distortion import (
    distort,
    undistort,
    undistorted_camera,
    undistorted_image,
)
from tests.trainer.views_folders import HEIGHT, LENS, WIDTH, edit_json, folder_of
from tools.photos import main as photos_main

LENSES = [LENS, (0.15, -0.03, 0.0, 0.0), (0.0, 0.0, 0.01, -0.02), (-0.3, 0.1, 0.0, 0.0)]


def appears(x, y, k1, k2, p1, p2):
    """One point through the lens: the formula of OpenCV's documentation, in plain Python."""
    r = math.hypot(x, y)
    scale = 1 + k1 * r**2 + k2 * r**4
    bent_x = x * scale + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
    bent_y = y * scale + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    return bent_x, bent_y


def camera_of(width=60, height=40, focal=55.0):
    return Camera(
        width, height, focal, focal * 1.02, width / 2 + 1.5, height / 2 - 0.75,
        np.eye(3), np.zeros(3),
    )  # fmt: skip


@pytest.mark.parametrize("lens", LENSES)
def test_distort_is_the_formula(lens):
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 9), np.linspace(-0.4, 0.4, 7))
    bent_x, bent_y = distort(x, y, lens)
    for place in np.ndindex(x.shape):
        expected = appears(float(x[place]), float(y[place]), *lens)
        assert (bent_x[place], bent_y[place]) == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("lens", LENSES)
def test_undistort_is_the_inverse_of_distort(lens):
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 21), np.linspace(-0.5, 0.5, 17))
    back_x, back_y = undistort(*distort(x, y, lens), lens)
    np.testing.assert_allclose(back_x, x, atol=1e-9)
    np.testing.assert_allclose(back_y, y, atol=1e-9)


@pytest.mark.parametrize("lens", [(-3.0, 0.0, 0.0, 0.0), (1e6, -1e9, 0.0, 0.0), (0, 0, 9.0, 9.0)])
def test_a_lens_that_folds_the_picture_is_refused(lens):
    with pytest.raises(ValueError, match="folds the picture"):
        undistorted_camera(camera_of(), lens)


@pytest.mark.parametrize("lens", LENSES)
def test_an_undistorted_picture_has_no_pixel_that_the_photograph_lacks(lens):
    camera = camera_of()
    ideal = undistorted_camera(camera, lens)
    for u in np.linspace(0, ideal.width, 33):
        for v in np.linspace(0, ideal.height, 33):
            x, y = (u - ideal.cx) / ideal.fx, (v - ideal.cy) / ideal.fy
            bent_x, bent_y = appears(float(x), float(y), *lens)
            assert -0.05 < camera.fx * bent_x + camera.cx < camera.width + 0.05
            assert -0.05 < camera.fy * bent_y + camera.cy < camera.height + 0.05
    assert ideal.width > 0.7 * camera.width


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_come_from_where_the_lens_put_them(lens):
    # A picture that is linear in the photograph's pixels, so that look-up between them is exact and
    # the value says where it came from; but for borders, where splines bend.
    camera = camera_of()
    u, v = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    photograph = np.stack([u / 60, v / 40, 0 * u], axis=2).astype(np.float32)
    ideal = undistorted_camera(camera, lens)
    image = undistorted_image(photograph, camera, lens)
    assert image.shape == (ideal.height, ideal.width, 3)
    for row in range(6, ideal.height - 6, 3):
        for column in range(6, ideal.width - 6, 3):
            x, y = (column + 0.5 - ideal.cx) / ideal.fx, (row + 0.5 - ideal.cy) / ideal.fy
            bent_x, bent_y = appears(x, y, *lens)
            came_from = (camera.fx * bent_x + camera.cx, camera.fy * bent_y + camera.cy)
            found = image[row, column, :2] * [60, 40]
            np.testing.assert_allclose(found, came_from, atol=2e-3)


def test_a_lens_without_distortion_keeps_the_camera():
    camera = camera_of()
    same = undistorted_camera(camera, (0.0, 0.0, 0.0, 0.0))
    assert (same.width, same.height) == (camera.width, camera.height)
    assert (same.cx, same.cy) == pytest.approx((camera.cx, camera.cy))


def test_a_strong_lens_grows_the_picture_by_half_a_side_at_most():
    camera = camera_of(focal=25.0)
    ideal = undistorted_camera(camera, (-0.3, 0.07, 0.0, 0.0))
    assert camera.width < ideal.width <= 2 * camera.width


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
def test_photographs_through_a_lens_show_the_scene_once_undistorted(tmp_path, capsys, kind):
    arguments = ["--views", "3", "--size", "96", "--splats", "500", "--format", kind]
    photos_main([str(tmp_path / "d"), *arguments, "--distortion", *map(str, LENS)])
    scene = make_scene(500)
    dataset = load_views(tmp_path / "d", cache=tmp_path / "cache")
    for view in (*dataset.train, *dataset.test):
        assert view.camera.width > 96  # this lens saw more than a pinhole
        picture = np.clip(render(scene, view.camera, (1, 1, 1)), 0, 1)
        # Wires thinner than a pixel lose some; a pixel off loses far more.
        assert psnr(picture, view.image) > 28
        assert psnr(picture, view.image) > 4 + psnr(np.roll(picture, 1, axis=1), view.image)


@pytest.mark.parametrize(
    ("model", "params", "lens"),
    [
        ("SIMPLE_RADIAL", (21.0, 9.0, 6.0, -0.2), (-0.2, 0.0, 0.0, 0.0)),
        ("RADIAL", (21.0, 9.0, 6.0, -0.2, 0.09), (-0.2, 0.09, 0.0, 0.0)),
        ("OPENCV", (21.0, 21.0, 9.0, 6.0, -0.2, 0.09, 0.01, 0.03), (-0.2, 0.09, 0.01, 0.03)),
    ],
)
def test_lenses_of_colmap_have_their_coefficients_in_place(tmp_path, model, params, lens):
    folder = folder_of(tmp_path, "colmap-text", n=1)
    numbers = " ".join(map(str, params))
    (folder / "sparse/0/cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {numbers}\n")
    (photograph,), *_ = read_colmap(folder, folder / "sparse" / "0")
    assert photograph.distortion == lens


# ------------------------------------------------------------------------------------------- cache


def test_photographs_are_undistorted_once(tmp_path, monkeypatch):
    folder, cache = folder_of(tmp_path / "d", "nerfstudio", distortion=LENS), tmp_path / "cache"
    before = sorted(tmp_path.rglob("d/**/*"))
    first = load_views(folder, cache=cache)
    assert len(list(cache.iterdir())) == 10
    assert sorted(tmp_path.rglob("d/**/*")) == before
    monkeypatch.setattr("reference_trainer.data.cache.undistorted_image", None)
    second = load_views(folder, cache=cache)
    for one, other in zip(first.train, second.train, strict=True):
        np.testing.assert_array_equal(one.image, other.image)


def test_another_lens_or_background_is_not_taken_from_the_cache(tmp_path):
    folder, cache = (
        folder_of(tmp_path / "d", "nerfstudio", n=2, distortion=LENS, channels=4),
        tmp_path / "c",
    )
    load_views(folder, cache=cache)
    black = load_views(folder, cache=cache, background="black").train[0].image
    white = load_views(folder, cache=cache).train[0].image
    assert black.mean() < white.mean()
    edit_json(folder / "transforms.json", lambda top: top["frames"][1].update(k1=-0.1))
    assert not np.array_equal(load_views(folder, cache=cache).train[0].image, white)


def test_a_damaged_cache_is_made_anew_and_an_unwritable_one_does_without(tmp_path):
    folder, cache = folder_of(tmp_path / "d", "nerfstudio", n=2, distortion=LENS), tmp_path / "c"
    image = load_views(folder, cache=cache).train[0].image
    for path in cache.iterdir():
        path.write_bytes(path.read_bytes()[:60])
    np.testing.assert_array_equal(load_views(folder, cache=cache).train[0].image, image)
    (tmp_path / "file").write_text("no folder")
    unwritable = load_views(folder, cache=tmp_path / "file" / "c")
    np.testing.assert_array_equal(unwritable.train[0].image, image)


def test_the_cache_is_in_the_users_cache_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    load_views(folder_of(tmp_path / "d", "colmap", n=1, distortion=LENS))
    assert len(list((tmp_path / "x" / "evogs" / "undistorted").iterdir())) == 1
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder().parts[-3:] == (".cache", "evogs", "undistorted")


def test_a_lens_that_cannot_be_undone_names_its_photograph(tmp_path):
    folder = folder_of(tmp_path, "nerfstudio", distortion=(-9.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"view_0001\.png: lens distortion .* folds the picture"):
        load_views(folder)
