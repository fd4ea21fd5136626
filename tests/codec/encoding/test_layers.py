"""Layers of precision: all splats at coarse steps first, then refinements of every leaf."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from numpy.testing import assert_array_equal

from evogs_codec import (
    Cut,
    Decoder,
    choose_cut,
    decode,
    decode_prefix,
    encode_scene_with_order,
    extract,
    lift,
    read_directory,
)
from evogs_codec.editing.read_tree import read_coded_tree
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.layer_parts import parts_of_leaves
from evogs_codec.encoding.layers import (
    EVENING_POWER,
    FINER_SHARED,
    MAX_LAYERS,
    PRICE_RATIO,
    Layered,
    Layering,
)
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.write import write
from evogs_codec.model.tree import Kind
from evogs_codec.render.demo_scene import make_scene
from tests.support.layered import (
    N_LEVELS,
    PRICE,
    aim,
    at_a_price,
    layered,
    many,
    psnr,
    scene,
    stream,
    views_of,
)

# --- what layers are ------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("layers", [1, 2, 3])
def test_all_splats_meet_the_target_and_each_further_layer_is_a_level(layers):
    found = decode(stream(layers), verify=True)
    assert found.n_leaves == scene()[0].n_leaves
    assert found.directory.n_levels == N_LEVELS + layers - 1
    assert psnr(stream(layers)) == pytest.approx(40, abs=0.2)


@pytest.mark.thorough
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


def test_siblings_are_refined_in_the_same_step():
    _, found = layered(many()[0], 2)
    n_pairs = sum(int(own.is_second.sum()) for own in found.of_tiles[0].siblings)
    (step, *_) = (step for step in found.tiles[0].steps if not step.level)
    n_leaves = sum(len(part) for part in found.of_tiles[0].leaves)
    assert len(found.of_tiles[0].siblings) > 1
    assert n_pairs == n_leaves - step.n_adds  # all leaves but the first of each family


def test_weights_far_apart_make_no_more_parts_than_there_may_be():
    ancestors = np.arange(20_000)
    weights = np.full((5, 20_000), 1e-9, np.float32)
    weights[:, :300] = 1.0
    parts = parts_of_leaves(weights, ancestors, 4)
    assert len(parts) == 4
    assert_array_equal(np.sort(np.concatenate(parts)), ancestors)


@pytest.mark.parametrize(
    ("n_elsewhere", "n_layers", "n_parts"), [(0, 2, 10), (0, 3, 8), (2, 2, 5), (99, 3, 4)]
)
def test_late_levels_of_streams_of_many_tiles_or_layers_have_fewer_parts(
    monkeypatch, n_elsewhere, n_layers, n_parts
):
    tiles, found = layered(many()[0], 2)
    for name in ("MIN_LEAVES", "MIN_FAMILY"):
        monkeypatch.setattr(f"evogs_codec.encoding.layer_parts.{name}", 16)
    layering = Layering(n_layers, is_late=True)
    late = Layered(tiles, N_LEVELS - 1, found.importance, layering, n_elsewhere)
    (tile,) = late.of_tiles
    assert len(tile.leaves) == n_parts


@pytest.mark.thorough
def test_parts_of_a_layer_have_about_as_many_bytes_each():
    """Important leaves take more bits: parts of as many leaves have up to 1.6 times the mean."""
    directory = read_directory(at_a_price(lift(make_scene(20_000), N_LEVELS), layers=2))
    sizes = [int(packet["size"]) for packet in directory.packets if packet["level"] == N_LEVELS]
    assert len(sizes) >= 9
    assert max(sizes) <= 1.3 * np.mean(sizes)


@pytest.mark.parametrize("seed", range(3))
def test_the_most_important_leaves_are_refined_first(monkeypatch, seed):
    _, found = layered(many()[0], 2)
    shape = found.importance.leaves[0].shape
    weights = np.random.default_rng(seed).lognormal(sigma=3, size=shape).astype(np.float32)
    importance = replace(found.importance, leaves=[weights])
    monkeypatch.setattr("evogs_codec.encoding.layer_parts.MIN_LEAVES", 256)
    again = Layered.of(arrange(many()[0], 1), N_LEVELS, importance, Layering(2))
    of_leaves = (weights / weights.mean(axis=1, keepdims=True)).mean(axis=0)
    of_parts = [of_leaves[part].mean() for part in again.of_tiles[0].leaves]
    assert len(of_parts) >= 8
    assert (np.diff(of_parts) < 0).all()


@pytest.mark.parametrize("price", [1e-13, 1e-10, 1e-7])
def test_steps_of_layers_divide_those_of_the_tree_by_odd_numbers(price):
    tree, views = scene()
    tiles = arrange(tree, 1)
    importance = Importance.of(tiles, N_LEVELS, views.sensitivity)
    table = Layered.of(tiles, N_LEVELS, importance, Layering(MAX_LAYERS)).steps(price, 1.0)
    assert table.shape == (N_LEVELS + MAX_LAYERS, 5 + tree.sh_degree)
    ratios = table[N_LEVELS] / table[N_LEVELS + 1 :]
    np.testing.assert_allclose(ratios, np.rint(ratios))
    assert (np.rint(ratios) % 2 == 1).all()
    assert (np.diff(ratios, axis=0) >= 0).all()
    wanted = importance.steps_of_leaves(price, 1.0) / FINER_SHARED
    np.testing.assert_allclose(table[-1], wanted)
    coarse = importance.steps(price * PRICE_RATIO ** (MAX_LAYERS - 1), 1.0)[N_LEVELS]
    assert np.all(np.abs(table[N_LEVELS] / coarse - 1) <= wanted / coarse + 1e-9)


def test_layers_between_weigh_leaves_more_alike_than_the_last_with_the_same_means():
    _, found = layered(many()[0], 3)
    shape = found.importance.leaves[0].shape
    weights = np.random.default_rng(0).lognormal(sigma=2, size=shape).astype(np.float32)
    importance = replace(found.importance, leaves=[weights], seen=1.0)
    tiles = arrange(many()[0], 1)
    again = Layered.of(tiles, N_LEVELS, importance, Layering(3, between=10.0))
    (rows,) = again.of_tiles[0].leaves
    between, last = again.weights(PRICE, 1.0)[0][-2:]
    assert between is not None
    assert last is not None
    np.testing.assert_allclose(last.targets, weights[:, rows], rtol=1e-5)
    np.testing.assert_allclose(between.targets.mean(1), weights.mean(1) / 10, rtol=1e-3)
    spreads = [np.log(own.targets).std(axis=1) for own in (between, last)]
    np.testing.assert_allclose(spreads[0], EVENING_POWER * spreads[1], rtol=1e-3)


def test_one_layer_is_as_if_there_were_none():
    tree, views = scene()
    tiles = arrange(tree, 1)
    importance = Importance.of(tiles, N_LEVELS, views.sensitivity)
    one = Layered.of(tiles, N_LEVELS, importance, Layering(1))
    assert_array_equal(one.steps(PRICE, 1.0), importance.steps(PRICE, 1.0))
    for own, other in zip(
        one.weights(PRICE, 1.0)[0], importance.raised(PRICE, 1.0)[0], strict=True
    ):
        assert own is not None
        assert other is not None
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


@pytest.mark.parametrize(
    "make",
    [partial(stream, 3), pytest.param(lambda: many()[1], marks=pytest.mark.thorough)],
)
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


@pytest.mark.thorough
def test_a_stream_read_back_is_the_same_and_may_be_written_again():
    data = stream(2)
    coded = read_coded_tree(data)
    again = write(coded, zstd_level=1)
    assert decode(again, verify=True).leaves().channels().tobytes() == (
        decode(data).leaves().channels().tobytes()
    )
