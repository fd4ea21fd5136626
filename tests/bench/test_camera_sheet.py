"""The picture of docs/cameras.md."""

from pathlib import Path

import pytest

pytest.importorskip("numba", reason="pictures are rendered")
from PIL import Image

from tools import camera_sheet

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "cameras.jpg"


def test_the_picture_of_the_page_is_small():
    assert PICTURE.stat().st_size < 300_000


def test_the_sheet_finds_up_of_every_scene_and_is_made_anew(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(camera_sheet, "PIXELS", 12)
    made = []
    for name in ("a.jpg", "b.jpg"):
        camera_sheet.main([str(tmp_path / name), "--splats", "400"])
        made.append((tmp_path / name).read_bytes())
    assert made[0] == made[1]
    said = capsys.readouterr().out.splitlines()
    for axis in ("x", "y", "z", "-x", "-y", "-z"):
        assert f"turned to {axis}, 1 % far: up is {axis} - estimated from the splats" in said
    with Image.open(tmp_path / "a.jpg") as image:
        assert image.format == "JPEG"
