"""Tiles of scenes that are never in memory as a whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec import InputError, SplatParams, write_ply
from evogs_codec.io.ply import read_ply
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.encode import encode_files
from evogs_codec.jobs.partition import SPLATS_OF_STAND_IN, partition, rows_of, stand_ins_of
from evogs_codec.jobs.tile_tree import Tree
from evogs_codec.render import demo_scene
from evogs_codec.tileset.write import write_tileset
from tests.support.lifted_scenes import with_channels


def make_scene(n, degree):
    """A small scene of a degree."""
    scene = demo_scene.make_scene(n)
    return replace(scene, sh=scene.sh[:, : (degree + 1) ** 2])


def quiet(_stage, _part):
    pass


def rows_by_tile(made, d):
    paths = [rows_of(made.folder, tile) for tile in range(len(made.counts))]
    return [np.fromfile(path, "<f4").reshape(-1, d) for path in paths]


def in_order(rows):
    return rows[np.lexsort(rows.T)]


def parted(folder, scenes, per_tile=500):
    folder.mkdir()
    paths = []
    for number, scene in enumerate(scenes):
        paths.append(folder / f"{number}.ply")
        write_ply(paths[-1], scene)
    scratch = folder / "scratch"
    scratch.mkdir()
    return partition(SplatFiles(paths), scratch, quiet, per_tile)


def test_every_splat_is_in_one_tile_with_all_of_its_numbers(tmp_path):
    scene = make_scene(3000, 1)
    made = parted(tmp_path / "a", [scene])
    found = rows_by_tile(made, 23)
    for tile, rows in enumerate(found):
        rows[:, 0:3] += made.tree.origins[tile]
    assert made.counts.sum() == 3000
    together, right = in_order(np.concatenate(found)), in_order(scene.channels().T)
    np.testing.assert_allclose(together[:, 0:3], right[:, 0:3], atol=1e-5)
    np.testing.assert_array_equal(together[:, 3:], right[:, 3:])


def test_tiles_have_about_as_many_splats_each(tmp_path):
    made = parted(tmp_path / "a", [make_scene(4000, 0)], per_tile=600)
    assert len(made.counts) == 7
    assert made.counts.min() > 0.9 * 4000 / 7
    assert made.counts.max() < 1.1 * 4000 / 7


def test_neither_the_order_of_splats_nor_that_of_files_changes_a_tile(tmp_path):
    scene = make_scene(2000, 1)
    order = np.random.default_rng(3).permutation(2000)
    one = parted(tmp_path / "a", [scene])
    three = parted(tmp_path / "b", [scene.take(part) for part in np.array_split(order, 3)])
    np.testing.assert_array_equal(one.tree.value, three.tree.value)
    for a, b in zip(rows_by_tile(one, 23), rows_by_tile(three, 23), strict=True):
        np.testing.assert_array_equal(in_order(a), in_order(b))


def test_positions_far_from_the_origin_keep_what_a_file_of_doubles_has(tmp_path):
    n = 1000
    offsets = np.random.default_rng(0).uniform(0, 3, (n, 3))
    columns = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
    columns += [(f"f_dc_{k}", "<f4") for k in range(3)] + [("opacity", "<f4")]
    columns += [(f"scale_{k}", "<f4") for k in range(3)] + [(f"rot_{k}", "<f4") for k in range(4)]
    rows = np.zeros(n, columns)
    for axis, name in enumerate("xyz"):
        rows[name] = 1e6 + offsets[:, axis]
    types = {"<f8": "double", "<f4": "float"}
    head = "".join(f"property {types[kind]} {name}\n" for name, kind in columns)
    path = tmp_path / "far.ply"
    start = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n{head}end_header\n"
    path.write_bytes(start.encode() + rows.tobytes())
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    made = partition(SplatFiles([path]), scratch, quiet, 300)
    means = [
        own[:, 0:3].astype(np.float64) + made.tree.origins[tile]
        for tile, own in enumerate(rows_by_tile(made, 14))
    ]
    np.testing.assert_allclose(in_order(np.concatenate(means)), in_order(1e6 + offsets), atol=1e-6)
    assert np.abs(read_ply(path).means - (1e6 + offsets)).max() > 1e-2, "binary32 has not got it"


def test_splats_stand_in_for_each_tile(tmp_path):
    made = parted(tmp_path / "a", [make_scene(6000, 0)], per_tile=3000)
    for tile, n in enumerate(made.counts.tolist()):
        found = np.fromfile(stand_ins_of(made.folder, tile), "<f4").reshape(-1, 14)
        assert n / (2 * SPLATS_OF_STAND_IN) < len(found) < 2 * n / SPLATS_OF_STAND_IN


def test_more_splats_in_one_place_than_a_tile_can_have_are_refused(tmp_path):
    scene = make_scene(2000, 0)
    still = with_channels(scene, means=np.zeros(3))
    with pytest.raises(InputError, match="2,000 splats are in one place, near"):
        parted(tmp_path / "a", [still], per_tile=100)


def test_files_of_other_degrees_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"has SH degree 0, .* has 1"):
        parted(tmp_path / "a", [make_scene(100, 1), make_scene(100, 0)])


def test_files_of_other_degrees_leave_no_scratch_folder(tmp_path):
    paths = [tmp_path / "a.ply", tmp_path / "b.ply"]
    for path, degree in zip(paths, (1, 0), strict=True):
        write_ply(path, make_scene(100, degree))
    for write, out in ((encode_files, "a.evogs"), (write_tileset, "tiles")):
        with pytest.raises(InputError, match=r"b.ply: has SH degree 0, .*a.ply has 1"):
            write(paths, tmp_path / out)
    assert sorted(tmp_path.iterdir()) == paths


@given(st.integers(0, 60), st.integers(1, 9), st.integers(1, 3), st.integers(0, 9))
def test_a_tree_of_few_or_equal_points_has_a_tile_for_each(n, n_tiles, n_values, seed):
    points = np.random.default_rng(seed).integers(0, n_values, (n, 3)).astype(float)
    tree = Tree.of(points, n_tiles)
    tiles = tree.tile_of(points)
    assert 1 <= tree.n_tiles <= n_tiles
    assert len(tiles) == n
    assert np.all((tiles >= 0) & (tiles < tree.n_tiles))
    distinct = len(np.unique(points, axis=0))
    assert len(np.unique(tiles)) >= min(n_tiles, distinct, 2 if n else 0) or n_tiles == 1


def city_and_object(n, seed=0):
    """Positions and sizes of a kilometre of city and an object of 5 cm in it, so many of each."""
    random = np.random.default_rng(seed)
    city = random.uniform(-500, 500, (n, 3)) * [1, 1, 0.05]
    thing = np.array([40, 20, 1.5]) + random.uniform(-0.025, 0.025, (n, 3))
    sizes = np.repeat(np.log([1.0, 0.001]).astype(np.float32), n)
    return np.concatenate([city, thing]), sizes + random.normal(0, 0.5, 2 * n).astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_small_splats_that_are_apart_have_tiles_of_their_own(seed):
    points, sizes = city_and_object(3000, seed)
    tree = Tree.of(points, 6, sizes, least=20)
    counts = np.array(
        [np.bincount(part, minlength=tree.n_tiles) for part in np.split(tree.tile_of(points), 2)]
    )
    mixed = np.all(counts > 0, axis=0)
    assert counts[0, mixed].sum() < 0.01 * 3000, "a few of the city are beside the object"
    assert counts.sum(axis=0).max() < 1.3 * 1000
    assert tree.n_tiles < 15
    plain = Tree.of(points, 6)
    counts = np.array(
        [np.bincount(part, minlength=6) for part in np.split(plain.tile_of(points), 2)]
    )
    assert np.minimum(*counts).sum() > 300, "without sizes many are"


def test_a_scene_of_one_scale_is_cut_in_halves_whatever_its_sizes():
    scene = make_scene(4000, 0)
    points, sizes = scene.means.astype(np.float64), scene.log_scales.mean(axis=1)
    plain, sized = Tree.of(points, 4), Tree.of(points, 4, sizes, least=20)
    np.testing.assert_array_equal(plain.value, sized.value)


@pytest.mark.parametrize("low", [-1e30, -700.0, 0.0, 80.0])
def test_sizes_as_far_apart_as_numbers_go_are_cut_apart(low):
    points = np.arange(200.0)[:, None] * [1, 0, 0]
    sizes = np.where(points[:, 0] < 90, low, low + 1e30).astype(np.float32)
    tree = Tree.of(points, 1, sizes)
    assert tree.n_tiles == 2
    assert np.bincount(tree.tile_of(points)).tolist() == [90, 110]


def test_neither_order_nor_equal_coordinates_change_cuts_between_sizes():
    points, sizes = city_and_object(2000)
    points = np.round(points, 2)  # many are on one plane
    order = np.random.default_rng(1).permutation(len(points))
    one, other = (Tree.of(points[k], 6, sizes[k], least=20) for k in (np.arange(4000), order))
    for found in (one, other):
        assert found.n_tiles > Tree.of(points, 6).n_tiles, "some cuts are between sizes"
    for name in ("axis", "value", "child", "origins", "blocks"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.tile_of(points), other.tile_of(points))


def test_splats_that_are_not_finite_are_counted_or_refused(tmp_path):
    scene = make_scene(500, 0)
    logits = scene.opacity_logits.copy()
    logits[:3] = np.inf
    means = scene.means.copy()
    means[7, 1] = np.nan
    write_ply(
        tmp_path / "a.ply", SplatParams(means, scene.quats, scene.log_scales, logits, scene.sh)
    )
    with pytest.raises(InputError, match="--drop-invalid"):
        list(SplatFiles([tmp_path / "a.ply"]).blocks())
    files = SplatFiles([tmp_path / "a.ply"], drop_invalid=True)
    assert sum(len(block.splats) for block in files.blocks()) == 499
    assert (files.n_invalid, files.n_opaque) == (1, 3)


def test_memory_does_not_grow_with_the_file_that_is_read(tmp_path):
    status = Path("/proc/self/status")
    if not status.exists() or "RssFile" not in status.read_text():
        pytest.skip("the system does not say what is mapped")

    def mapped():
        return int(status.read_text().split("RssFile:")[1].split()[0]) * 1024

    write_ply(tmp_path / "a.ply", make_scene(1000, 1).take(np.arange(400_000) % 1000))
    before = mapped()
    most = max(mapped() for _ in SplatFiles([tmp_path / "a.ply"]).blocks())
    assert most - before < (tmp_path / "a.ply").stat().st_size / 2
