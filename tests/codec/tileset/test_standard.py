"""Tilesets against 3D Tiles 1.1: its properties, and tools of others where they are installed."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from evogs_codec.tileset.check import check_tileset
from evogs_codec.tileset.places import Place
from evogs_codec.tileset.read import Tileset
from tests.support.tilesets import small_tileset

TILESET = {"asset", "geometricError", "root", "extras"}
TILE = {"boundingVolume", "geometricError", "refine", "transform", "content", "children"}


@pytest.fixture(scope="module", params=["one", "many"])
def folder(tmp_path_factory, request):
    made = tmp_path_factory.mktemp("standard") / request.param
    small_tileset(made, max_json=1 if request.param == "many" else 1 << 16)
    return made


def test_every_property_is_one_that_the_schema_names(folder):
    for path in [folder / "tileset.json", *folder.glob("tiles/*.json")]:
        found = json.loads(path.read_bytes())
        assert found.keys() <= TILESET
        assert found["asset"].keys() <= {"version", "extras"}
        assert found["root"]["refine"] == "REPLACE"
        assert found["geometricError"] >= found["root"]["geometricError"]
        todo = [found["root"]]
        while todo:
            tile = todo.pop()
            assert tile.keys() <= TILE
            assert tile["boundingVolume"].keys() == {"box"}
            assert len(tile["boundingVolume"]["box"]) == 12
            assert all(x > 0 for x in np.array(tile["boundingVolume"]["box"])[[3, 7, 11]])
            assert tile["content"].keys() <= {"uri", "extras"}
            assert len(tile.get("transform", range(16))) == 16
            assert tile.get("transform", [1])[-1] == 1
            assert tile.get("children") != []
            assert ("children" in tile) <= tile["content"]["uri"].endswith(".evogs")
            todo += tile.get("children", [])


@pytest.mark.thorough
@pytest.mark.skipif(shutil.which("3d-tiles-validator") is None, reason="npm: 3d-tiles-validator")
def test_the_validator_of_cesium_finds_no_error(folder, tmp_path):
    report = tmp_path / "report.json"
    words = ["--tilesetFile", folder / "tileset.json", "--reportFile", report]
    subprocess.run(["3d-tiles-validator", *words], check=True, stdout=subprocess.DEVNULL)
    assert json.loads(report.read_bytes())["numErrors"] == 0


@pytest.mark.thorough
@pytest.mark.skipif(shutil.which("3d-tiles-tools") is None, reason="npm: 3d-tiles-tools")
def test_the_tools_of_cesium_make_one_file_of_tiles_of_many(folder, tmp_path):
    words = ["combine", "-i", folder / "tileset.json", "-o", tmp_path / "combined"]
    subprocess.run(["3d-tiles-tools", *words], check=True, stdout=subprocess.DEVNULL)
    with Place(tmp_path / "combined") as place:
        tileset = Tileset(place)
        found = check_tileset(tileset)
    assert (found.problems, found.n_files, tileset.n_json_files) == ([], 5, 1)
