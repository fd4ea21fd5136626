"""The order of records and packets: legal, the same every time, what gains most first."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from evogs_codec import PRESETS, EvolutionTree, Kind, Step, decode, encode, lift, read_directory
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.estimated_gains import changes, ranks
from evogs_codec.encoding.packet_order import packet_order
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.write import write
from evogs_codec.format.layout import PACKET_ENTRY, size_of
from evogs_codec.model.packet_id import PacketId
from evogs_codec.render.demo_scene import make_scene
from tests.support.damage import random_tree

ENTRY = size_of(PACKET_ENTRY)


@pytest.fixture(scope="module")
def lifted():
    return lift(make_scene(1500), 4)


@pytest.fixture(scope="module")
def coded(lifted):
    return quantise(arrange(lifted, 2), 4, PRESETS["scene"])


def sizes_of(tree, size=100):
    return {
        PacketId(tile, component, k): size
        for tile, own in enumerate(tree.tiles)
        for k in range(len(own.steps))
        for component in range(tree.sh_degree + 1)
    }


def with_gains(tree, gains):
    """The tree with gains[k] (degree + 1,) at step k of its tiles."""
    tiles = [
        replace(t, steps=tuple(replace(s, gain=g) for s, g in zip(t.steps, gains, strict=False)))
        for t in tree.tiles
    ]
    return replace(tree, tiles=tuple(tiles))


@pytest.mark.parametrize("n_tiles", [pytest.param(1, marks=pytest.mark.thorough), 3])
def test_the_same_tree_gives_the_same_bytes_and_their_order_is_legal(n_tiles):
    tree = random_tree(60, 4, 2, seed=3)
    settings = replace(PRESETS["trained"], zstd_level=1)
    data = encode(tree, settings, n_tiles=n_tiles)
    assert encode(tree, settings, n_tiles=n_tiles) == data
    directory = read_directory(data)  # which refuses any other
    first = directory.packets[: len(directory.tiles)]
    assert sorted(first["tile"]) == list(range(len(directory.tiles)))


def test_without_gains_packets_go_step_by_step(coded):
    bare = with_gains(coded, [()] * 99)
    order = packet_order(bare, sizes_of(bare))
    assert order == sorted(order, key=lambda packet: (packet.step, packet.tile, packet.component))
    assert len(write(bare, zstd_level=1)) == len(write(coded, zstd_level=1))


def test_packets_may_come_in_another_order(coded):
    data = write(coded, zstd_level=1)
    step_by_step = sorted(sizes_of(coded), key=lambda packet: packet.step)
    other = write(coded, zstd_level=1, order=step_by_step)
    assert decode(other, verify=True).dump() == decode(data).dump()
    directory = read_directory(other)
    rows = zip(directory.packets["tile"], directory.columns, directory.steps, strict=True)
    assert [*map(PacketId._make, rows)] == step_by_step
    with pytest.raises(ValueError, match=r"order of \d+ packets is none of the \d+"):
        write(coded, zstd_level=1, order=step_by_step[1:])


def test_the_next_packet_is_of_the_tile_where_bytes_gain_most(lifted, coded):
    rng = np.random.default_rng(1)
    sizes = {place: int(rng.integers(1, 5000)) for place in sizes_of(coded)}
    shares = [tile.n_leaves / lifted.n_leaves for tile in arrange(lifted, 2)]
    order = packet_order(coded, sizes)
    assert sorted(order) == sorted(sizes)

    def best(tile, start):
        """Gain per byte of the run of core packets from here that gains most."""
        steps = coded.tiles[tile].steps
        gains = np.cumsum([step.gain[0] for step in steps[start:]])
        n_bytes = np.cumsum([sizes[PacketId(tile, 0, k)] + ENTRY for k in range(start, len(steps))])
        return shares[tile] * max(gains / n_bytes, default=0.0)

    done = [0, 0]
    for tile, component, step in order:
        if component == 0:
            assert step == done[tile]
            assert best(tile, step) >= best(1 - tile, done[1 - tile]) * (1 - 1e-9)
            done[tile] += 1


def test_a_packet_that_pays_with_the_next_comes_with_it_and_bands_wait_for_what_pays_more():
    tree = quantise([random_tree(40, 3, 1, seed=5)], 3, PRESETS["trained"])
    assert len(tree.tiles[0].steps) >= 3
    rest = [(0.0, 0.0)] * (len(tree.tiles[0].steps) - 3)
    some = with_gains(tree, [(9.0, 3.0), (0.0, 0.0), (8.0, 2.5), *rest])
    order = packet_order(some, sizes_of(some))
    assert order[:5] == [(0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 1, 0), (0, 1, 1)]
    dear = packet_order(some, sizes_of(some) | {PacketId(0, 0, 2): 100_000})
    assert dear[:2] == [(0, 0, 0), (0, 1, 0)]
    assert dear.index(PacketId(0, 0, 2)) < dear.index(PacketId(0, 1, 2))


def test_errors_in_the_directory_are_distances_on_the_grid_and_never_rise(lifted, coded):
    tiles = arrange(lifted, 2)
    for tile, found in zip(tiles, coded.tiles, strict=True):
        wanted = distances(tile) * 2.0 ** coded.grid_exponents[0]
        errors = np.array([step.error for step in found.steps])
        assert np.all(np.diff(errors, axis=0) <= 0)
        assert not errors[-1].any()
        n = sum(not len(step.slots) for step in tile.steps)  # from then on all has an ancestor
        assert_allclose(errors[n - 1 : -1, 0], wanted[n - 1 : -1], rtol=0.02, atol=2)
        assert all(min(step.gain) >= 0 for step in found.steps)


def distances(tile):
    """(K,) rms distance of the leaves from what stands for them; the largest from there on."""
    states = [(state.values[:3].copy(), state.live.copy()) for state in tile.states()]
    last, live = states[-1]
    leaves = np.flatnonzero(live)
    born_from = np.full(last.shape[1], -1)
    n = 0
    for step in tile.steps:
        parents = step.slots[step.kinds == Kind.SPLIT]
        born_from[n : n + len(parents)] = parents
        n += step.n_new
    found = []
    for values, _ in states:
        slot = leaves.copy()
        while np.any(slot >= values.shape[1]):
            slot = np.where(slot >= values.shape[1], born_from[slot], slot)
        off = np.where(slot >= 0, values[:, slot], 0) - last[:, leaves]
        found.append(np.sqrt(np.square(off).sum(0).mean()))
    return np.maximum.accumulate(found[::-1])[::-1]


def test_corrections_follow_the_splits_that_they_correct(lifted):
    (tile,) = arrange(lifted, 1)
    n = 0
    written = np.empty(0)
    for step in tile.steps:
        if len(step.slots) and np.all(step.kinds == Kind.REFINE):
            assert np.isin(step.slots, written).all()
        else:
            written = np.concatenate([step.slots, n + np.arange(step.n_new)])
        n += step.n_new


def test_layers_make_room_when_what_needs_it_is_there():
    adds = random_tree(50, 0, 0, seed=1).steps[0].adds
    base = Step.of_adds(0, adds)
    dimmed = np.zeros((len(adds), 50))
    dimmed[10] = -1
    room = Step.of_refines(1, np.arange(50), dimmed)
    tree = EvolutionTree(0, (base, room, Step.of_adds(1, adds + 1)))
    (tile,) = arrange(tree, 1)
    assert [step.n_adds > 0 for step in tile.steps] == [True, True, False]
    wanted, found = tree.leaves().means, tile.leaves().means
    assert np.array_equal(np.sort(wanted, axis=0), np.sort(found, axis=0))


def test_of_neighbours_the_second_of_two_equal_changes_gains_less():
    gain = ranks(np.array([4.0, 4.0, 1.0, 0.0]), np.full(4, 2.0), 1)
    assert_allclose(gain, np.array([36.0, 20.0, 1.0, 0.0]) / 8)
    assert_allclose(ranks(np.ones(6), np.ones(6), 4)[4:], 2 * 2 / 6)
    assert len(ranks(np.zeros(0), np.zeros(0), 4)) == 0


def test_a_change_is_what_shows_more_or_lies_elsewhere():
    splat = np.zeros((14, 3))  # opacity one half, axes of 1
    moved = splat.copy()
    moved[0, 1] = 1.0
    splits = np.array([False, False, True])
    found = changes(splat, moved, splat[:, :1], splits)
    assert_allclose(found, [0.0, 0.25, 0.5])
