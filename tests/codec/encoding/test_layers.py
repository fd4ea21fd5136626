"""Layers of precision: all splats at coarse steps first, then refinements of every leaf."""

import json
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from numpy.testing import assert_array_equal

from evogs_codec import (
    PRESETS,
    Cut,
    Decoder,
    InputError,
    SplatParams,
    choose_cut,
    decode,
    decode_prefix,
    encode_scene,
    encode_scene_with_order,
    encode_tree,
    extract,
    lift,
    read_directory,
    read_ply,
    write_ply,
    write_tree,
)
from evogs_codec.editing.read_tree import read_coded_tree
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.layers import MAX_LAYERS, Layered
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.targets import TargetEncoder, _Coder
from evogs_codec.encoding.write import write
from evogs_codec.model.channels import N_GROUPS, n_channels
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render import cameras_around, load_cameras, save_cameras
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tests.codec.encoding.test_targets import in_quanta
from tests.support.shared_scenes import shared_scene, shared_tree

SETTINGS = replace(PRESETS["scene"], effort=1)
PRICE = 1e-10
N_LEVELS = 3


def views_of(splats):
    return Views(splats, cameras_around(splats, "z", 48)[::6])


@cache
def scene(n=400):
    """A lifted tree of the demo scene and views of its leaves."""
    tree = lift(make_scene(n), N_LEVELS)
    return tree, views_of(tree.leaves())


def aim(tree=None, **more):
    if tree is None:
        return TargetEncoder(scene()[0], SETTINGS, scene()[1], **more)
    return TargetEncoder(tree, SETTINGS, views_of(tree.leaves()), **more)


def at_a_price(tree, layers, price=PRICE, **more):
    """A stream that nothing was searched for."""
    return write(_Coder(aim(tree, layers=layers, **more)).coded(price), effort=1)


@cache
def stream(layers, decibels=40.0):
    return aim(layers=layers).at_psnr(decibels)


@cache
def many(layers=3):
    """A tree whose layers have several steps each, and its stream."""
    tree = lift(make_scene(2500), N_LEVELS)
    return tree, at_a_price(tree, layers)


def psnr(data, tree=None, **cut):
    tree, views = scene() if tree is None else (tree, views_of(tree.leaves()))
    leaves = decode(data, **cut).leaves(sh_degree=tree.shown_degree)
    return views.psnr(leaves)


def all_ones(splats):
    return np.ones((n_channels(splats.sh_degree), len(splats)), np.float32)


def layered(tree, n_layers, n_tiles=1):
    tiles = arrange(tree, n_tiles)
    importance = Importance.of(tiles, tree.n_levels, all_ones)
    return tiles, Layered.of(tiles, tree.n_levels, importance, n_layers)


def dropping(tree, slots):
    """The tree, which drops these slots in its last level."""
    d, slots = n_channels(tree.sh_degree), np.asarray(slots, np.int32)
    drops = Step(
        tree.n_levels - 1,
        slots,
        np.full(len(slots), Kind.DROP, np.uint8),
        np.empty((d, 0), np.float32),
        np.empty((N_GROUPS, 0), np.float32),
        np.empty((d, 0), np.float32),
    )
    return replace(tree, steps=(*tree.steps, drops))


# --- what layers are ------------------------------------------------------------------------------


@pytest.mark.parametrize("layers", [1, 2, 3])
def test_all_splats_meet_the_target_and_each_further_layer_is_a_level(layers):
    found = decode(stream(layers), verify=True)
    assert found.n_leaves == scene()[0].n_leaves
    assert found.directory.n_levels == N_LEVELS + layers - 1
    assert psnr(stream(layers)) == pytest.approx(40, abs=0.2)


def test_fine_layers_have_the_splats_of_one_layer_in_the_same_order():
    one, three = (
        decode(at_a_price(scene()[0], layers, 1e-15)).leaves().channels() for layers in (1, 3)
    )
    assert np.median(np.abs(one - three)) < 1e-3
    assert np.quantile(np.abs(one - three), 0.99) < 0.1


@pytest.mark.thorough
def test_the_leaf_order_is_that_of_the_layered_stream():
    splats = make_scene(200)
    cameras = views_of(splats).cameras
    found = encode_scene_with_order(
        splats, levels=2, target_bytes=9000, layers=2, cameras=cameras, effort=1
    )
    leaves = decode(found.data).leaves()
    off = np.abs(leaves.sh[:, 0] - splats.sh[found.leaf_order, 0])
    assert np.quantile(off, 0.9) < 0.1


@pytest.mark.parametrize("n_tiles", [1, 3])
def test_layers_refine_every_leaf_once_each_and_split_none(n_tiles):
    tree = many()[0]
    tiles, found = layered(tree, 4, n_tiles)
    assert (found.n_levels, found.n_coarse) == (N_LEVELS + 3, N_LEVELS)
    for before, after in zip(tiles, found.tiles, strict=True):
        n = len(before.steps)
        assert after.steps[:n] == before.steps
        (*_, state) = before.states()
        leaves = np.flatnonzero(state.live)
        for level in range(N_LEVELS, found.n_levels):
            own = [step for step in after.steps[n:] if step.level == level]
            assert all((step.kinds == Kind.REFINE).all() and not step.n_new for step in own)
            assert_array_equal(np.sort(np.concatenate([step.slots for step in own])), leaves)
            assert not any(step.psi.any() for step in own)
        assert_array_equal(after.leaves().channels(), before.leaves().channels())


def test_a_stream_has_the_refinements_of_its_layers_in_parts():
    tree, data = many()
    coded = read_coded_tree(data)
    for level in (N_LEVELS, N_LEVELS + 1):
        own = [step for step in coded.tiles[0].steps if step.level == level]
        assert len(own) > 1
        assert all((step.kinds == Kind.REFINE).all() for step in own)
        assert_array_equal(
            np.sort(np.concatenate([step.slots for step in own])), np.arange(tree.n_leaves)
        )


def test_the_most_important_leaves_are_refined_first():
    _, found = layered(many()[0], 2)
    rising = np.arange(found.importance.leaves[0].size, dtype=np.float32)
    weights = [rising.reshape(found.importance.leaves[0].shape)]
    importance = replace(found.importance, leaves=weights)
    again = Layered.of(arrange(many()[0], 1), N_LEVELS, importance, 2)
    first, last = again.leaves[0][0], again.leaves[0][-1]
    assert first.min() > last.max()


@pytest.mark.parametrize("price", [1e-13, 1e-10, 1e-7])
def test_steps_of_layers_divide_those_of_the_tree_by_odd_numbers(price):
    tree, views = scene()
    tiles = arrange(tree, 1)
    importance = Importance.of(tiles, N_LEVELS, views.sensitivity)
    table = Layered.of(tiles, N_LEVELS, importance, MAX_LAYERS).steps(price, 1.0)
    assert table.shape == (N_LEVELS + MAX_LAYERS, 5 + tree.sh_degree)
    ratios = table[N_LEVELS] / table[N_LEVELS + 1 :]
    np.testing.assert_allclose(ratios, np.rint(ratios))
    assert (np.rint(ratios) % 2 == 1).all()
    assert (np.diff(ratios, axis=0) >= 0).all()
    wanted = importance.steps_of_leaves(price, 1.0)
    assert np.all(np.abs(table[-1] / wanted - 1) <= 1 / ratios[-1] + 1e-9)


def test_one_layer_is_as_if_there_were_none():
    tree, views = scene()
    tiles = arrange(tree, 1)
    importance = Importance.of(tiles, N_LEVELS, views.sensitivity)
    one = Layered.of(tiles, N_LEVELS, importance, 1)
    assert_array_equal(one.steps(PRICE, 1.0), importance.steps(PRICE, 1.0))
    for own, other in zip(
        one.weights(PRICE, 1.0)[0], importance.raised(PRICE, 1.0)[0], strict=True
    ):
        assert_array_equal(own.targets, other.targets)
        assert_array_equal(own.new, other.new)


# --- prefixes and levels --------------------------------------------------------------------------


def test_every_level_decodes_and_those_of_layers_have_all_splats():
    data = stream(3)
    directory = read_directory(data)
    found = [psnr(data, cut=Cut.of_level(directory, k)) for k in range(directory.n_levels)]
    counts = [decode(data, Cut.of_level(directory, k)).n_leaves for k in range(directory.n_levels)]
    assert counts[:2] == sorted(set(counts[:2]))
    assert counts[2:] == [scene()[0].n_leaves] * 3
    assert found[2:] == sorted(found[2:])
    assert found[-1] > found[2] + 10


@pytest.mark.parametrize("make", [partial(stream, 3), lambda: many()[1]])
def test_every_prefix_of_packets_decodes_alike_at_once_and_bit_by_bit(make):
    data = make()
    directory = read_directory(data)
    decoder = Decoder()
    at = 0
    for end in (directory.offsets + directory.packets["size"]).tolist():
        decoder.feed(data[at:end])
        at = end
        found = decode_prefix(data[:end])
        assert decoder.cut == found.cut
        assert_array_equal(decoder.leaves().channels(), found.leaves().channels())
    decoder.close()
    assert decoder.is_complete


@pytest.mark.thorough
def test_half_of_the_bytes_look_better_than_those_of_one_layer():
    tree = lift(make_scene(1500), 4)
    one, three = (aim(tree, layers=layers).at_psnr(45) for layers in (1, 3))
    half = len(one) // 2
    views = views_of(tree.leaves())
    found = [views.psnr(decode_prefix(data[:half]).leaves()) for data in (one, three)]
    assert found[1] > found[0] + 5
    assert len(three) < 1.15 * len(one)


def test_a_layer_may_be_the_last_that_is_extracted():
    data = stream(3)
    directory = read_directory(data)
    for level in range(directory.n_levels):
        part = extract(data, choose_cut(directory, level=level))
        assert len(part) < len(data) or level == directory.n_levels - 1
        whole = decode(data, Cut.of_level(directory, level)).leaves()
        assert_array_equal(decode(part).leaves().channels(), whole.channels())


def test_errors_of_the_directory_fall_from_layer_to_layer_to_none():
    steps = read_coded_tree(stream(3)).tiles[0].steps
    errors = np.array([step.error for step in steps])
    assert np.all(np.diff(errors, axis=0) <= 0)
    assert errors[-2, 0] > 0
    assert not errors[-1].any()


def test_a_stream_read_back_is_the_same_and_may_be_written_again():
    data = stream(2)
    coded = read_coded_tree(data)
    again = write(coded, effort=1)
    assert decode(again, verify=True).leaves().channels().tobytes() == (
        decode(data).leaves().channels().tobytes()
    )


# --- scenes and options ---------------------------------------------------------------------------


def test_the_same_bytes_twice():
    assert aim(layers=2).at_psnr(40) == stream(2)


def test_a_palette_is_as_exact_as_in_one_layer_because_no_layer_refines_it():
    _, tree = shared_tree(shared_scene(600, 30), N_LEVELS)
    tiles = arrange(tree, 1)
    importance = Importance.of(tiles, N_LEVELS, views_of(tree.leaves()).sensitivity)
    found = Layered.of(tiles, N_LEVELS, importance, 3).steps(PRICE, 1.0)
    assert_array_equal(found[0, 5:], importance.steps(PRICE, 1.0)[0, 5:])
    assert np.all(found[0, :5] > importance.steps(PRICE, 1.0)[0, :5])


@pytest.mark.thorough
@pytest.mark.parametrize("layers", [2, 3])
def test_a_scene_with_a_palette_meets_its_target_in_layers(layers):
    splats = shared_scene(600, 30)
    cameras = views_of(splats).cameras
    found = encode_scene_with_order(
        splats, levels=N_LEVELS, target_psnr=45, layers=layers, cameras=cameras, effort=1
    )
    one = encode_scene(splats, levels=N_LEVELS, target_psnr=45, cameras=cameras, effort=1)
    assert read_directory(found.data).has_palette
    assert psnr(found.data, found.tree) == pytest.approx(45, abs=0.2)
    assert len(found.data) < 1.2 * len(one)


@pytest.mark.parametrize("n_tiles", [2, 5])
def test_several_tiles(n_tiles):
    one = at_a_price(scene()[0], 2)
    data = at_a_price(scene()[0], 2, n_tiles=n_tiles)
    found = decode(data, verify=True)
    assert len(found.directory.tiles) == n_tiles
    assert found.n_leaves == 400
    assert psnr(data) == pytest.approx(psnr(one), abs=3)


def test_a_tree_of_one_level():
    tree = lift(make_scene(300), 1)
    data = aim(tree, layers=3).at_psnr(40)
    found = decode(data, verify=True)
    assert (found.n_leaves, found.directory.n_levels) == (300, 3)
    assert psnr(data, tree) == pytest.approx(40, abs=0.2)


@pytest.mark.parametrize("n", [1, 2, 7])
@pytest.mark.parametrize("n_tiles", [1, 3])
def test_few_splats(n, n_tiles):
    tree = lift(make_scene(50).take(np.arange(n)), N_LEVELS)
    data = at_a_price(tree, 3, 1e-8, n_tiles=n_tiles)
    found = decode(data, verify=True)
    assert (found.n_leaves, found.directory.n_levels) == (n, N_LEVELS + 2)
    assert psnr(data, tree) > 35


def test_no_splats_have_no_layers():
    empty = make_scene(10).take(np.zeros(0, np.int64))
    with pytest.raises(InputError, match="without splats has nothing to aim at"):
        encode_scene(empty, target_psnr=40, layers=2)
    tree = scene()[0]
    gone = dropping(tree, np.arange(tree.n_leaves))
    data = write(_Coder(TargetEncoder(gone, SETTINGS, scene()[1], layers=2)).coded(PRICE))
    assert (decode(data).n_leaves, read_directory(data).n_levels) == (0, N_LEVELS)


@pytest.mark.parametrize("n_tiles", [1, 4])
def test_leaves_that_were_dropped_are_not_refined(n_tiles):
    """Half of the slots; of four tiles some have no leaves then."""
    tree = scene()[0]
    (*_, state) = tree.states()
    gone = np.flatnonzero(state.values[0] > np.median(state.values[0]))
    cut = dropping(tree, gone)
    data = at_a_price(cut, 3, n_tiles=n_tiles)
    found = decode(data, verify=True)
    assert found.n_leaves == cut.n_leaves == 200
    assert psnr(data, cut) > 38


def test_a_tree_that_was_trained_in_integers():
    tree = in_quanta()
    cameras = views_of(tree.leaves()).cameras
    data = encode_tree(tree, target_psnr=45, layers=2, effort=1, cameras=cameras)
    assert read_directory(data).n_levels == tree.n_levels + 1
    assert psnr(data, tree) == pytest.approx(45, abs=0.2)


@pytest.mark.thorough
def test_polishing_moves_the_last_layer_even_of_a_tree_of_one_level(recwarn):
    splats = make_scene(300)
    cameras = cameras_around(splats, "z", 64)
    for levels in (1, 3):
        options: dict[str, Any] = {
            "levels": levels,
            "target_psnr": 38,
            "layers": 2,
            "effort": 1,
            "cameras": cameras,
        }
        plain = encode_scene(splats, **options)
        found = encode_scene(splats, polish=60, **options)
        assert len(found) < len(plain)
        views = Views.of(lift(splats, levels).leaves(), cameras, descent=True)
        assert views.psnr(decode(found).leaves()) == pytest.approx(38, abs=0.2)
    assert not [warning for warning in recwarn if "polishing" in str(warning.message)]


def test_a_target_of_bytes():
    n_bytes = 9000
    data = aim(layers=3).at_bytes(n_bytes)
    assert 0.98 * n_bytes <= len(data) <= n_bytes
    assert read_directory(data).n_levels == N_LEVELS + 2


@pytest.mark.thorough
def test_more_effort_takes_no_more_bytes_for_the_same_splats():
    hard = replace(aim(layers=2), settings=replace(SETTINGS, effort=19)).at_psnr(40)
    assert len(hard) <= len(stream(2))
    assert_array_equal(decode(hard).leaves().channels(), decode(stream(2)).leaves().channels())


def test_as_many_layers_as_there_may_be():
    data = at_a_price(scene()[0], MAX_LAYERS)
    assert read_directory(data).n_levels == N_LEVELS + MAX_LAYERS - 1
    assert psnr(data) > 38


# --- what cannot be done --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"layers": 2}, ValueError, "layers need target_psnr or target_bytes"),
        ({"layers": 2, "max_error": 0.1}, ValueError, "layers need target_psnr or target_bytes"),
        ({"layers": 0, "target_psnr": 40}, ValueError, r"layers is 0, expected 1\.\.8"),
        ({"layers": 9, "target_psnr": 40}, ValueError, r"layers is 9, expected 1\.\.8"),
        (
            {"layers": 2, "target_psnr": 40, "cameras": ()},
            InputError,
            "a target PSNR needs rendered views: there are no cameras",
        ),
        (
            {"layers": 2, "target_bytes": 4000, "cameras": ()},
            InputError,
            "several layers need rendered views: there are no cameras",
        ),
        (
            {"layers": 2, "target_psnr": 40, "levels": 64},
            InputError,
            "a tree of 64 levels in 2 layers has 65 levels: a stream has at most 64",
        ),
    ],
)
def test_what_does_not_go_with_layers_is_refused(options, error, words):
    with pytest.raises(error, match=words):
        encode_scene(make_scene(60), effort=1, **options)


def test_without_numba_layers_have_no_views(monkeypatch):
    monkeypatch.setattr("evogs_codec.scene.request.find_spec", lambda _: None)
    with pytest.raises(InputError, match="several layers need rendered views: numba is missing"):
        encode_scene(make_scene(60), target_bytes=4000, layers=2)


def test_an_encoder_without_views_refuses_layers_and_bounds_errors_without_them():
    plain = TargetEncoder(scene()[0], SETTINGS, layers=2)
    with pytest.raises(ValueError, match="layers need views"):
        plain.at_bytes(9000)
    assert read_directory(plain.within({"position": 0.01})).n_levels == N_LEVELS


# --- the command line -----------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_command_makes_shows_and_decodes_layers(evogs, tmp_path):
    scene_file, cameras, out = (tmp_path / name for name in ("in.ply", "views.json", "out.evogs"))
    write_ply(scene_file, make_scene(300))
    save_cameras(cameras, views_of(make_scene(300)).cameras)
    options = [
        "--levels",
        "2",
        "--target-bytes",
        "9000",
        "--layers",
        "3",
        "--effort",
        "1",
        "--json",
    ]
    code, said, errors = evogs("encode", scene_file, out, "--camera", cameras, *options)
    assert (code, errors) == (0, "")
    assert [level["n_leaves"] for level in json.loads(said)["levels"]][1:] == [300] * 3
    data = out.read_bytes()
    seen = load_cameras(cameras)
    assert data == encode_scene(
        read_ply(scene_file), levels=2, target_bytes=9000, layers=3, effort=1, cameras=seen
    )
    code, said, _ = evogs("info", out, "--json")
    assert (code, len(json.loads(said)["levels"])) == (0, 4)
    for level in (1, 2, 3):
        cut = Cut.of_level(read_directory(data), level)
        wanted = decode(data, cut).leaves()
        part, ply = tmp_path / "part.evogs", tmp_path / "part.ply"
        assert evogs("extract", out, part, "--level", level)[0] == 0
        assert_array_equal(decode(part.read_bytes()).leaves().channels(), wanted.channels())
        assert evogs("decode", out, ply, "--level", level)[0] == 0
        assert len(read_ply(ply)) == 300
        part.unlink()
        ply.unlink()


def test_the_command_makes_layers_of_a_tree(evogs, tmp_path):
    write_tree(tmp_path / "in.tree.npz", in_quanta())
    save_cameras(tmp_path / "views.json", views_of(in_quanta().leaves()).cameras)
    options = ["--target-psnr", "45", "--layers", "2", "--camera", tmp_path / "views.json"]
    assert evogs("encode", tmp_path / "in.tree.npz", tmp_path / "out.evogs", *options)[0] == 0
    assert read_directory(tmp_path / "out.evogs").n_levels == 4


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--layers", "2"], 1, "--layers needs --target-psnr or --target-bytes"),
        (["--layers", "2", "--max-error", "0.1"], 1, "--layers needs --target-psnr"),
        (["--layers", "0", "--target-psnr", "40"], 2, "argument --layers"),
        (["--layers", "9", "--target-psnr", "40"], 2, "argument --layers"),
        (["--layers", "two", "--target-psnr", "40"], 2, "argument --layers"),
        (["--layers", "2", "--target-psnr", "40", "--levels", "64"], 1, "at most 64"),
    ],
)
def test_the_command_refuses_layers_that_cannot_be(refused, tmp_path, options, code, words):
    write_ply(tmp_path / "in.ply", make_scene(60))
    out = tmp_path / "out.evogs"
    refused("encode", tmp_path / "in.ply", out, *options, words=[words], code=code)
    assert not out.exists()


def test_a_splat_far_away_and_numbers_at_their_limits_are_layered():
    channels = make_scene(200).channels().copy()
    channels[0:3, 0] = 1e6
    channels[7:10, 1] = 12
    channels[10, 2:4] = [80, -80]
    tree = lift(SplatParams.from_channels(channels), N_LEVELS)
    data = at_a_price(tree, 3)
    assert decode(data, verify=True).n_leaves == 200
