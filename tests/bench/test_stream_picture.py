"""The moving picture of the README has a frame for each part of the bytes, and ends complete."""

import numpy as np
import pytest
from PIL import Image

from evogs_codec import PRESETS, encode, lift, read_ply
from evogs_codec.render import load_cameras, render
from evogs_codec.render.demo_scene import main as make_demo
from tools.stream_picture import frames, main

pytest.importorskip("numba", reason="the rasterizer is compiled")


@pytest.fixture
def files(tmp_path):
    make_demo(
        [str(tmp_path / "s.ply"), "--splats", "300", "--cameras", str(tmp_path / "cameras.json")]
    )
    stream = encode(lift(read_ply(tmp_path / "s.ply"), 3), PRESETS["near-lossless"])
    (tmp_path / "s.evogs").write_bytes(stream)
    return tmp_path


def test_frames_come_nearer_to_the_scene(files):
    camera = load_cameras(files / "cameras.json")[0].resized(80, 60)
    target = render(read_ply(files / "s.ply"), camera, (1.0, 1.0, 1.0))
    found = list(frames((files / "s.evogs").read_bytes(), camera, target, 4))
    errors = [float(np.abs(frame[:60] - np.clip(target, 0, 1)).max()) for frame in found]
    assert errors[-1] < 0.01 < errors[0]


def test_the_command_writes_a_gif_that_has_all_frames(files):
    inputs = [str(files / "s.evogs"), str(files / "x.gif")]
    options = ["--camera", str(files / "cameras.json"), "--reference", str(files / "s.ply")]
    main([*inputs, *options, "--frames", "3", "--width", "80"])
    with Image.open(files / "x.gif") as image:
        assert (image.format, getattr(image, "n_frames", 1), image.size[0]) == ("GIF", 3, 80)
