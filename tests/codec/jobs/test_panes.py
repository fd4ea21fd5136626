"""Panes: a tile between them looks as it does among the splats of the other tiles."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from evogs_codec.jobs.panes import Panes, _from_front, between
from evogs_codec.jobs.surroundings import Standing
from evogs_codec.jobs.tile_tree import Tree
from evogs_codec.render import Views
from evogs_codec.render.demo_scene import make_scene

N = 2000
WHITE = (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def scene():
    return make_scene(N)


@pytest.fixture(scope="module")
def tree(scene):
    return Tree.of(scene.means.astype(np.float64), 4)


@pytest.fixture(scope="module")
def standing(scene):
    return Standing.around(scene, up="z", n_views=6, all_round=True, pixels=160)


@pytest.fixture(scope="module")
def tiles(scene, tree):
    """The rows of each tile."""
    tile_of = tree.tile_of(scene.means.astype(np.float64))
    return [np.flatnonzero(tile_of == tile) for tile in range(tree.n_tiles)]


@pytest.fixture(scope="module")
def panes(scene, tiles, standing, tmp_path_factory):
    """The file of each tile."""
    folder = tmp_path_factory.mktemp("panes")
    for tile, rows in enumerate(tiles):
        Panes.of(scene.take(rows), standing.cameras, standing.options).write(folder / f"{tile}")
    return {tile: folder / f"{tile}" for tile in range(len(tiles))}


def among_panes(scene, tree, tiles, standing, panes, tile):
    """Views of a tile between panes of the others."""
    others = {other: path for other, path in panes.items() if other != tile}
    eyes = np.array([camera.position for camera in standing.cameras])
    split = tree.neighbourhoods()[int(tree.blocks[tile])]
    around = between(tile, split, others, standing.cameras, eyes, WHITE)
    views = Views.of(scene.take(tiles[tile]), standing.cameras)
    return replace(views, options=standing.options, between=around)


@pytest.mark.parametrize("tile", range(4))
def test_numbers_of_a_tile_are_worth_what_they_are_in_the_whole_scene(
    scene, tree, tiles, standing, panes, tile
):
    views = among_panes(scene, tree, tiles, standing, panes, tile)
    whole = replace(Views.of(scene, standing.cameras), options=standing.options)
    found = views.sensitivity(scene.take(tiles[tile]))
    right = whole.sensitivity(scene)[:, tiles[tile]]
    alone = replace(views, between={}).sensitivity(scene.take(tiles[tile]))

    def likeness(one):
        return np.corrcoef(np.sqrt(one).ravel(), np.sqrt(right).ravel())[0, 1]

    # Large splats of two tiles lie in one another: which is in front is not the same everywhere.
    assert likeness(found) > 0.93
    assert 1 - likeness(found) < 0.7 * (1 - likeness(alone))


def test_pictures_of_a_tile_with_other_sh_are_those_of_such_a_tile(
    scene, tree, tiles, standing, panes
):
    views = among_panes(scene, tree, tiles, standing, panes, 0)
    splats = scene.take(tiles[0])
    sh = splats.sh * np.float32(0.9)
    (found,) = views.psnr_of_sh(splats, [sh])
    assert found == pytest.approx(views.psnr(replace(splats, sh=sh)), abs=1e-3)
    assert views.psnr(splats) == 150


def test_of_two_boxes_that_of_the_eye_is_in_front():
    split = (0, 1.0, 7, (1, 5.0, 8, 9))
    assert list(_from_front(split, (0.0, 0.0, 0.0))) == [7, 8, 9]
    assert list(_from_front(split, (2.0, 6.0, 0.0))) == [9, 8, 7]


def test_a_neighbourhood_is_the_part_of_the_tree_that_has_its_tiles(tree):
    def tiles_of(split):
        return [split] if isinstance(split, int) else tiles_of(split[2]) + tiles_of(split[3])

    points = np.random.default_rng(0).normal(size=(3000, 3))
    for one in (tree, Tree.of(points, 1), Tree.of(points, 19)):
        found = one.neighbourhoods()
        assert sorted(found) == sorted(set(one.blocks.tolist()))
        for block, split in found.items():
            assert tiles_of(split) == np.flatnonzero(one.blocks == block).tolist()
