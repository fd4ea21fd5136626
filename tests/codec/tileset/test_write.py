"""Scenes that become tilesets: the same bytes wherever and whenever jobs run."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import (
    InputError,
    __version__,
    decode,
    decode_leaves,
    read_directory,
    read_scene,
    write_ply,
)
from evogs_codec.jobs import Engine, JobOptions
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.tileset import TilesetOptions, write_tileset
from evogs_codec.tileset.check import check_tileset
from evogs_codec.tileset.contents import with_place
from evogs_codec.tileset.places import Place
from evogs_codec.tileset.read import Tileset
from evogs_codec.tileset.take import take
from evogs_codec.tileset.write import _with_place_of
from tests.support.view_sizes import FULL, SMALL, views_of

pytest.importorskip("numba")

N = 400
JOB = JobOptions(levels=2, effort=1, up="y", info=SceneInfo(unit=2))
OPTIONS = TilesetOptions(per_file=200, overview=120, job=JOB, crs="EPSG:32632")
SERIAL = Engine("serial")


@pytest.fixture(scope="module", autouse=True)
def small_views():
    """Of what this process encodes itself, wherever nothing else is said."""
    with views_of(SMALL):
        yield


def contents(folder):
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of a scene, whole and in two parts that are not in order."""
    made, scene = tmp_path_factory.mktemp("scene"), make_scene(N)
    write_ply(made / "whole.ply", scene)
    order = np.random.default_rng(1).permutation(N)
    for number, rows in enumerate(np.array_split(order, 2)):
        write_ply(made / f"part-{number}.ply", scene.take(rows))
    return made


@pytest.fixture(scope="module")
def right(folder):
    """The tileset that all others are to be."""
    write_tileset([folder / "whole.ply"], folder / "right", OPTIONS, engine=SERIAL)
    return folder / "right"


@pytest.mark.thorough
def test_a_scene_becomes_a_tileset_that_is_right(folder, right):
    assert not (folder / "right.parts").exists()
    with Place(right) as place:
        tileset = Tileset(place)
        found = check_tileset(tileset)
        assert (found.problems, found.n_files, found.n_leaf_splats) == ([], 3, N)
        assert found.n_digests > 0
        splats = take(tileset).splats
        overview = take(tileset, max_splats=130)
    assert len(splats) == N
    assert overview.n_files == 1
    scene = make_scene(N)
    mine, theirs = (np.sort(s.means[:, 0].astype(np.float64)) for s in (splats, scene))
    assert np.abs(mine - theirs).max() < 0.05


@pytest.mark.thorough
def test_the_root_is_turned_to_z_and_to_metres_and_contents_say_where_they_are(right):
    found = json.loads((right / "tileset.json").read_bytes())
    assert found["asset"] == {"version": "1.1", "extras": {"generator": f"evogs {__version__}"}}
    assert found["root"]["refine"] == "REPLACE"
    matrix = np.array(found["root"]["transform"]).reshape(4, 4).T
    assert matrix[:3, :3] @ (0, 1, 0) == pytest.approx([0, 0, 0.01])
    with Place(right) as place:
        for tile in Tileset(place).all():
            directory = read_directory((right / tile.name).read_bytes())
            text = directory.info.text
            to_scene = np.array(text["transform"].split(), np.float64).reshape(4, 4)
            assert to_scene[:3, 3].tolist() == tile.origin.tolist()
            assert to_scene[:3, :3].tolist() == np.eye(3).tolist()
            assert text["crs"] == "EPSG:32632"
            assert "psnr" not in text


@pytest.mark.thorough
def test_an_overview_is_made_of_the_coarse_levels_of_its_children(right):
    parts = [right / "tiles" / f"{k}.evogs" for k in (0, 1)]
    n_coarse = sum(len(decode_leaves(path, level=0)) for path in parts)
    assert decode(right / "tiles" / "root.evogs").n_leaves == n_coarse


@pytest.mark.thorough
def test_neither_the_order_of_files_nor_another_process_changes_a_byte(folder, tmp_path):
    parts = [folder / "part-1.ply", folder / "part-0.ply"]
    write_tileset(parts, tmp_path / "a", OPTIONS, engine=Engine(workers=1))
    with views_of(FULL):  # the other process has no others
        write_tileset([folder / "whole.ply"], tmp_path / "right", OPTIONS, engine=SERIAL)
    assert contents(tmp_path / "a") == contents(tmp_path / "right")


@pytest.mark.thorough
def test_a_run_that_failed_leaves_no_tileset_and_is_resumed(folder, right, tmp_path, monkeypatch):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("evogs_codec.tileset.write.code_overview", full)
        with pytest.raises(OSError, match="No space left"):
            write_tileset([folder / "whole.ply"], tmp_path / "a", OPTIONS, engine=SERIAL)
    assert [path.name for path in tmp_path.iterdir()] == ["a.parts"]
    monkeypatch.setattr("evogs_codec.tileset.write.code_leaf", full)
    scene = [folder / "whole.ply"]
    write_tileset(scene, tmp_path / "a", OPTIONS, engine=SERIAL, resume=True)
    assert contents(tmp_path / "a") == contents(right)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.thorough
def test_positions_two_thousand_kilometres_away_stay_as_exact_as_near(tmp_path):
    # A `.ply` of doubles, as of a scan in the coordinates of a country.
    scene, far = make_scene(150), np.array([2.0e6, -5.4e6, 300.0])
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{k}" for k in range(3)] + [f"rot_{k}" for k in range(4)]
    rows = np.zeros(150, [(name, "<f8") for name in names])
    for axis, name in enumerate("xyz"):
        rows[name] = scene.means[:, axis] + far[axis]
    for k in range(3):
        rows[f"f_dc_{k}"], rows[f"scale_{k}"] = scene.sh[:, 0, k], scene.log_scales[:, k]
    for k in range(4):
        rows[f"rot_{k}"] = scene.quats[:, k]
    rows["opacity"] = scene.opacity_logits
    header = ["ply", "format binary_little_endian 1.0", "element vertex 150"]
    header += [f"property double {name}" for name in names] + ["end_header", ""]
    (tmp_path / "far.ply").write_bytes("\n".join(header).encode() + rows.tobytes())
    options = TilesetOptions(per_file=75, overview=50, job=JobOptions(levels=2, effort=1))
    with views_of(FULL):  # they decide how exact positions are
        write_tileset([tmp_path / "far.ply"], tmp_path / "far", options, engine=SERIAL)
    with Place(tmp_path / "far") as place:
        found = take(Tileset(place))
    mine = found.splats.means.astype(np.float64) + found.origin
    theirs = scene.means.astype(np.float64) + far
    sizes = np.exp(scene.log_scales.mean(axis=1))
    off = np.sqrt(((mine[:, None] - theirs[None]) ** 2).sum(-1)).min(axis=0)
    assert np.median(off / sizes) < 0.1


@pytest.mark.thorough
def test_contents_of_gltf_are_the_splats_of_streams_with_y_up(folder, right, tmp_path):
    options = replace(OPTIONS, content="glb")
    write_tileset([folder / "whole.ply"], tmp_path / "a", options, engine=SERIAL)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    with Place(tmp_path / "a") as place, Place(right) as streams:
        tileset = Tileset(place)
        assert check_tileset(tileset).problems == []
        tiles = list(zip(tileset.all(), Tileset(streams).all(), strict=True))
        with pytest.raises(InputError, match="is no stream"):
            take(tileset)
    assert [one.box for one, _ in tiles] == [other.box for _, other in tiles]
    for one, other in tiles:
        assert one.name == other.name.replace(".evogs", ".glb")  # type: ignore[union-attr]
        x, y, z = decode(right / other.name).leaves().means.T
        # Readers have a `.ply` before them, whose x and y are the negative of those of glTF; a
        # client of 3D Tiles makes (x, -z, y) of glTF.
        found = read_scene(tmp_path / "a" / one.name).splats.means * np.float32([-1, -1, 1])  # type: ignore[arg-type, operator]
        assert np.stack([found[:, 0], -found[:, 2], found[:, 1]], axis=1) == pytest.approx(
            np.stack([x, y, z], axis=1)
        )


def test_the_place_that_a_scene_says_is_kept_and_options_say_more():
    matrix = (0.0, -1.0, 0.0, 4.5, 1.0, 0.0, 0.0, 5.0, 0.0, 0.0, 1.0, 6.0, 0.0, 0.0, 0.0, 1.0)
    said = {"crs": "EPSG:4978", "transform": "0 -1 0 4.5 1 0 0 5 0 0 1 6 0 0 0 1"}
    found = _with_place_of(SceneInfo(text=said), TilesetOptions())
    assert (found.crs, found.transform) == ("EPSG:4978", matrix)
    assert _with_place_of(SceneInfo(text=said), OPTIONS) == OPTIONS
    for wrong in ("", "1 2 3", "a b", "0 " * 16):
        info = SceneInfo(text={"transform": wrong})
        assert _with_place_of(info, TilesetOptions()) == TilesetOptions()
    of_scene = SceneInfo(text={"camera": "{}", "psnr": "40"})
    job = with_place(JOB, of_scene, np.array(matrix).reshape(4, 4), "EPSG:4978")
    assert job.info.text == said  # type: ignore[union-attr]


@pytest.mark.parametrize("crs", ["32632", "EPSG:", "EPSG:1x", "utm"])
def test_a_crs_that_is_neither_a_code_nor_wkt_is_refused(folder, tmp_path, crs):
    options = TilesetOptions(crs=crs)
    with pytest.raises(InputError, match="neither EPSG: with a number nor WKT"):
        write_tileset([folder / "whole.ply"], tmp_path / "a", options, engine=SERIAL)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_files_is_refused_and_left_as_it_is(folder, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "photo.png").write_bytes(b"mine")
    with pytest.raises(InputError, match="has files: name another folder"):
        write_tileset([folder / "whole.ply"], tmp_path / "a", OPTIONS, engine=SERIAL)
    with pytest.raises(InputError, match="is a file: name a folder"):
        write_tileset([folder / "whole.ply"], folder / "whole.ply", OPTIONS, engine=SERIAL)
    with pytest.raises(FileNotFoundError):
        write_tileset([folder / "whole.ply"], tmp_path / "b" / "c", OPTIONS, engine=SERIAL)
    assert contents(tmp_path) == {"a/photo.png": b"mine"}


@pytest.mark.thorough
def test_the_folder_may_be_a_link_or_where_we_are(folder, right, tmp_path, monkeypatch):
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    scene = [folder / "whole.ply"]
    write_tileset(scene, tmp_path / "link", OPTIONS, engine=SERIAL)
    assert contents(tmp_path / "disk") == contents(right)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_tileset(scene, ".", OPTIONS, engine=SERIAL)
    assert contents(tmp_path / "here") == contents(right)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "here", "link"]
