"""Programs that show scenes read what we write, and show it as we do; we read what they write.

They are the loaders of `three`, `gaussian-splats-3d` and Spark. `make test-peers` installs them and
runs this file; Spark needs Chromium, too.
"""

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evogs_codec import decode_leaves, encode_scene, write_gltf_stream, write_ply, write_scene
from evogs_codec.io.interchange.frames import transformed, turn
from evogs_codec.render.demo_scene import make_scene
from tests.support.odd_scenes import far_scene, odd_scene
from tests.support.peer_files import FOLDER, NODE, Reading, assert_close, read_quietly, run_node

KNOWN_WARNINGS = "ignore:.*(infinite opacity|no SH above band 0|beyond what)"
pytestmark = [pytest.mark.thorough, pytest.mark.filterwarnings(KNOWN_WARNINGS)]

BYTE = 1 / 510 + 1e-6  # half a step of an opacity
COLOUR = BYTE / 0.28209479177387814  # of the SH of band 0 of a colour
SH = 1 / 256 + 1e-6
AXES = {"spz": "RUB", "glb": "LUF"}  # of the numbers in the file; others are as a .ply
# What three rounds to: position, covariance (relative), opacity, SH of band 0, SH above.
THREE = {
    "ply": (0, 2e-6, BYTE, COLOUR, SH),
    "glb": (0, 2e-6, BYTE, COLOUR, SH),
    "spz": (0, 2e-6, 2e-6, COLOUR, 2e-6),
    "splat": (0, 2e-6, 2e-6, 2e-6, 0),
}
GS3D = (1e-6, 2e-6, 2 * BYTE, 2 * COLOUR, 2e-6)  # it takes the floor of a byte


def of_three(path, folder):
    """How the loader of `three` reads a file, in the axes of a `.ply`."""
    out = folder / "three.json"
    run_node("three", FOLDER / "three_read.mjs", NODE, path, out)
    return Reading.of_json(out).turned(AXES.get(path.suffix[1:], "RDF"), "RDF")


def of_gs3d(path, degree, folder):
    """How `gaussian-splats-3d` reads a file."""
    out = folder / "gs3d.json"
    run_node("@mkkellogg/gaussian-splats-3d", FOLDER / "gs3d.mjs", NODE, path, degree, out)
    return Reading.of_json(out)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("ending", THREE)
def test_three_reads_what_we_write(ending, degree, tmp_path):
    path = tmp_path / f"ours.{ending}"
    write_scene(path, odd_scene(degree=degree))
    found, ours = of_three(path, tmp_path), read_quietly(path)
    assert found.sh.shape == ours.sh.shape
    assert_close(found, ours, THREE[ending])


@pytest.mark.parametrize("ending", THREE)
@pytest.mark.filterwarnings("ignore:positions are far from zero")
def test_three_reads_extreme_numbers_as_we_do(ending, tmp_path):
    path = tmp_path / f"ours.{ending}"
    write_scene(path, far_scene())
    # Bytes of colours and of SH hold less than the floats of a .ply or .glb.
    *rounding, _, _ = THREE[ending]
    assert_close(of_three(path, tmp_path), read_quietly(path), (*rounding, 9, 5))


def test_three_reads_the_fallback_of_a_stream_in_a_glb(tmp_path):
    stream = encode_scene(make_scene(300), preset="scene", levels=3, cameras=[])
    write_gltf_stream(tmp_path / "x.glb", stream, fallback=True)
    out = tmp_path / "three.json"
    run_node("three", FOLDER / "three_read.mjs", NODE, tmp_path / "x.glb", out)
    # Attributes have the axes of the stream; the matrix of the node turns them.
    assert_close(Reading.of_json(out), decode_leaves(stream, level=0), THREE["glb"])


@pytest.mark.parametrize("degree", range(3))  # it has no SH of degree 3
@pytest.mark.parametrize("ending", ["ply", "compressed.ply", "splat"])
def test_gaussian_splats_3d_reads_what_we_write(ending, degree, tmp_path):
    path = tmp_path / f"ours.{ending}"
    write_scene(path, odd_scene(degree=degree))
    if (ending, degree) == ("compressed.ply", 0):
        pytest.skip("gaussian-splats-3d 0.4.7 reads no .compressed.ply without SH, of anybody")
    found = of_gs3d(path, 0 if ending == "splat" else degree, tmp_path)
    # It takes bytes of SH for steps of 8 / 255, the programs that made the format for 8 / 256.
    sh = 4 / 255 if ending == "compressed.ply" else GS3D[-1]
    assert_close(found, read_quietly(path), (*GS3D[:-1], sh))


@pytest.mark.parametrize("degree", range(3))
@pytest.mark.parametrize("level", range(3))
def test_we_read_what_gaussian_splats_3d_writes(level, degree, tmp_path):
    path = tmp_path / f"theirs.{level}.ksplat"
    write_ply(tmp_path / "scene.ply", odd_scene(degree=degree))
    program = "@mkkellogg/gaussian-splats-3d"
    run_node(program, FOLDER / "gs3d.mjs", NODE, tmp_path / "scene.ply", degree, path)
    ours = read_quietly(path)
    assert ours.sh_degree == degree
    rounding = (1e-4, 0.003, 1 / 255, 0.015, (0, 1e-3, 0.01)[level])
    assert_close(ours, odd_scene(degree=degree), rounding)
    # It does not normalise orientations, which are half floats above level 0.
    shape = 0.005 if level else 2e-6
    assert_close(of_gs3d(path, degree, tmp_path), ours, (2e-6, shape, 2e-6, 2e-6, 2e-6))
    assert_close(of_three(path, tmp_path), ours, (2e-6, 2e-6, 2e-6, 2e-6, SH))


# --- pictures -------------------------------------------------------------------------------------

VIEWS = (  # from three sides, two ways up
    {"eye": [1, -2, -9], "target": [1.3, -0.7, 2.1], "up": [0, -1, 0]},
    {"eye": [8, 1, 6], "target": [1.3, -0.7, 2.1], "up": [0, -1, 0]},
    {"eye": [-3, -9, 3], "target": [1.3, -0.7, 2.1], "up": [0, 0, 1]},
)
WIDTH, HEIGHT, FOV_Y = 160, 120, 50
CHROMIUM = Path(os.environ.get("CHROMIUM", "/usr/bin/chromium"))


def of_spark(files, folder):
    """(F, V, H, W, 3) pictures of files as Spark shows them."""
    if not CHROMIUM.exists():
        pytest.skip("no Chromium: apt-get install chromium, or CHROMIUM=...")
    look = {"width": WIDTH, "height": HEIGHT, "fovY": FOV_Y, "views": VIEWS}
    (folder / "views.json").write_text(json.dumps(look))
    words = (NODE, folder / "views.json", folder / "spark", *files)
    run_node("@sparkjsdev/spark", FOLDER / "spark_draw.mjs", *words)
    pictures = [
        np.fromfile(folder / f"spark.{i}.{j}.rgb", np.uint8) / 255
        for i in range(len(files))
        for j in range(len(VIEWS))
    ]
    return np.reshape(pictures, (len(files), len(VIEWS), HEIGHT, WIDTH, 3))


def of_ours(splats):
    """(V, H, W, 3) pictures by the project's rasterizer, from the same cameras."""
    render = pytest.importorskip("evogs_codec.render", reason="the rasterizer is compiled")
    fov_x = 2 * math.atan(math.tan(math.radians(FOV_Y / 2)) * WIDTH / HEIGHT)
    cameras = [
        render.Camera.look_at(*view.values(), width=WIDTH, height=HEIGHT, fov_x=fov_x)
        for view in VIEWS
    ]
    pictures = [render.render(splats, camera, (0.0, 0.0, 0.0)) for camera in cameras]
    return np.clip(pictures, 0, 1)


def db(one, other):
    """PSNR of (V, H, W, 3) pictures, of the worst view."""
    return -10 * np.log10(((one - other) ** 2).mean(axis=(1, 2, 3)).max())


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Files that we wrote and files of peers: (name, our pictures, those of Spark) of each."""
    folder = tmp_path_factory.mktemp("shown")
    for ending in ("ply", "compressed.ply", "splat"):
        write_scene(folder / f"ours.{ending}", odd_scene())
    # Of those of peers, Spark 2.2 reads no .spz of version 4 and no .glb.
    unread = ("-v4.spz", "-sh0.spz", ".glb")
    peers = [path for path in sorted(FOLDER.glob("*sh*")) if not path.name.endswith(unread)]
    files = [*sorted(folder.glob("ours.*")), *peers]
    theirs = of_spark(files, folder)
    return [
        (path.name, of_ours(read_quietly(path)), pictures)
        for path, pictures in zip(files, theirs, strict=True)
    ]


def test_spark_shows_every_file_as_we_do(shown):
    """Its SH have 8 bits and fewer: 37 dB; without SH bands it is 63."""
    assert len(shown) >= 12
    for name, ours, theirs in shown:
        least = 60 if name.endswith(".splat") else 36
        assert db(ours, theirs) > least, name


def test_sh_or_positions_of_other_axes_are_seen_at_once(shown):
    scene = odd_scene()
    whole = {name: theirs for name, _, theirs in shown}["ours.ply"]
    not_turned = transformed(scene, turn("RUB", "RDF"))
    for changed in (replace(scene, sh=not_turned.sh), replace(not_turned, sh=scene.sh)):
        assert db(of_ours(changed), whole) < 30


def test_spark_shows_an_spz_turned_to_the_axes_of_a_ply_as_the_ply(shown):
    pictures = {name: theirs for name, _, theirs in shown}
    assert db(pictures["adobe-0.2.3-sh3-v2.spz"], pictures["ours.ply"]) > 30
