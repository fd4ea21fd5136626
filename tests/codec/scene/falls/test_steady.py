"""No step back: first bytes of a stream look no worse than fewer of them, whatever the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import (
    PRESETS,
    Cut,
    SplatParams,
    TargetEncoder,
    decode,
    encode_scene,
    lift,
    read_directory,
)
from evogs_codec.common.progress import no_progress
from evogs_codec.encoding import late_level
from evogs_codec.encoding.guess import Guess
from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.layers import Layering
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import choose
from evogs_codec.scene.falls import packet_falls, steady
from evogs_codec.scene.falls.states import Draft, State
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.prefixes import StreamPrefixes, TreePrefixes
from evogs_codec.scene.request import Request

N = 600
WORST = 0.05  # dB


def odd_scenes():
    """Of odd statistics: by name."""
    splats = make_scene(N, 3)
    rng = np.random.default_rng(0)

    def like(values, of):
        return np.broadcast_to(values, of.shape).astype(np.float32)

    logits, sizes = splats.opacity_logits, splats.log_scales
    haze = rng.normal(-4.0, 0.3, logits.shape)
    clump = rng.normal(0.0, 0.5, splats.means.shape)
    return {
        "all opaque": replace(splats, opacity_logits=like(8.0, logits)),
        "all haze": replace(splats, opacity_logits=like(haze, logits)),
        "huge splats": replace(splats, log_scales=sizes + np.float32(2)),
        "one dense clump": replace(splats, means=like(clump, splats.means)),
        "SH degree 0": replace(splats, sh=splats.sh[:, :1]),
        "far apart": replace(splats, means=splats.means * np.float32(5)),
        "dots": replace(splats, log_scales=sizes - np.float32(2)),
        "hardly there": hardly_there(),
    }


def hardly_there():
    """Opacities of about 1/255, below which nothing is drawn: rounding makes splats appear."""
    rng, n = np.random.default_rng(13), 1500

    def normal(mean, spread, *shape):
        return rng.normal(mean, spread, (n, *shape)).astype(np.float32)

    means, sizes, logits = normal(0, 0.5, 3), normal(-1.5, 0.3, 3), normal(-5.4, 0.4)
    quats, colours = normal(0, 1, 4), rng.uniform(-1.5, 1.5, (n, 1, 3)).astype(np.float32)
    return SplatParams(means, quats, sizes, logits, colours)


def deepest_fall(data, splats):
    """dB from the best prefix that ends with a packet of the levels to a longer one, 12 views."""
    views = Views(splats, cameras_around(splats, "z", 120, n=12))
    directory = read_directory(data)
    ends = directory.offsets + directory.packets["size"]
    ends = ends[(directory.columns == 0) & (directory.packets["size"] > 0)]
    best, fall = -np.inf, 0.0
    for end in ends.tolist():
        leaves = decode(data, Cut.of_prefix(directory, end)).leaves(sh_degree=splats.sh_degree)
        shown = views.psnr(leaves)
        best, fall = max(best, shown), max(fall, best - shown)
    return fall


@pytest.mark.thorough
@pytest.mark.parametrize("name", odd_scenes())
def test_no_packet_of_core_makes_pictures_worse(name):
    """Those of SH are not looked at: one of a last layer was seen to cost 0.2 dB, of a clump."""
    splats = odd_scenes()[name]
    assert deepest_fall(encode_scene(splats, effort=1), splats) <= WORST


@pytest.mark.thorough
def test_without_looking_some_scenes_fall(monkeypatch):
    monkeypatch.setattr(steady, "MAX_TRIES", 0)
    monkeypatch.setattr(steady, "without_falls", lambda found, *_: found)
    splats = odd_scenes()["hardly there"]
    assert deepest_fall(encode_scene(splats, effort=1), splats) > 1.0


def aim_of(tree, splats, **more):
    views = Views(splats, cameras_around(splats, "z", 60, n=4))
    return TargetEncoder(tree, PRESETS["scene"], views, **more)


def found_of(aim):
    return choose._at_price([aim], 4e-6 / N)


def all_steps(prefixes, n_levels, **options):
    return [cut for level in range(n_levels) for cut in prefixes.steps_of(level, **options)]


def test_what_is_looked_at_is_what_a_decoder_shows():
    splats = make_scene(N)
    data = found_of(aim_of(lift(splats, 3), splats, layers=2, n_tiles=2)).made().data
    prefixes = StreamPrefixes(data)
    cuts = all_steps(prefixes, prefixes.n_levels)
    assert len(cuts) > prefixes.n_levels
    for cut, leaves in zip(cuts, prefixes.shown(cuts, 3), strict=True):
        expected = decode(data, cut).leaves(sh_degree=3)
        assert np.array_equal(leaves.channels(), expected.channels())


def assert_shows_the_same(draft, stream, n_levels):
    """Of levels, what a coded tree shows after each step is what its stream does."""
    for rooms in (True, False):
        of_draft = all_steps(draft, n_levels, rooms=rooms)
        of_stream = all_steps(stream, n_levels, rooms=rooms)
        assert len(of_draft) == len(of_stream) >= n_levels
        pairs = zip(draft.shown(of_draft, 3), stream.shown(of_stream, 3), strict=True)
        for leaves, expected in pairs:
            assert np.array_equal(leaves.channels(), expected.channels())
    for level in range(n_levels):
        (leaves,) = draft.shown([draft.of_level(level)], 3)
        (expected,) = stream.shown([stream.of_level(level)], 3)
        assert np.array_equal(leaves.channels(), expected.channels())


@pytest.mark.parametrize("runs", [[], [Run((1, 0), (1, 9))]])
@pytest.mark.parametrize("is_late", [False, True])
@pytest.mark.parametrize("n_tiles", [1, 2])
def test_a_draft_has_the_coarse_levels_of_the_stream(is_late, n_tiles, runs):
    splats = make_scene(N)
    found = found_of(aim_of(lift(splats, 3), splats, layers=2, n_tiles=n_tiles))
    found = found.holding(runs, Layering(2, is_late=is_late))
    assert found.n_coarse == 3 - is_late
    stream = StreamPrefixes(found.made().data)
    assert_shows_the_same(found.draft(), stream, found.n_coarse)


@pytest.mark.parametrize("shares_sh", [False, True])
@pytest.mark.parametrize("is_late", [False, True])
def test_a_whole_draft_shows_what_the_stream_does(is_late, shares_sh):
    splats = make_scene(N)
    if shares_sh:
        of_some = splats.sh[np.arange(N) % 7, 1:]
        splats = replace(splats, sh=np.concatenate([splats.sh[:, :1], of_some], axis=1))
    lifted = lift_with_order(splats, 3)
    tree = with_palette(lifted, splats) or lifted.tree
    assert (tree.palette is not None) == shares_sh
    found = found_of(aim_of(tree, splats, layers=2, n_tiles=2))
    found = found.holding([], Layering(2, is_late=is_late))
    draft, stream = found.draft(is_whole=True), StreamPrefixes(found.made().data)
    assert isinstance(draft, TreePrefixes)
    assert draft.n_levels == stream.n_levels
    assert_shows_the_same(draft, stream, stream.n_levels)


def state(place, *decibels):
    """With these of views."""
    return State(place, np.array(decibels), lambda: np.array(decibels))


def test_a_step_that_falls_is_held_back_with_what_follows_until_pictures_are_better():
    states = [state((0, 0), 20.0), state((1, 0), 19.0), state((1, 1), 19.5), state((2, 0), 22.0)]
    runs, is_coarse = steady._runs(states, set())
    assert runs == [Run((1, 0), (2, 0))]
    assert not is_coarse


@pytest.mark.parametrize(("fall", "is_held"), [(0.2, True), (0.0, False)])
@pytest.mark.parametrize("is_correction", [False, True])
def test_after_a_correction_that_falls_those_that_look_a_little_worse_are_held_too(
    is_correction, fall, is_held
):
    states = [
        state((0, 0), 20.0),
        state((1, 0), 21.0),
        state((1, 1), 21.0 - fall),
        state((2, 0), 22.0),
        state((2, 1), 21.96),
        state((3, 0), 23.0),
    ]
    runs, _ = steady._runs(states, {(1, 1), (2, 1)} if is_correction else set())
    first, later = Run((1, 1), (2, 0)), Run((2, 1), (3, 0))
    assert runs == [first] * is_held + [later] * (is_held and is_correction)


def test_coarse_splats_that_look_worse_than_some_of_them_are_too_coarse():
    states = [state((0, 0), 20.0), state((1, 0), 24.0), state((2, 0), 23.0)]
    assert steady._runs(states, set())[1]


@pytest.mark.parametrize(
    ("decibels", "expected"),
    [([20.0, 21.0], False), ([20.0, 19.98], False), ([20.0, 19.9], True)],
)
def test_roots_are_looked_at_step_by_step(monkeypatch, decibels, expected):
    splats = make_scene(3000)
    found = found_of(aim_of(lift(splats, 2), splats, layers=2))
    draft = Draft(found.draft(), 2, 3, 3000, found.encoder.views)
    assert len([*draft.prefixes.steps_of(0)]) == len(decibels)
    shown = iter(decibels)
    monkeypatch.setattr(Views, "psnr_of_each", lambda *_: np.full(4, next(shown)))
    assert draft.roots_fall() == expected


@pytest.mark.usefixtures("any_views")
def test_roots_of_which_some_look_worse_come_in_one_step(monkeypatch):
    splats = make_scene(3000)
    n_steps = []
    for falls in (False, True):
        monkeypatch.setattr(Draft, "roots_fall", lambda _, falls=falls: falls)
        directory = read_directory(encode_scene(splats, levels=2, up="z", effort=1))
        n_steps.append(int((directory.labels[directory.columns == 0] == 0).sum()))
    assert n_steps == [2, 1]


@pytest.mark.thorough
def test_layers_that_were_asked_for_stay_where_coarse_splats_are_made_finer(monkeypatch):
    real, tries = steady._runs, []

    def once_too_coarse(states, at_corrections):
        tries.append(states)
        return real(states, at_corrections)[0], len(tries) == 1

    monkeypatch.setattr(steady, "_runs", once_too_coarse)
    data = encode_scene(make_scene(N), levels=3, layers=3, up="z", effort=1)
    assert len(tries) > 1
    assert read_directory(data).n_levels == 3 + 2


@pytest.mark.parametrize(
    ("price", "ratio"), [(1e-3, 192.0), (3e-3, 48.0), (1e-2, 12.0), (1.0, 3.0)]
)
def test_coarse_splats_that_would_show_hardly_anything_are_made_finer_unseen(
    monkeypatch, price, ratio
):
    splats = make_scene(N)
    found = replace(found_of(aim_of(lift(splats, 3), splats, layers=2)), price=price / N)
    monkeypatch.setattr(steady, "_runs", lambda *_: ([], False))
    request = Request.of("scene", {})
    steadying = steady._Steadying(found.encoder.views, request.progress, False, found.layering)
    again = steadying.steadied(found)
    assert (found if again is None else again).layering.ratio == ratio
    assert again is None or steadying.steadied(again) is None


@pytest.mark.parametrize(
    ("target", "ratio", "is_held"), [({}, 192.0, True), ({"psnr": 38.0}, 48.0, False)]
)
def test_with_a_target_coarse_splats_are_finer_before_steps_are_held_back(
    monkeypatch, target, ratio, is_held
):
    run = Run((1, 0), (1, 9))
    monkeypatch.setattr(steady, "_runs", lambda *_: ([run], False))
    splats = make_scene(N)
    found = replace(found_of(aim_of(lift(splats, 3), splats, layers=2)), **target)
    request = Request.of("scene", {})
    steadying = steady._Steadying(found.encoder.views, request.progress, False, found.layering)
    again = steadying.steadied(found)
    assert again is not None
    assert again.layering.ratio == ratio
    assert (steadying.last_runs == [run]) == is_held
    again = steadying.steadied(again)  # now or already
    assert steadying.last_runs == [run]
    assert (again is None) == is_held


@pytest.mark.parametrize(
    ("target", "decibels", "ratios"),
    [
        ({"psnr": 38.0}, [20.0, 22.0, 21.0, 21.4], [48.0, 12.0, 3.0]),  # it adds 0.4 dB
        ({"psnr": 38.0}, [20.0, 22.0, 21.0, 21.6], [48.0, 48.0]),  # it adds enough, once finer
        ({"psnr": 38.0}, [20.0, 22.0, 21.0, 20.9], [12.0, 3.0]),  # it looks worse
        ({"n_bytes": 9000}, [20.0, 22.0, 21.0, 20.9], [12.0, 3.0]),
        ({}, [20.0, 22.0, 21.0, 20.9], [48.0, 12.0, 3.0]),  # of which the last is too coarse
    ],
)
def test_with_a_target_coarse_splats_are_finer_until_their_last_level_shows_something(
    monkeypatch, target, decibels, ratios
):
    places = [(0, 0), (1, 0), (1, 1), (2, 0)]
    states = [state(place, one) for place, one in zip(places, decibels, strict=True)]
    monkeypatch.setattr(Draft, "states", lambda *_: states)
    splats = make_scene(N)
    found = replace(found_of(aim_of(lift(splats, 3), splats, layers=2)), **target)
    steadying = steady._Steadying(found.encoder.views, no_progress, False, found.layering)
    for ratio in ratios:
        found = steadying.steadied(found)
        assert found is not None
        assert found.layering.ratio == ratio
    assert bool(steadying.last_runs) == (len(set(ratios)) < len(ratios))


def test_what_the_last_level_adds():
    states = [state((0, 0), 20.0), state((1, 0), 24.0), state((1, 1), 23.0), state((2, 0), 23.5)]
    assert steady._added_by_last(states) == 0.5
    assert steady._added_by_last(states[:1]) == np.inf


@pytest.mark.parametrize(
    ("decibels", "slope", "is_sure"),
    [(60.0, -4.3, True), (50.0, -4.3, False), (60.0, -3.0, False)],
)
def test_nobody_looks_whether_coarse_splats_are_far_off_where_a_slope_tells(
    monkeypatch, decibels, slope, is_sure
):
    splats = make_scene(N)
    found = found_of(aim_of(lift(splats, 3), splats, layers=2))
    encoder = found.encoder.guessing(Guess(found.price, slope))
    looks = []

    def last_two(draft):
        looks.append(draft)
        return [20.0, 20.0 + decibels]  # not far off

    monkeypatch.setattr(Draft, "last_two", last_two)
    monkeypatch.setattr(steady, "_falls_late", lambda *_: False)
    request = Request.of("scene", {})
    steadying = steady._Steadying(found.encoder.views, request.progress, True, found.layering)
    begun = steadying.begun(replace(found, encoder=encoder, psnr=decibels))
    assert (not looks) == is_sure
    assert begun.layering.n == (3 if is_sure else 2)


@pytest.mark.parametrize("some_fall", [False, True])
def test_a_level_that_gains_somewhat_comes_late_where_steps_would_be_held_back(
    monkeypatch, some_fall
):
    real = steady._runs

    def runs_of(states, at_corrections):
        return [Run((1, 0), (1, 9))] if some_fall else [], real(states, at_corrections)[1]

    monkeypatch.setattr(steady, "_runs", runs_of)
    splats = make_scene(N)
    found = found_of(aim_of(lift(splats, 3), splats, layers=2))
    draft, views = found.draft(), found.encoder.views
    cuts = [draft.of_level(level) for level in (1, 2)]
    before, last = map(views.psnr, draft.shown(cuts, 3))
    monkeypatch.setattr(late_level, "LATE_GAIN_DB", last - before - 0.5)
    monkeypatch.setattr(late_level, "LATE_GAIN_IF_SOME_FALL_DB", last - before + 0.5)
    steadied = steady._steadied(found, views, Request.of("scene", {}))
    assert steadied.layering.is_late == some_fall


def test_a_target_that_held_steps_miss_is_met_without(monkeypatch):
    """What was made first stays."""
    splats = make_scene(N)
    aim = aim_of(lift(splats, 3), splats, layers=2)
    first = FoundStream.of(aim, lambda aim, near: aim.nearest_psnr(38, near)).made()
    monkeypatch.setattr(
        steady._Steadying,
        "steadied",
        lambda self, found: found.holding([], Layering(2, is_late=True)) if found.stream else None,
    )

    def missed(self, decibels, near=None):
        raise TargetMissedError("missed", 1.0)

    monkeypatch.setattr(TargetEncoder, "nearest_psnr", missed)
    request = Request.of("scene", {"target_psnr": 38.0})
    assert steady._steadied(first, aim.views, request).data == first.data


@pytest.mark.usefixtures("any_views")
@pytest.mark.parametrize("n_tiles", [1, 3])
def test_levels_are_measured_by_the_integers_of_the_stream(monkeypatch, n_tiles):
    measured: list[FoundStream] = []

    def without_falls(*args):
        measured.append(steady_again(*args))
        return measured[-1]

    steady_again = packet_falls.without_falls
    monkeypatch.setattr(steady, "without_falls", without_falls)
    encode_scene(make_scene(N), up="z", n_tiles=n_tiles)
    (found,) = measured
    prefixes = found.prefixes
    assert isinstance(prefixes, TreePrefixes)
    cuts = map(prefixes.of_level, range(prefixes.n_levels))
    for level, leaves in enumerate(prefixes.shown([*cuts], 3)):
        decoded = decode(found.data, level=level).leaves(sh_degree=3)
        np.testing.assert_array_equal(leaves.channels(), decoded.channels())
    directory = read_directory(found.data)
    ends = directory.offsets + directory.packets["size"].astype(np.int64)
    packets = [Cut.of_prefix(directory, end) for end in ends.tolist()]
    shown = prefixes.shown([*map(prefixes.of_cut, packets)], 3)
    for cut, leaves in zip(packets, shown, strict=True):  # also with bands of some steps alone
        decoded = decode(found.data, cut).leaves(sh_degree=3)
        np.testing.assert_array_equal(leaves.channels(), decoded.channels())


@pytest.mark.usefixtures("any_views")
def test_levels_of_other_streams_are_measured_by_their_bytes():
    found = FoundStream(lift(make_scene(N), 2), stream=encode_scene(make_scene(N), preset="scene"))
    assert isinstance(found.prefixes, StreamPrefixes)
