"""Photographs: which files are pictures, how large they may be, and what if some are missing."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from evogs_codec import InputError
from reference_trainer.data import load_views, loading, photograph
from reference_trainer.data.budget import Budget
from reference_trainer.data.photograph import MAX_PIXELS
from tests.trainer.views_folders import HEIGHT, WIDTH, edit_json, folder_of

ROOT = Path(__file__).resolve().parents[2]
STATUS = Path("/proc/self/status")
EPS = f"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 {WIDTH} {HEIGHT}\n%%EndComments\nshowpage\n"


def refusal(folder, **options):
    with pytest.raises(InputError) as caught:
        load_views(folder, **options)
    return str(caught.value)


def test_postscript_that_is_named_png_is_never_run(tmp_path, monkeypatch):
    runs = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: runs.append(1))
    folder = folder_of(tmp_path, "nerfstudio", n=3)
    (folder / "images" / "view_0001.png").write_text(EPS)
    assert "view_0001.png: no picture that can be read, expected PNG or JPEG" in refusal(folder)
    assert not runs


@pytest.mark.parametrize("kind", ["BMP", "GIF", "PPM", "TIFF", "TGA", "PCX"])
def test_pictures_of_other_formats_are_refused_whatever_their_ending(tmp_path, kind):
    folder = folder_of(tmp_path, "nerfstudio", n=3)
    Image.new("RGB", (WIDTH, HEIGHT)).save(folder / "images" / "view_0001.png", kind)
    assert "expected PNG or JPEG" in refusal(folder)


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_png_may_be_named_jpg_and_the_other_way_round(tmp_path, kind):
    folder = folder_of(tmp_path, "nerfstudio", n=3)
    other = {"PNG": "jpg", "JPEG": "png"}[kind]
    Image.new("RGB", (WIDTH, HEIGHT)).save(folder / "images" / f"other.{other}", kind)
    edit_json(
        folder / "transforms.json",
        lambda top: top["frames"][1].update(file_path=f"images/other.{other}"),
    )
    assert {view.name for view in load_views(folder).train} >= {"images/other"}


@pytest.mark.parametrize(
    ("side", "words"), [(8193, "has 8193 x 8193 pixels"), (15_000, "has 225000000 pixels")]
)
def test_a_photograph_that_is_too_large_is_refused_by_its_header(tmp_path, side, words):
    folder = folder_of(tmp_path, "blender", n=3, centred=True)
    path = folder / "train" / "r_0.png"
    Image.new("1", (side, side)).save(path)
    assert path.stat().st_size < 100_000
    said = refusal(folder, size=100)
    assert said == f"{path}: {words}, a photograph has at most {MAX_PIXELS:,}: make it smaller"


@pytest.mark.thorough
@pytest.mark.skipif(not STATUS.exists(), reason="the system does not say how much was used")
def test_a_large_photograph_takes_little_memory_beyond_its_bytes(tmp_path):
    folder = folder_of(tmp_path, "blender", n=2, centred=True)
    side = 8000  # 192 MB of R G B in 200 kB
    Image.new("RGB", (side, side), (9, 99, 199)).save(folder / "train" / "r_0.png")
    program = (
        "import re, sys\n"
        "from pathlib import Path\n"
        "from reference_trainer.data import load_views\n"
        "def most():\n"
        "    return int(re.search(r'VmHWM:\\s*(\\d+) kB', Path(sys.argv[2]).read_text())[1])\n"
        "before = most()\n"
        "load_views(sys.argv[1], size=100)\n"
        "print(most() - before)\n"
    )
    command = [sys.executable, "-c", program, str(folder), str(STATUS)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert 1024 * int(done.stdout) < 6 * side * side  # Pillow holds 4 bytes a pixel


def test_threads_together_decode_no_more_pixels_than_they_may(tmp_path, monkeypatch):
    folder = folder_of(tmp_path, "nerfstudio", n=24)
    lock, held = threading.Lock(), [0]
    most = 0
    read_image = photograph.read_image

    def counted(*arguments):
        nonlocal most
        with lock:
            held[0] += WIDTH * HEIGHT
            most = max(most, held[0])
        time.sleep(0.002)
        image = read_image(*arguments)
        with lock:
            held[0] -= WIDTH * HEIGHT
        return image

    monkeypatch.setattr(loading, "read_image", counted)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(loading, "IN_FLIGHT", 3 * WIDTH * HEIGHT)
    load_views(folder)
    assert WIDTH * HEIGHT <= most <= 3 * WIDTH * HEIGHT


def test_who_wants_more_than_the_budget_gets_all_of_it():
    budget = Budget(10)
    with budget.holding(99):
        assert budget.left == 0
    assert budget.left == 10


# ---------------------------------------------------------------------------------------- missing


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
def test_photographs_that_are_missing_are_counted_and_the_others_taken(tmp_path, kind):
    folder = folder_of(tmp_path, kind, n=67)
    whole = load_views(folder)
    for index in range(3, 67, 4)[:17]:
        (folder / "images" / f"view_{index:04d}.png").unlink()
    (folder / "images" / "view_0001.png").unlink()
    with pytest.warns(UserWarning, match="17 of 67 photographs are missing, .*/view_0001.png is"):
        found = load_views(folder)
    assert len(found.train) + len(found.test) == 50
    images = {view.name: view.image for view in (*whole.train, *whole.test)}
    for view in (*found.train, *found.test):
        np.testing.assert_array_equal(view.image, images[view.name])


def test_missing_photographs_of_a_blender_folder_are_counted_in_both_files(tmp_path):
    folder = folder_of(tmp_path, "blender", n=12)
    (folder / "train" / "r_4.png").unlink()
    (folder / "test" / "r_0.png").unlink()
    with pytest.warns(UserWarning, match="2 of 12 photographs are missing"):
        found = load_views(folder)
    assert (len(found.train), len(found.test)) == (8, 2)


@pytest.mark.parametrize("kind", ["blender", "nerfstudio"])
def test_where_all_test_views_are_missing_others_are_held_out(tmp_path, kind):
    folder = folder_of(tmp_path, kind, n=13)
    names = [f"test/r_{i}" for i in range(4)] if kind == "blender" else []
    names = names or [f"images/view_{i:04d}" for i in range(0, 13, 4)]
    for name in names:
        (folder / f"{name}.png").unlink()
    with pytest.warns(UserWarning, match="4 of 13 photographs are missing"):
        found = load_views(folder)
    assert (len(found.train), len(found.test)) == (7, 2)


@pytest.mark.parametrize("kind", ["blender", "nerfstudio", "colmap"])
def test_a_folder_with_too_few_photographs_left_says_how_many_it_needs(tmp_path, kind):
    folder = folder_of(tmp_path, kind, n=4)
    for path in sorted(folder.rglob("*.png"))[1:]:
        path.unlink()
    said = refusal(folder)
    assert said.startswith(f"{folder}: 3 of 4 photographs are missing, ")
    assert said.endswith(" is the first; at least 2 must be there")


def test_a_link_that_leads_nowhere_is_a_missing_photograph(tmp_path):
    folder = folder_of(tmp_path, "nerfstudio", n=4)
    path = folder / "images" / "view_0001.png"
    path.unlink()
    path.symlink_to("nowhere.png")
    with pytest.warns(UserWarning, match="1 of 4 photographs are missing"):
        load_views(folder)
