"""Reading and checking tilesets: what is taken, and what is refused."""

import json

import numpy as np
import pytest

from evogs_codec import InputError
from evogs_codec.tileset.check import check_tileset
from evogs_codec.tileset.places import Place
from evogs_codec.tileset.read import Tileset
from evogs_codec.tileset.take import take
from tests.support.tilesets import FAR, near, small_tileset

MOVED = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1e149, 0, 0, 1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("tileset")
    small_tileset(made / "one")
    small_tileset(made / "many", max_json=1)
    return made


@pytest.fixture(params=["one", "many"])
def tileset(folder, request):
    with Place(folder / request.param) as place:
        yield Tileset(place)


def changed(folder, tmp_path, change):
    """A copy of the tileset whose JSON was changed."""
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "tiles").symlink_to(folder / "one" / "tiles")
    found = json.loads((folder / "one" / "tileset.json").read_bytes())
    change(found)
    (copy / "tileset.json").write_text(json.dumps(found))
    return copy


def problems(folder):
    with Place(folder) as place:
        return check_tileset(Tileset(place)).problems


def test_tiles_in_one_file_or_in_many_are_the_same(folder):
    found = []
    for name in ("one", "many"):
        with Place(folder / name) as place:
            tileset = Tileset(place)
            found.append([(t.name, t.origin.tolist(), t.box, t.error) for t in tileset.all()])
            assert tileset.n_json_files == (1 if name == "one" else 2)
    assert found[0] == found[1]
    assert len(found[0]) == 5


def test_a_tileset_as_it_was_made_has_no_problem(tileset):
    found = check_tileset(tileset)
    assert found.problems == []
    assert (found.n_files, found.n_splats, found.n_leaf_splats) == (5, 200, 120)


def test_all_leaves_are_taken_and_far_from_the_origin_positions_stay_exact(tileset):
    found = take(tileset)
    assert len(found.splats) == 120
    assert found.origin.any(), "float32 does not keep these positions"
    right = np.sort(near(3).means[:, 0].astype(np.float64) + FAR[0] + 8)
    mine = np.sort(found.splats.means[40:80, 0].astype(np.float64) + found.origin[0])
    assert np.abs(right - mine).max() < 0.01


def test_near_the_origin_positions_are_those_of_the_scene(tmp_path):
    small_tileset(tmp_path / "near", far=np.zeros(3))
    with Place(tmp_path / "near") as place:
        found = take(Tileset(place))
    assert not found.origin.any()
    assert found.splats.means[:, 0].max() > 8


@pytest.mark.parametrize(
    ("most", "n_files", "n"), [(39, 1, 20), (40, 1, 40), (80, 2, 80), (119, 2, 80), (120, 3, 120)]
)
def test_a_number_of_splats_decides_how_far_tiles_are_replaced(tileset, most, n_files, n):
    found = take(tileset, max_splats=most)
    assert (found.n_files, len(found.splats)) == (n_files, n)


def test_a_box_takes_what_it_meets_and_fetches_no_other_file(tileset):
    corner = FAR + np.array([7, 7, -1])
    found = take(tileset, box=[*corner, *(corner + 2)])
    whole = take(tileset)
    assert (found.n_files, len(found.splats)) == (1, 40)
    assert found.n_bytes < whole.n_bytes / 2 + tileset.n_json
    with pytest.raises(InputError, match="no splat is in the box"):
        take(tileset, box=[0, 0, 0, 1, 1, 1])
    with pytest.raises(InputError, match="the coarsest level has 20 splats already"):
        take(tileset, max_splats=3)


def test_faults_of_tiles_and_contents_are_found(folder, tmp_path):
    def smaller(found):
        found["root"]["boundingVolume"]["box"][3] = 1

    (tmp_path / "a").mkdir()
    said = problems(changed(folder, tmp_path / "a", smaller))
    assert any("is not inside that of its parent" in line for line in said)

    def coarser(found):
        found["root"]["children"][1]["children"][0]["geometricError"] = 5

    (tmp_path / "b").mkdir()
    assert "geometric error is above" in problems(changed(folder, tmp_path / "b", coarser))[0]

    def elsewhere(found):
        found["root"]["children"][0]["content"]["uri"] = "tiles/none.evogs"

    (tmp_path / "c").mkdir()
    assert "is not there" in problems(changed(folder, tmp_path / "c", elsewhere))[0]

    def others(found):
        found["root"]["children"][0]["content"]["extras"]["splats"] = 41

    (tmp_path / "d").mkdir()
    assert "has other splats or bytes" in problems(changed(folder, tmp_path / "d", others))[0]


def test_a_damaged_content_is_found(tmp_path):
    small_tileset(tmp_path / "t")
    path = tmp_path / "t" / "tiles" / "1-0.evogs"
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(data)
    assert [line.partition(":")[0] for line in problems(tmp_path / "t")] == ["tiles/1-0.evogs"]
    with Place(tmp_path / "t") as place, pytest.raises(InputError, match=r"1-0\.evogs: E_"):
        take(Tileset(place))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.pop("asset"), "is no tileset"),
        (lambda t: t["asset"].update(version="2.0"), "is of 3D Tiles 2.0"),
        (lambda t: t.pop("root"), "a tile is no object"),
        (lambda t: t["root"].update(geometricError="a lot"), "geometricError is not 1 number"),
        (lambda t: t["root"].update(geometricError=-1), "is negative"),
        (lambda t: t["root"].update(boundingVolume={"sphere": [0, 0, 0, 1]}), "that is a box"),
        (lambda t: t["root"]["boundingVolume"].update(box=[1e400] * 12), "no number of JSON"),
        (lambda t: t["root"]["boundingVolume"].update(box=[10**999] * 12), "too large"),
        (lambda t: t["root"].update(children=3), "children are no list"),
        (lambda t: t["root"]["content"].update(uri="../../etc/passwd"), "leads out of its folder"),
        (lambda t: t["root"]["content"].update(uri="%2e%2e%2fa"), "leads out of its folder"),
        (lambda t: t["root"]["content"].update(uri="%2e%2e/a.evogs"), "leads out of its folder"),
        (lambda t: t["root"]["content"].update(uri="%2E./a"), "leads out of its folder"),
        (lambda t: t["root"]["content"].update(uri="https://example.org/a"), "not a file beside"),
        (lambda t: t["root"]["content"].update(uri="/etc/passwd"), "not a file beside it"),
        (lambda t: t["root"]["content"].update(uri="tileset.json"), "is among its own tiles"),
        (lambda t: t["root"]["children"][0].update(transform=[2] * 16), "turned or scaled"),
        (lambda t: t["root"]["children"][0].update(transform=MOVED), "over 1e[+]30 units from the"),
        (lambda t: t["extras"]["evogs"].update(origin=[0, 1e149, 0]), "over 1e[+]30 units from"),
        (lambda t: t["root"].update(implicitTiling={}), "implicit"),
        (lambda t: t["root"].update(children=t["root"]["children"][:1] * 2), "two tiles have the"),
    ],
)
def test_what_is_no_tileset_that_is_known_is_refused_in_one_line(folder, tmp_path, change, said):
    with Place(changed(folder, tmp_path, change)) as place, pytest.raises(InputError, match=said):
        take(Tileset(place))


def test_tiles_of_any_depth_are_refused_in_little_time(tmp_path):
    deep = b'{"asset":{"version":"1.1"},"root":' + b'{"children":[' * 5000 + b"]}" * 5000 + b"}"
    (tmp_path / "tileset.json").write_bytes(deep)
    with Place(tmp_path) as place, pytest.raises(InputError):
        Tileset(place)
