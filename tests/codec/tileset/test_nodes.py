"""The tree of a tileset, and the JSON that says it."""

import json

import numpy as np
import pytest

from evogs_codec.jobs.partition import Partition
from evogs_codec.jobs.tile_tree import Tree
from evogs_codec.tileset.boxes import Box
from evogs_codec.tileset.json_files import MAX_JSON, Frame, json_files
from evogs_codec.tileset.nodes import MAX_CHILDREN, nodes_of
from evogs_codec.tileset.write import turn_up


def partition_of(n_files, counts=None, seed=1):
    points = np.random.default_rng(seed).uniform(-1000, 1000, (max(64 * n_files, 200), 3))
    tree = Tree.of(points, n_files)
    counts = np.full(tree.n_tiles, 500_000) if counts is None else np.array(counts)
    return Partition(None, tree, 0, counts, None, None)  # type: ignore[arg-type]


def filled(root):
    """The same with boxes and errors as a scene has them."""
    for node in reversed(list(root.all())):
        boxes = [child.box.moved(child.origin - node.origin) for child in node.children]
        node.box = Box.around([Box((-10.3, -10, -10), (10, 10, 10)), *boxes]).rounded()
        node.error = 0.0037 * 2.83**node.height if node.children else 0.0
        node.n_splats, node.n_bytes = 524_287, 6_123_456
    return root


@pytest.mark.parametrize("n_files", [1, 2, 8, 9, 20, 64, 77, 200])
def test_every_file_is_a_leaf_once_and_no_node_has_many_children(n_files):
    root = nodes_of(partition_of(n_files))
    leaves = [node for node in root.all() if not node.children]
    assert sorted(leaf.tile for leaf in leaves) == list(range(n_files))  # type: ignore[type-var]
    assert root.weight == n_files * 500_000
    inner = [node for node in root.all() if node.children]
    assert all(2 <= len(node.children) <= MAX_CHILDREN for node in inner)
    assert root.height <= np.ceil(np.log(n_files) / np.log(8)) + 1e-9 + (n_files > 1)
    assert len({node.name for node in root.all()}) == len(list(root.all()))


def test_a_part_without_splats_is_no_file():
    root = nodes_of(partition_of(4, counts=[3, 0, 0, 5]))
    assert sorted(leaf.weight for leaf in root.all() if not leaf.children) == [3, 5]
    assert root.weight == 8


def test_origins_of_parents_are_exact_beside_those_of_children():
    root = nodes_of(partition_of(20))
    for node in root.all():
        for child in node.children:
            way = child.origin - node.origin
            assert (node.origin + way == child.origin).all()


def test_a_tileset_of_a_hundred_million_splats_begins_with_less_than_256_kB():  # noqa: N802
    root = filled(nodes_of(partition_of(200)))  # 100 million splats in files of 500,000
    files = json_files(root, Frame(np.eye(4), 1.0, {}), ".evogs")
    assert sum(map(len, files.values())) < 100_000
    assert max(map(len, files.values())) <= MAX_JSON + 1000
    assert len(files["tileset.json"]) <= MAX_JSON + 1000


def test_files_of_tiles_stay_small_however_many_tiles_there_are():
    root = filled(nodes_of(partition_of(1000)))  # 500 million splats
    files = json_files(root, Frame(np.eye(4), 1.0, {}), ".evogs")
    assert max(map(len, files.values())) <= MAX_JSON + 1000
    assert len(files) > 4
    uris = []

    def walk(tile, folder):
        uri = tile["content"]["uri"]
        if uri.endswith(".json"):
            assert "children" not in tile
            inner = json.loads(files[f"{folder}{uri}"])
            assert inner["geometricError"] == tile["geometricError"]
            assert inner["root"]["boundingVolume"] == tile["boundingVolume"]
            assert "transform" not in inner["root"], "the tile outside has moved it"
            walk(inner["root"], "tiles/")
            return
        uris.append(f"{folder}{uri}")
        for child in tile.get("children", []):
            walk(child, folder)

    walk(json.loads(files["tileset.json"])["root"], "")
    assert sorted(uris) == sorted(f"tiles/{node.name}.evogs" for node in root.all())


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (0, -1, 0), (1, 0, 0), (0, 0, -1), (1, 2, 3)])
def test_what_is_up_is_turned_to_z_and_nothing_is_mirrored(up):
    turn = turn_up(np.array(up, np.float64))
    assert turn @ np.array(up) / np.linalg.norm(up) == pytest.approx([0, 0, 1])
    assert turn @ turn.T == pytest.approx(np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1)
    if np.abs(up).sum() == 1:
        assert set(np.abs(turn).ravel().tolist()) <= {0.0, 1.0}
