"""Files of other programs are read as what they were made of; ours are read by them.

The first part needs no other program: their files are in the folder `peers`. The second runs
`splat-transform`, `@adobe/spz` and `gsply` where they are, and is skipped where they are not:
EVOGS_NODE_PEERS names the folder of `node_modules`.
"""

import json
import os
import re
import shutil
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest

from evogs_codec import SplatParams, read_scene, write_ply, write_scene
from evogs_codec.io.interchange.frames import transformed, turn
from tests.support.odd_scenes import covariances, odd_scene, opacities

FOLDER = Path(__file__).parent / "peers"
FILES = sorted(path for path in FOLDER.iterdir() if path.suffix != ".md")
# What each format rounds by: position, covariance (relative), opacity, SH of band 0, SH above.
ROUNDING = {
    ".glb": (0, 1e-6, 1e-6, 0, 0),
    ".spz": (2**-13, 0.12, 1 / 510, 1 / 76.5, 0.067),
    ".sog": (1e-3, 0.03, 1 / 255, 0.02, 0.02),
    ".ply": (4e-3, 0.005, 1 / 510, 0.007, 1 / 63),
    ".splat": (0, 0.02, 1 / 255, 0.015, 0),
    ".ksplat": (1e-4, 0.003, 1 / 255, 0.015, 0.01),
}


def read_quietly(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of opacities that bytes round to 1
        return read_scene(path).splats


def differences(found, scene):
    """The largest differences of positions, covariances, opacities and SH; the order may differ."""
    distances = np.linalg.norm(found.means[:, None] - scene.means[None], axis=2)
    order = distances.argmin(axis=1)
    assert sorted(order) == list(range(len(scene)))
    scene = scene.take(order)
    k = min(found.sh.shape[1], scene.sh.shape[1])
    ours, theirs = covariances(found), covariances(scene)
    size = np.linalg.norm(theirs, axis=(1, 2))
    return (
        np.abs(found.means - scene.means).max(),
        (np.linalg.norm(ours - theirs, axis=(1, 2)) / size).max(),
        np.abs(opacities(found) - opacities(scene)).max(),
        np.abs(found.sh[:, 0] - scene.sh[:, 0]).max(),
        np.abs(found.sh[:, 1:k] - scene.sh[:, 1:k]).max(initial=0),
    )


def assert_close(found, scene, rounding):
    found_ = differences(found, scene)
    assert all(a <= b * 1.001 for a, b in zip(found_, rounding, strict=True)), found_


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_of_a_peer_is_read_as_what_it_was_made_of(path):
    found = re.search(r"sh(\d)", path.name)
    assert found is not None
    scene, splats = odd_scene(degree=int(found[1])), read_quietly(path)
    assert splats.sh_degree == (0 if path.suffix == ".splat" else scene.sh_degree)
    assert_close(splats, scene, ROUNDING[path.suffix])


def test_every_peer_has_files():
    assert len(FILES) >= 12
    assert {path.suffix for path in FILES} == set(ROUNDING)


# --- peers that are installed ---------------------------------------------------------------------

NODE = Path(os.environ.get("EVOGS_NODE_PEERS", "node_modules"))
TRANSFORM = NODE / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
ADOBE = NODE / "@adobe" / "spz" / "dist" / "spz.js"
SAME = (2e-5, 2e-5, 2e-6, 2e-6, 2e-6)  # of two readers of one file
DUMP = """
import create from '%s';
import fs from 'fs';
const spz = await create();
const cloud = spz.loadSpzFromBuffer(
  new Uint8Array(fs.readFileSync(process.argv[2])), {to: spz.CoordinateSystem.RDF});
const out = {antialiased: cloud.antialiased};
for (const name of ['positions', 'scales', 'rotations', 'alphas', 'colors', 'sh'])
  out[name] = Array.from(cloud[name], (x) => Math.max(-20, Math.min(20, x)));
fs.writeFileSync(process.argv[3], JSON.stringify(out));
"""


def run_node(file, *arguments):
    if not file.is_file() or shutil.which("node") is None:
        pytest.skip(f"{file} is not there, or node is not: set EVOGS_NODE_PEERS")
    command = ["node", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def transform(*arguments):
    run_node(TRANSFORM, TRANSFORM, "-q", "-w", *arguments)


@pytest.mark.thorough
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("ending", ["compressed.ply", "spz", "ply"])
def test_splat_transform_reads_what_we_write(ending, degree, tmp_path):
    write_scene(tmp_path / f"ours.{ending}", odd_scene(degree=degree))
    transform(tmp_path / f"ours.{ending}", tmp_path / "theirs.ply")
    ours = read_quietly(tmp_path / f"ours.{ending}")
    assert_close(read_quietly(tmp_path / "theirs.ply"), ours, SAME)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:a .splat has no SH")
def test_splat_transform_reads_our_splat_but_for_its_centre_of_a_byte(tmp_path):
    write_scene(tmp_path / "ours.splat", odd_scene())
    transform(tmp_path / "ours.splat", tmp_path / "theirs.ply")
    ours = read_quietly(tmp_path / "ours.splat")
    # It takes a component of 0 for the byte 127.5, the program that made the format for 128.
    rounding = (0, 0.03, 2e-6, 2e-6, 2e-6)
    assert_close(read_quietly(tmp_path / "theirs.ply"), ours, rounding)


@pytest.mark.thorough
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("ending", ["compressed.ply", "spz", "glb", "sog"])
def test_we_read_what_splat_transform_writes(ending, degree, tmp_path):
    scene = odd_scene(degree=degree)
    write_ply(tmp_path / "scene.ply", scene)
    processor = ["-g", "cpu"] if ending == "sog" else []
    transform(*processor, tmp_path / "scene.ply", tmp_path / f"theirs.{ending}")
    found = read_quietly(tmp_path / f"theirs.{ending}")
    *rounding, rounding_of_sh = ROUNDING[f".{ending}".replace(".compressed", "")]
    if ending == "sog" and degree == 3:  # its palette is too small for this scene, as it reads too
        rounding_of_sh = 2
    assert_close(found, scene, (*rounding, rounding_of_sh))
    if ending != "glb":  # which it does not read
        transform(tmp_path / f"theirs.{ending}", tmp_path / "back.ply")
        assert_close(found, read_quietly(tmp_path / "back.ply"), SAME)


@pytest.mark.thorough
@pytest.mark.parametrize("degree", range(4))
def test_the_reference_of_spz_reads_what_we_write(degree, tmp_path):
    write_scene(tmp_path / "ours.spz", odd_scene(degree=degree))
    (tmp_path / "dump.mjs").write_text(DUMP % ADOBE.resolve().as_uri())
    run_node(ADOBE, tmp_path / "dump.mjs", tmp_path / "ours.spz", tmp_path / "theirs.json")
    theirs = json.loads((tmp_path / "theirs.json").read_text())
    n = len(theirs["alphas"])
    splats = SplatParams(
        np.reshape(theirs["positions"], (n, 3)).astype(np.float32),
        np.roll(np.reshape(theirs["rotations"], (n, 4)), 1, axis=1).astype(np.float32),
        np.reshape(theirs["scales"], (n, 3)).astype(np.float32),
        np.array(theirs["alphas"], np.float32),
        np.concatenate(
            [np.reshape(theirs["colors"], (n, 1, 3)), np.reshape(theirs["sh"], (n, -1, 3))], axis=1
        ).astype(np.float32),
    )
    assert_close(splats, read_quietly(tmp_path / "ours.spz"), SAME)


@pytest.mark.thorough
@pytest.mark.parametrize("degree", range(4))
def test_gsply_reads_what_we_write(degree, tmp_path):
    gsply = pytest.importorskip("gsply", reason="the extra bench has it")
    for ending in ("compressed.ply", "spz"):
        path = tmp_path / f"ours.{ending}"
        write_scene(path, odd_scene(degree=degree))
        found = gsply.read_spz(str(path)) if ending == "spz" else gsply.plyread(str(path))
        n = len(found.means)
        rest = np.zeros((n, 0, 3)) if found.shN is None else found.shN.reshape(n, -1, 3)
        splats = SplatParams(
            found.means,
            found.quats,
            found.scales,
            found.opacities.reshape(n),
            np.concatenate([found.sh0.reshape(n, 1, 3), rest], axis=1).astype(np.float32),
        )
        if ending == "spz":  # it gives the numbers of the file, whose axes are not those of a .ply
            splats = transformed(splats, turn("RUB", "RDF"))
        assert_close(splats, read_quietly(path), (2e-5, 2e-5, 1e-4, 2e-6, 2e-6))
