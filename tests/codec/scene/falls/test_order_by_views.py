"""The last packets of few splats in the order that falls least."""

import itertools
import math
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
    lift,
    read_directory,
)
from evogs_codec.model.packet_id import PacketId
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene.falls import order_by_views
from evogs_codec.scene.falls.judges import PACKET_FALL_DB, Judges, Prefix
from evogs_codec.scene.falls.order_by_views import MAX_STATES, ordered_by_views
from evogs_codec.scene.prefixes import StreamPrefixes

N_BANDS = 3


def bare(splats):
    """Of SH degree 0."""
    return replace(splats, sh=splats.sh[:, :1])


@pytest.fixture(scope="module")
def stream():
    splats = make_scene(300)
    views = Views(splats, cameras_around(splats, "z", 60, n=4))
    return TargetEncoder(lift(splats, 3), PRESETS["scene"], views, layers=2).at_price(1e-10)


class Judge(Views):
    """Views whose PSNR is that of the SH bands that splats have: a bit of each."""

    def __init__(self, whole, decibels):
        self.whole, self.decibels = whole, decibels

    def psnr(self, leaves):
        is_there = 0
        for band in range(1, 1 + N_BANDS):
            part = slice(band**2, (band + 1) ** 2)
            found = leaves.sh[:, part]
            same = found.shape == self.whole.sh[:, part].shape
            is_there |= (same and np.array_equal(found, self.whole.sh[:, part])) << (band - 1)
        return self.decibels.get(is_there, 0.0) if len(leaves) == len(self.whole) else -1.0


class Known(Prefix):
    """A prefix of which the PSNR is known, and what others look like."""

    def __init__(self, psnr, views=None):
        self.psnr, self._judges = psnr, Judges(views)


def in_order(data, judge, sh_degree=N_BANDS, fall=0.0):
    """After prefixes that fall by so much and show nothing."""
    before = (fall, Known(-1.0))
    return ordered_by_views(data, StreamPrefixes(data), judge, sh_degree, lambda _: before)


def packets(data):
    directory = read_directory(data)
    return [
        PacketId(int(row["tile"]), int(row["component"]), int(step))
        for row, step in zip(directory.packets, directory.steps, strict=True)
        if row["size"]
    ]


def rows_of(data):
    """Rows of packets with bytes."""
    return np.flatnonzero(read_directory(data).packets["size"]).tolist()


@pytest.mark.parametrize(
    ("decibels", "bands", "deepest_of_ends"),
    [
        ({1: -5, 2: 1, 3: -5, 4: -5, 5: -5, 6: 2, 7: 3}, [2, 3, 1], 0.0),
        ({1: -5, 2: -5, 3: 5, 4: 1, 5: 2, 6: -5, 7: 3}, [3, 1, 2], 0.0),
        ({1: 1, 2: -1, 3: -5, 4: 2, 5: 0.5, 6: -5, 7: 3}, [1, 3, 2], 0.5),
    ],
)
def test_bands_come_in_the_order_that_falls_least(stream, decibels, bands, deepest_of_ends):
    whole = decode(stream).leaves()
    data, fall = in_order(stream, Judge(whole, decibels))
    ends = {packet.component: k for k, packet in enumerate(packets(data))}
    assert sorted(range(1, 1 + N_BANDS), key=lambda band: ends[band]) == bands
    assert fall == deepest_of_ends
    assert in_order(stream, Judge(whole, decibels), fall=9.0) == (data, 9.0)


def test_nothing_but_the_order_changes(stream):
    judge = Judge(decode(stream).leaves(), {4: 1, 6: 2, 7: 3})
    data, _ = in_order(stream, judge)
    assert data != stream
    assert len(data) == len(stream)
    assert sorted(packets(data)) == sorted(packets(stream))
    assert decode(data, verify=True).dump() == decode(stream).dump()
    directory = read_directory(data)
    for k in range(len(directory.packets)):
        end = int(directory.offsets[k] + directory.packets["size"][k])
        decode(data[:end] if end < len(data) else data, Cut.of_prefix(directory, end))


def deepest(columns, looks, before, n_chains):
    """The deepest fall on a way, and what its prefixes lack."""
    state, highest, fall = [0] * n_chains, max(before, looks[(0,) * n_chains]), 0.0
    for column in columns:
        state[column] += 1
        fall, highest = max(fall, highest - looks[tuple(state)]), max(highest, looks[tuple(state)])
    return fall


def ends_of(counts):
    """Packets without bytes, of so many of each component."""
    chains = tuple(tuple(np.empty(0, np.int64) for _ in range(n)) for n in counts)
    nothing = np.empty(0, np.int64)
    return order_by_views._Stretch(nothing, chains, np.zeros(len(counts), np.int64), nothing)


@pytest.mark.parametrize("counts", [(1, 1, 1), (2, 1, 1, 1), (2, 2, 1)])
def test_no_other_way_falls_less(counts):
    rng = np.random.default_rng(sum(counts))
    turns = [column for column, n in enumerate(counts) for _ in range(n)]
    states = list(itertools.product(*(range(1 + n) for n in counts)))
    for _ in range(200):
        looks = {state: float(rng.normal(30, 1) + 0.3 * sum(state)) for state in states}
        before = float(rng.normal(30, 1))
        way = order_by_views._best_way(ends_of(counts), looks, before, np.empty(0, np.int64))
        least = min(
            deepest(columns, looks, before, len(counts))
            for columns in set(itertools.permutations(turns))
        )
        found = deepest(way.columns, looks, before, len(counts))
        assert way.fall == found
        assert found == pytest.approx(least, abs=0.5 * 10**-order_by_views.DIGITS)


def test_what_looks_best_may_stay_where_it_is():
    looks: dict[tuple[int, ...], float]
    looks = {(0, 0): 30.0, (1, 0): 31.0, (0, 1): 30.5, (1, 1): 29.0}
    nothing = np.empty(0, np.int64)
    way = order_by_views._best_way(ends_of((1, 1)), looks, 29.0, nothing)
    assert (way.columns, way.fall) == ((1, 0), 1.5)
    assert deepest((0, 1), looks, 33.0, 2) == deepest((1, 0), looks, 33.0, 2) == 4.0


@pytest.mark.parametrize(
    "splats",
    [
        make_scene(40, 1),
        make_scene(1, 2),
        bare(make_scene(30, 3)),
        make_scene(12, 4).take(slice(0, 0)),
    ],
    ids=["few", "one", "SH degree 0", "none"],
)
def test_odd_streams_say_the_same_in_another_order(splats):
    data = encode_scene(splats, preset="scene", levels=3)
    judge = Judge(decode(data).leaves(), {4: 1, 6: 2, 7: 3})
    again, _ = in_order(data, judge, splats.sh_degree)
    assert decode(again, verify=True).dump() == decode(data).dump()
    assert sorted(packets(again)) == sorted(packets(data))


def test_states_are_bounded(stream):
    class Counting(Judge):
        n = 0

        def psnr(self, leaves):
            self.n += 1
            return float(self.n)

    judge = Counting(decode(stream).leaves(), {})
    in_order(stream, judge)
    assert 2 ** (1 + N_BANDS) <= judge.n <= MAX_STATES


@pytest.mark.parametrize(
    ("looks", "is_turned", "fall"),
    [
        ([10.0, 9.0, 12.0, 13.0], True, 0.0),
        ([10.0, 12.0, 9.0, 13.0], False, 0.0),
        ([10.0, 9.0, 9.5, 13.0], True, 0.5),
    ],
)
def test_packets_before_and_after_some_stay_where_they_are(stream, looks, is_turned, fall):
    class Told(Judge):
        def psnr(self, leaves):
            return self.decibels.pop(0)  # of none, the later component, the earlier one, both

    before, rows = packets(stream), rows_of(stream)
    at = next(k for k in range(len(before)) if before[k].component > before[k + 1].component > 0)
    some = range(rows[at], rows[at + 1] + 1)
    judge = Told(decode(stream).leaves(), list(looks))
    highest = lambda row: (0.0, Known(10.0)) if row == some.start else (9.0, None)  # noqa: E731
    data, found = ordered_by_views(stream, StreamPrefixes(stream), judge, N_BANDS, highest, some)
    assert found == fall
    after = packets(data)
    pair = before[at : at + 2]
    assert after == before[:at] + (pair[::-1] if is_turned else pair) + before[at + 2 :]
    assert decode(data, verify=True).dump() == decode(stream).dump()


def test_a_stretch_of_too_many_states_stays_as_it_is(stream):
    rows = range(len(read_directory(stream).packets))
    judge = Judge(decode(stream).leaves(), {})
    before, prefixes = (0.0, Known(0.0, judge)), StreamPrefixes(stream)
    found, fall = ordered_by_views(
        stream, prefixes, judge, N_BANDS, lambda _: before, rows, len(rows) // 2
    )
    assert found is stream
    assert fall == math.inf


def test_of_many_states_only_those_of_some_ways_are_looked_at(stream):
    class Counting(Judge):
        n = 0

        def psnr(self, leaves):
            self.n += 1
            return super().psnr(leaves)

    counts: dict[str, int] = {}
    rows = range(len(read_directory(stream).packets))
    prefixes = StreamPrefixes(stream)
    for name, some in (("all", None), ("some", rows)):
        # Bands 3, 1, 2, in this order, do not fall.
        judge = Counting(decode(stream).leaves(), {1: -5, 2: -5, 3: 5, 4: 1, 5: 2, 6: -5, 7: 3})
        before = dict.fromkeys(range(len(rows)), (0.0, Known(-1.0, judge)))
        data, fall = ordered_by_views(stream, prefixes, judge, N_BANDS, before.__getitem__, some)
        ends = {packet.component: k for k, packet in enumerate(packets(data))}
        assert sorted(range(1, 1 + N_BANDS), key=lambda band: ends[band]) == [3, 1, 2]
        assert fall == 0
        assert decode(data, verify=True).dump() == decode(stream).dump()
        counts[name] = judge.n
    n_packets = len(packets(stream))
    assert n_packets // 2 < counts["some"] <= order_by_views.MAX_STATES_OF_TURN * n_packets


class Told:
    """What states look like, by steps of each component; those that were looked at are known."""

    def __init__(self, looks):
        self.looks, self.seen = looks, []

    def __call__(self, cut):
        self.seen.append(tuple(cut.steps[0].tolist()))
        return Known(self.looks[self.seen[-1]])


def some_way(stretch, look, before, max_states=1000, most=math.inf):
    return order_by_views._some_way(stretch, look, Known(before), max_states, most)


def rows_of_chains(counts):
    """Packets of a byte, of so many of each component: core first."""
    n, chains = 0, []
    for count in counts:
        chains.append(tuple(np.arange(k, k + 1) for k in range(n, n + count)))
        n += count
    nothing = np.empty(0, np.int64)
    return order_by_views._Stretch(nothing, tuple(chains), np.zeros(len(counts), np.int64), nothing)


@pytest.mark.parametrize("counts", [(2, 2, 1), (3, 2, 2), (2, 2, 2, 1)])
def test_the_way_that_is_found_falls_as_little_as_any(counts):
    rng = np.random.default_rng(sum(counts))
    stretch = rows_of_chains(counts)
    states = list(stretch.states())
    sizes = np.ones(sum(counts), np.int64)
    n_less = 0
    for _ in range(200):
        looks = {state: float(rng.normal(30, 0.3) + 0.2 * sum(state)) for state in states}
        least = order_by_views._best_way(stretch, looks, 30.0, sizes).fall
        look = Told(looks)
        way = some_way(stretch, look, 30.0)
        found = deepest(way.columns, looks, 30.0, len(counts))
        assert way.fall == (found if found > PACKET_FALL_DB else 0)
        assert found <= max(least, PACKET_FALL_DB) + 10**-order_by_views.DIGITS
        assert len(look.seen) == len(set(look.seen))
        n_less += len(look.seen) < len(states)
        if least > 2 * PACKET_FALL_DB:
            assert some_way(stretch, look, 30.0, most=least / 2) is None
    assert n_less > 100


def test_packets_keep_their_order_where_none_falls():
    stretch = rows_of_chains((3, 2))
    looks = {state: float(sum(state)) for state in stretch.states()}
    look = Told(looks)
    assert some_way(stretch, look, 0.0).columns == (0, 0, 0, 1, 1)
    assert look.seen == [(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2)]
    assert some_way(stretch, look, 0.0, 5) is None


def test_small_packets_come_with_those_before_them():
    stretch = rows_of_chains((3, 4))
    sizes = np.array([100, 90, 80, 100, 1, 2, 50])
    joined = stretch.joined(sizes)
    assert [[group.tolist() for group in chain] for chain in joined.chains] == [
        [[0], [1], [2]],
        [[3, 4, 5], [6]],
    ]
    assert joined.end == (3, 2)
    assert joined.cut((3, 1)).steps.tolist() == [[3, 3]]
    assert (2, 1) not in joined.states()
    assert list(joined.after((2, 0))) == [(2, 0, (3, 0))]
    assert joined.rows((0, 0, 0, 1, 1)).tolist() == list(range(7))


@pytest.mark.parametrize(("most", "is_looked_at"), [(0.5, False), (0.6, True)])
def test_nothing_is_looked_at_where_what_comes_before_falls_too_much(stream, most, is_looked_at):
    judge = Judge(decode(stream).leaves(), {4: 1, 6: 2, 7: 3})
    prefixes, before = StreamPrefixes(stream), lambda _: (0.5, None)
    if not is_looked_at:
        judge.decibels = None  # which is asked for once something is drawn
    data, fall = ordered_by_views(stream, prefixes, judge, N_BANDS, before, most=most)
    assert (data != stream) == is_looked_at
    assert fall == (0.5 if is_looked_at else math.inf)


def test_bands_that_are_decoded_one_by_one_are_those_of_the_cut(stream):
    directory = read_directory(stream)
    apart = order_by_views._Cuts(StreamPrefixes(stream), 1 + N_BANDS, N_BANDS)
    ends = order_by_views._Stretch.of_last(directory)
    cuts = [ends.cut(state) for state in ends.states()]
    for cut in cuts[:: max(len(cuts) // 20, 1)]:
        found, expected = apart.leaves(cut), decode(stream, cut).leaves(sh_degree=N_BANDS)
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            assert np.array_equal(getattr(found, name), getattr(expected, name))


def test_several_tiles_stay_as_they_are():
    data = encode_scene(make_scene(200), n_tiles=2, preset="scene")
    found, fall = in_order(data, Judge(decode(data).leaves(), {}))
    assert found is data
    assert fall == math.inf
