"""Every row of docs/extremes.md with small counts: no bound is broken."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec import PRESETS, EvolutionTree, NotRepresentableError, decode, encode, lift
from evogs_codec.encoding.grids import AccuracyWarning
from evogs_codec.encoding.tiling import _kd_tiles
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.options import DEFAULT
from evogs_codec.render.oracle import render_exactly
from tests.support.examples import examples
from tools.bench.extremes import (
    codec,
    decimals,
    exact,
    integers,
    lifted,
    page,
    rasterizer,
    scenes,
    training,
    views,
)
from tools.bench.extremes.measured import measure
from tools.bench.extremes.row import Row, attempted, outcome

pytestmark = pytest.mark.thorough


def assert_holds(rows):
    found = {row.extreme: row for row in rows}
    assert found
    assert [row for row in found.values() if not row.holds] == []


def test_scenes_keep_their_bounds():
    assert_holds(codec.scenes(24))


def test_grids_keep_their_bounds_at_both_ends():
    assert_holds(codec.grids(12))


def test_chains_keep_their_bounds():
    assert_holds(codec.chains(20))


def test_products_keep_their_bounds():
    assert_holds(codec.products(2))


def test_errors_asked_for_are_kept_or_refused():
    assert_holds(codec.targets(10))


def test_lifting_keeps_shapes_with_quaternions_of_any_length():
    assert_holds(lifted.shapes(50))


def test_integers_at_their_limits_are_those_of_the_formulas():
    rows = list(integers.chains_at_limits(24))
    assert_holds(rows)
    assert f"X to {(1 << 30) - 1}" in rows[0].extreme
    assert rows[0].beyond.count("`StreamError`: E_RANGE") == 3


def test_the_float_view_is_rounded_once_at_the_largest_origins():
    rows = list(integers.float_view(8))
    assert_holds(rows)
    assert "`StreamError`: E_TILE" in rows[0].beyond


@pytest.mark.parametrize("n", [2, 16, 17])
def test_few_splats_close_together_stay_apart(n):
    rng = np.random.default_rng(n)
    splats = make_scene(n)
    means = (rng.uniform(size=(n, 3)) * 1e-5).astype(np.float32)
    splats = replace(splats, means=means, log_scales=splats.log_scales - 15)
    data = encode(EvolutionTree.of_splats(splats), PRESETS["scene"])
    off = np.abs(np.sort(decode(data).leaves().means, axis=0) - np.sort(means, axis=0))
    assert off.max() < 1e-3 * np.ptp(means)


def test_many_levels_ask_for_no_finer_steps_than_some():
    with warnings.catch_warnings():
        warnings.simplefilter("error", AccuracyWarning)
        encode(lift(make_scene(300), 64), PRESETS["scene"])


def test_there_are_as_many_tiles_as_asked_for_while_roots_can_be_divided():
    weight = np.array([1000, 3, 3, 3, 3, 3, 3, 3])
    positions = np.arange(24, dtype=np.float32).reshape(3, 8)
    assert len(set(_kd_tiles(positions, weight, 8).tolist())) == 8


def test_what_is_too_large_is_refused_and_what_is_coarser_is_warned_of():
    beyond = {row.extreme: row.beyond for row in (*codec.scenes(24), *codec.grids(4))}
    refused = [name for name, text in beyond.items() if "`NotRepresentableError`" in text]
    assert len(refused) == 5
    assert all("warned: " in text for name, text in beyond.items() if name.startswith("one "))


def test_projections_keep_their_bounds():
    assert_holds(rasterizer.projections(40))


def test_pictures_keep_their_bounds():
    assert_holds(rasterizer.pictures(30))


def test_piles_in_one_pixel_keep_their_bounds():
    rows = list(rasterizer.piles(20_000))
    assert_holds(rows)
    assert all("max_intersections" in row.beyond for row in rows)


def test_piles_seen_at_their_rims_keep_their_bound():
    assert_holds(rasterizer.rims(50))


def test_a_large_picture_keeps_its_bound():
    assert_holds(rasterizer.large_pictures(400))


@pytest.mark.slow
def test_ten_million_splats_in_one_pixel_keep_their_bounds():
    assert_holds(rasterizer.piles(10_000_000))


@pytest.mark.slow
def test_a_picture_of_8192_by_8192_pixels_keeps_its_bound():
    assert_holds(rasterizer.large_pictures(8192))


@pytest.mark.filterwarnings("ignore:grad and param do not obey:UserWarning")
def test_training_from_the_extremes_stays_finite_or_says_why():
    pytest.importorskip("torch")
    assert_holds(training.starts(16))


@examples(25)
@given(
    st.integers(1, 12),
    st.floats(1e-9, 1e9),
    st.lists(st.floats(-10, 10, width=32), min_size=1, max_size=4),
    st.sampled_from(["scene", "trained", "near-lossless"]),
)
def test_chains_of_any_size_and_alpha_keep_their_bounds(n, size, alphas, preset):
    if preset != "near-lossless":  # with more alphas, products are known to be broken
        alphas = alphas[:1]
    tree = scenes.chain(n, size=size, alphas=alphas)
    assert measure(tree, PRESETS[preset]).part <= 1


@examples(10)
@given(st.floats(-6, 6), st.floats(-4, 6), st.integers(1, 4))
def test_scenes_of_any_place_and_size_keep_their_bounds(place, size, n_levels):
    splats = scenes.plain(20)  # apart in binary32: together far from the origin is known as broken
    means = 10.0**place + 10.0 ** (place + size) * splats.means.astype(np.float64)
    tree = lift(replace(splats, means=means.astype(np.float32)), n_levels)
    for preset in ("scene", "trained", "near-lossless"):
        try:
            assert measure(tree, PRESETS[preset]).part <= 1
        except NotRepresentableError:
            assert np.abs(means).max() > 2.0**38  # docs/extremes.md: grids hold up to 2**39


def test_the_exact_tree_is_the_tree():
    tree = scenes.chain(9, size=1.0, alphas=[0.3, -2.0], degree=1)
    *_, last = tree.states()
    x = exact.slots_of_tree(tree)
    got = np.array([[float(v) / 2.0**298 for v in row] for row in x])
    np.testing.assert_allclose(got, last.values, rtol=1e-12, atol=1e-14)


@given(st.integers(-(1 << 53), 1 << 53), st.integers(-16, 40))
def test_integers_are_rounded_to_binary32_as_the_processor_does(numerator, exponent):
    wanted = np.float32(np.ldexp(np.float64(numerator), -exponent))
    assert exact.float32_of(numerator, exponent) == wanted


@examples(20)
@given(st.integers(0, 1000), st.sampled_from(sorted(views.VIEWS)))
def test_the_decimals_and_the_oracle_are_one_definition(seed, name):
    splats, camera = views.VIEWS[name](40)
    splats = splats.take(np.random.default_rng(seed).permutation(len(splats))[:12])
    picture = render_exactly(splats, camera, rasterizer.BACKGROUND)
    footprints = rasterizer.footprints(splats, camera)
    y, x = seed % camera.height, seed * 7 % camera.width
    place = x + 0.5, y + 0.5
    wanted, doubtful = decimals.pixel(footprints, *place, rasterizer.BACKGROUND, DEFAULT)
    assert doubtful == picture.doubtful[y, x]
    if not doubtful:
        np.testing.assert_allclose(picture.image[y, x], wanted, rtol=1e-9)


# --- the instrument -------------------------------------------------------------------------------


def test_an_error_beyond_the_bound_is_seen(monkeypatch):
    tree = EvolutionTree.of_splats(scenes.plain(10))
    assert measure(tree, PRESETS["scene"]).part <= 1
    wrong = exact.slots_of_tree

    def moved(tree):
        x = wrong(tree)
        x[0, 3] += 1 << 290
        return x

    monkeypatch.setattr(exact, "slots_of_tree", moved)
    found = measure(tree, PRESETS["scene"])
    assert found.part > 10
    assert found.group == "position"


def test_an_error_or_a_warning_of_a_row_is_told():
    def fails():
        raise ValueError("why")

    row = attempted("x", "1", fails)
    assert not row.holds
    assert row.observed == outcome(fails) == "`ValueError`: why"
    assert "broken" in str(row.cells()["part of the bound"])
    assert Row.exact("x", 0, 5, "").holds
    assert not Row.exact("x", 1, 5, "").holds


def test_the_page_has_every_table_and_a_line_for_every_row(tmp_path, monkeypatch):
    text = page.PAGE.read_text(encoding="utf-8")
    marks = re.findall(r"<!-- table (\S+) -->", text)
    assert sorted(marks) == sorted(["made", *page.TABLES])
    made = {name: ((lambda n: iter([Row.exact("x", n, 5, "a|b")]), 0),) for name in page.TABLES}
    monkeypatch.setattr(page, "TABLES", made)
    assert page.remake(tmp_path)
    assert "| x | exact | 0 of 5 differ | none | a\\|b |" in (tmp_path / "extremes.md").read_text()
    (tmp_path / "other.md").write_text("nothing", encoding="utf-8")
    monkeypatch.setattr(page, "PAGE", tmp_path / "other.md")
    with pytest.raises(ValueError, match="0 tables"):
        page.remake(tmp_path)
