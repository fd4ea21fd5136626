"""The last level of a tree, late: no picture before it changes, and none is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import (
    PRESETS,
    Cut,
    TargetEncoder,
    decode,
    encode_scene,
    encode_scene_with_order,
    encode_tree,
    encode_tree_with_order,
    leaf_order,
    lift,
    read_directory,
)
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.late_level import LateLevel, can_be_late
from evogs_codec.encoding.layers import Layering
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.tree import EvolutionTree, Kind, Step
from evogs_codec.render import Views, cameras_around, psnr, render
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene.falls import steady

SPLATS = make_scene(900)
TREE = lift(SPLATS)
LAST = TREE.n_levels - 1
VIEWS = Views(SPLATS, cameras_around(SPLATS, "z", 80, n=6))
WHITE = (1.0, 1.0, 1.0)


SHARED = replace(
    SPLATS, sh=np.concatenate([SPLATS.sh[:, :1], SPLATS.sh[:7][np.arange(900) % 7, 1:]], 1)
)


def with_entries() -> EvolutionTree:
    """A tree with a palette."""
    found = with_palette(lift_with_order(SHARED), SHARED)
    assert found is not None
    return found


def parts_of(tile, n_parts):
    """(n,) part of each slot, the same of all that come from one add; any part has some."""
    born_from, _ = tile.lineage()
    parts = np.arange(len(born_from)) * 7 % n_parts
    for slot in np.flatnonzero(born_from >= 0):
        parts[slot] = parts[born_from[slot]]
    return parts


def test_a_tile_whose_last_level_only_refines_needs_no_room():
    whole = lift(make_scene(300), 2)
    refines = Step.of_refines(1, np.arange(5), np.full((len(whole.steps[0].adds), 5), 0.1))
    tile = replace(whole, steps=(whole.steps[0], refines))
    late = LateLevel.of(tile, 1, parts_of(tile, 2))
    assert list(late.n_rooms) == [0, 0]
    np.testing.assert_allclose(late.lacks[:, :5], 0.1, atol=1e-6)
    assert not late.lacks[:, 5:].any()


def test_the_steps_of_a_late_level_make_room_as_one_in_each_part():
    (tile,) = arrange(lift(make_scene(4000), 3), 1)
    aimed = tile.leaves().channels()  # no slot of this tree is dropped
    assert sum(step.level == 2 for step in tile.steps) > 1
    late = LateLevel.of(tile, 2, parts_of(tile, 3))
    assert late.n_rooms == [1, 1, 1]
    slots = np.arange(late.lacks.shape[1])
    np.testing.assert_array_equal(late.name[late.order], slots)
    np.testing.assert_array_equal(np.sort(late.order), slots)
    refined = replace(late.tile, steps=(*late.tile.steps, Step.of_refines(2, slots, late.lacks)))
    np.testing.assert_allclose(refined.leaves().channels(), aimed[:, late.order], atol=1e-4)


@pytest.mark.parametrize("n_parts", [1, 4])
@pytest.mark.parametrize("n_tiles", [1, 3])
def test_a_late_level_makes_room_in_no_picture_and_lacks_what_its_splats_are(n_tiles, n_parts):
    for tile in arrange(TREE, n_tiles):
        late = LateLevel.of(tile, LAST, parts_of(tile, n_parts))
        assert len(late.n_rooms) == n_parts
        assert all(late.n_rooms)
        camera = cameras_around(SPLATS, size=64, n=1)[0]
        before = render(tile.leaves(LAST - 1), camera, WHITE)
        assert psnr(render(late.tile.leaves(), camera, WHITE), before) > 50
        slots = np.arange(late.lacks.shape[1])
        refined = replace(
            late.tile, steps=(*late.tile.steps, Step.of_refines(LAST, slots, late.lacks))
        )
        aimed = tile.leaves().channels()[:, late.order]  # no slot of this tree is dropped
        np.testing.assert_allclose(refined.leaves().channels(), aimed, atol=1e-4)
        np.testing.assert_array_equal(late.name[late.order], slots)


def test_slots_that_a_late_level_makes_for_a_part_are_in_a_row():
    (tile,) = arrange(TREE, 1)
    parts = parts_of(tile, 4)
    late = LateLevel.of(tile, LAST, parts)
    n = sum(step.n_new for step in tile.steps if step.level < LAST)
    np.testing.assert_array_equal(late.order[:n], np.arange(n))
    assert (np.diff(parts[late.order[n:]]) >= 0).all()
    ends = np.cumsum(late.n_rooms)
    made = late.tile.steps[-ends[-1] :]
    for part, end in enumerate(ends):
        for step in made[end - late.n_rooms[part] : end]:
            assert (parts[late.order[step.slots]] == part).all()


def test_of_a_palette_no_pick_changes_before_the_splats_of_a_late_level_come():
    tree = with_entries()
    (tile,) = arrange(tree, 1)
    late = LateLevel.of(tile, tree.n_levels - 1, parts_of(tile, 3))
    made = late.tile.steps[-sum(late.n_rooms) :]
    assert sum(step.n_new for step in made) > 400
    assert not any(len(step.picks) or len(step.changed_picks) for step in made)
    (*_, shown) = late.tile.states()
    (*_, aimed) = tile.states()
    np.testing.assert_array_equal(late.picks, aimed.picks[late.order])
    born_from, _ = late.tile.lineage()
    n = sum(step.n_new for step in late.tile.steps[: -sum(late.n_rooms)])
    np.testing.assert_array_equal(shown.picks[n:], shown.picks[born_from[n:]])


def test_a_stream_with_a_palette_and_a_late_level_has_the_picks_of_its_tree():
    tree = with_entries()
    views = Views(SHARED, cameras_around(SHARED, "z", 80, n=6))
    aim = TargetEncoder(tree, PRESETS["scene"], views, layers=2)
    price = 4e-6 / len(SHARED)
    early, late = aim.at_price(price), aim.holding((), Layering(2, is_late=True)).at_price(price)
    assert abs(aim.psnr(late) - aim.psnr(early)) < 0.6
    assert len(late) < 1.1 * len(early)
    assert read_directory(late).n_levels == read_directory(early).n_levels - 1
    rows = read_directory(late).packets
    assert np.count_nonzero((rows["component"] == 4) & (rows["size"] == 0)) > 0


@pytest.mark.parametrize("n_tiles", [1, 2])
def test_a_stream_with_a_late_level_shows_as_much_and_has_a_level_less(n_tiles):
    aim = TargetEncoder(TREE, PRESETS["scene"], VIEWS, layers=2, n_tiles=n_tiles)
    price = 4e-6 / len(SPLATS)
    early = aim.at_price(price)
    late = aim.holding((), Layering(2, is_late=True)).at_price(price)
    directories = read_directory(early), read_directory(late)
    assert [directory.n_levels for directory in directories] == [LAST + 2, LAST + 1]
    assert abs(aim.psnr(late) - aim.psnr(early)) < 0.6
    assert len(late) < 1.1 * len(early)
    first, second = (
        decode(data, Cut.of_level(directory, LAST - 2)).leaves(sh_degree=3)
        for data, directory in zip((early, late), directories, strict=True)
    )
    np.testing.assert_array_equal(first.means, second.means)


def test_drops_of_a_late_level_come_with_the_room():
    drops = np.array([3, 40, 41], np.int32)
    kinds = np.full(len(drops), Kind.DROP, np.uint8)
    step = replace(
        Step.of_refines(LAST, drops, np.zeros((len(TREE.steps[0].adds), 0))), kinds=kinds
    )
    tree = replace(TREE, steps=(*TREE.steps, step))
    assert can_be_late([tree], tree.n_levels)
    late = LateLevel.of(tree, LAST, parts_of(tree, 1))
    slots = np.flatnonzero(late.tile.lineage()[1])
    assert len(slots) == len(SPLATS) - len(drops)
    refine = Step.of_refines(LAST, slots, late.lacks[:, slots])
    found = replace(late.tile, steps=(*late.tile.steps, refine)).leaves().channels()
    np.testing.assert_allclose(found, tree.leaves().channels(), atol=1e-4)


@pytest.mark.thorough
def test_a_stream_far_better_than_its_coarse_splats_has_a_layer_between(monkeypatch):
    refined = {}  # splats that the last level of the tree refines
    for wide in (-np.inf, np.inf):
        monkeypatch.setattr(steady, "WIDE_DB", wide)
        for layers in (None, 2):
            data = encode_tree(TREE, target_psnr=50, cameras=VIEWS.cameras, layers=layers)
            assert abs(VIEWS.psnr(decode(data).leaves(sh_degree=3)) - 50) < 0.5
            directory = read_directory(data)
            assert directory.n_levels == LAST + 2
            rows = directory.packets[directory.labels == LAST]
            refined[wide, layers] = int(rows["n_refines"].sum())
    assert refined.pop((-np.inf, None)) == len(SPLATS)
    assert max(refined.values()) < len(SPLATS) // 4


def test_channels_that_a_late_level_does_not_change_are_refined_too():
    """All scales are alike, so nothing lacks but what coarse steps have left."""
    splats = replace(SPLATS, log_scales=np.full_like(SPLATS.log_scales, -3.03))
    tree = lift(splats)
    views = Views(splats, cameras_around(splats, "z", 80, n=6))
    aim = TargetEncoder(tree, PRESETS["scene"], views, layers=2)
    data = aim.holding((), Layering(2, is_late=True)).at_price(4e-8 / len(splats))
    found = decode(data).leaves(sh_degree=3).channels()[GROUP_CHANNELS[2]]
    assert np.sqrt(np.square(found + 3.03).mean()) < 0.02


def test_which_trees_can_have_a_late_level():
    assert can_be_late([TREE], TREE.n_levels)
    assert not can_be_late([EvolutionTree.of_splats(SPLATS)], 1)
    adds = Step.of_adds(1, SPLATS.channels()[:, :5])
    assert not can_be_late([replace(TREE, steps=(TREE.steps[0], adds))], 2)


@pytest.mark.thorough
def test_a_last_level_that_looks_hardly_better_is_late(monkeypatch):
    n_levels = {}
    for by in (-np.inf, np.inf):
        for limit in ("LATE_GAIN_DB", "LATE_GAIN_IF_SOME_FALL_DB"):
            monkeypatch.setattr(f"evogs_codec.encoding.late_level.{limit}", by)
        data = encode_scene(SPLATS, levels=LAST + 1, effort=1)
        n_levels[by] = read_directory(data).n_levels
        assert VIEWS.psnr(decode(data).leaves(sh_degree=3)) > 35
    assert n_levels == {-np.inf: LAST + 2, np.inf: LAST + 1}
    asked = encode_scene(SPLATS, levels=LAST + 1, layers=2, effort=1)
    assert read_directory(asked).n_levels == LAST + 2


@pytest.mark.thorough
def test_the_order_of_a_scene_is_that_of_a_stream_whose_last_level_is_late(monkeypatch):
    monkeypatch.setattr("evogs_codec.encoding.late_level.LATE_GAIN_DB", np.inf)
    monkeypatch.setattr("evogs_codec.encoding.layer_parts.MIN_LEAVES", 150)
    found = encode_scene_with_order(SPLATS, levels=LAST + 1, cameras=VIEWS.cameras, effort=1)
    assert read_directory(found.data).n_levels == LAST + 1
    assert sorted(found.leaf_order) == list(range(len(SPLATS)))
    means = decode(found.data).leaves().means
    arranged = found.leaf_of[leaf_order(found.tree)]
    off, plainly = (
        np.quantile(np.abs(means - SPLATS.means[order]).max(axis=1), 0.9)
        for order in (found.leaf_order, arranged)
    )
    assert off < 0.05
    assert plainly > 10 * off


@pytest.mark.thorough
def test_the_order_of_a_tree_is_that_of_a_stream_whose_last_level_is_late(monkeypatch):
    monkeypatch.setattr("evogs_codec.encoding.late_level.LATE_GAIN_DB", np.inf)
    monkeypatch.setattr("evogs_codec.encoding.layer_parts.MIN_LEAVES", 150)
    found = encode_tree_with_order(TREE, target_psnr=40, cameras=VIEWS.cameras, effort=1)
    assert found.orders is not None
    leaves = TREE.leaves()
    assert sorted(found.leaf_order) == list(range(len(leaves)))
    off = np.abs(decode(found.data).leaves().means - leaves.means[found.leaf_order]).max(axis=1)
    assert np.quantile(off, 0.9) < 0.05
