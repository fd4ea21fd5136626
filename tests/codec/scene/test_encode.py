"""`encode_scene` and `encode_tree` do what `evogs encode` does, and say what they cannot do."""

import math
import re
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import evogs_codec
from evogs_codec import (
    PRESETS,
    AccuracyWarning,
    InputError,
    RangeBits,
    SceneInfo,
    SplatParams,
    decode,
    encode,
    encode_scene,
    encode_scene_with_order,
    encode_tree,
    leaf_order,
    lift,
    lift_with_order,
    read_directory,
    read_ply,
    write_ply,
    write_tree,
)
from evogs_codec.cli.commands import main
from evogs_codec.render.demo_scene import make_scene
from tests.support.quanta import in_quanta
from tests.support.shared_scenes import shared_scene
from tests.support.view_sizes import SMALL, views_of


@cache
def small():
    """A scene of 300 splats."""
    return make_scene(300)


@cache
def small_tree():
    return lift(small(), 3)


def by_command(tmp_path, source, *options):
    """The stream that `evogs encode` writes."""
    out = tmp_path / "command.evogs"
    assert main(["encode", str(source), str(out), *options]) == 0
    return out.read_bytes()


# --- the same bytes as the command ----------------------------------------------------------------


@pytest.fixture
def one_size_of_views():
    """Of the command and of the library. Small ones show as well that both do the same."""
    with views_of(SMALL):
        yield


def test_a_scene_is_encoded_as_the_command_does(tmp_path):
    write_ply(tmp_path / "s.ply", make_scene(500))
    assert encode_scene(read_ply(tmp_path / "s.ply")) == by_command(tmp_path, tmp_path / "s.ply")


@pytest.mark.thorough
@pytest.mark.usefixtures("one_size_of_views")
@pytest.mark.parametrize(
    ("words", "options"),
    [
        (["--levels", "2", "--tiles", "2", "--effort", "3"], {"levels": 2, "n_tiles": 2}),
        (["--preset", "trained", "--up=-y"], {"preset": "trained", "up": "-y"}),
        (["--near-lossless"], {"preset": "near-lossless"}),
        (["--finer", "3"], {"preset": PRESETS["scene"].finer(3)}),
        (["--bits", "7"], {"preset": replace(PRESETS["scene"], accuracy=RangeBits(7))}),
        (["--max-error", "0.5", "position=0.01"], {"max_error": 0.5}),
        (["--target-bytes", "9000"], {"target_bytes": 9000}),
        (["--title", "A scene"], {"info": SceneInfo(text={"title": "A scene"})}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_every_option_of_the_command_is_one_of_the_library(tmp_path, words, options):
    write_ply(tmp_path / "s.ply", small())
    if "max_error" in options:
        names = ("rotation", "scale", "opacity", "sh")
        options = {"max_error": {"position": 0.01} | dict.fromkeys(names, 0.5)}
    if "--effort" in words:
        options = options | {"effort": 3}
    data = encode_scene(read_ply(tmp_path / "s.ply"), **options)
    assert data == by_command(tmp_path, tmp_path / "s.ply", *words)


@pytest.mark.thorough
@pytest.mark.usefixtures("one_size_of_views")
@pytest.mark.parametrize("palette", ["auto", "never"])
def test_a_palette_is_taken_by_both(tmp_path, palette):
    write_ply(tmp_path / "s.ply", shared_scene())
    words = [] if palette == "auto" else ["--no-palette"]
    data = encode_scene(read_ply(tmp_path / "s.ply"), palette=palette)
    assert read_directory(data).has_palette == (palette == "auto")
    assert data == by_command(tmp_path, tmp_path / "s.ply", *words)


@pytest.mark.thorough
@pytest.mark.usefixtures("one_size_of_views")
@pytest.mark.parametrize("preset", [None, "trained"])
@pytest.mark.parametrize("name", ["floats", "integers"])
def test_a_tree_is_encoded_as_the_command_does(tmp_path, name, preset):
    tree = small_tree() if name == "floats" else in_quanta()
    write_tree(tmp_path / "a.tree.npz", tree)
    read = evogs_codec.read_tree(tmp_path / "a.tree.npz")
    words = [] if preset is None else ["--preset", preset]
    assert encode_tree(read, preset=preset) == by_command(tmp_path, tmp_path / "a.tree.npz", *words)


# --- the order of splats --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "n_tiles"),
    [
        (small, 1),
        pytest.param(small, 3, marks=pytest.mark.thorough),
        pytest.param(shared_scene, 1, marks=pytest.mark.thorough),
        pytest.param(shared_scene, 3, marks=pytest.mark.thorough),
    ],
)
def test_the_order_of_the_splats_of_a_stream_is_known(scene, n_tiles):
    splats = scene()
    found = encode_scene_with_order(splats, n_tiles=n_tiles, effort=1, cameras=())
    assert sorted(found.leaf_order) == list(range(len(splats)))
    expected = splats.take(found.leaf_order)
    leaves = decode(found.data).leaves()
    extent = np.ptp(splats.means, axis=0).max()
    assert np.abs(leaves.means - expected.means).max() < 1e-3 * extent
    assert np.abs(leaves.opacity_logits - expected.opacity_logits).max() < 1


def test_the_order_of_a_tree_is_that_of_its_leaves():
    tree = in_quanta()
    data = encode(tree)
    order = leaf_order(tree)
    off = decode(data).leaves(sh_degree=0).channels() - tree.leaves().channels()[:, order]
    assert np.abs(off).max() <= 2 * 0.25 / 32
    empty = encode_tree(evogs_codec.EvolutionTree.of_splats(small().take([])))
    assert decode(empty).n_leaves == len(leaf_order(evogs_codec.EvolutionTree(0, ()))) == 0


def test_lifting_and_leaf_order_together_give_the_order_of_a_scene():
    splats = small()
    lifted = lift_with_order(splats, 5)
    found = encode_scene_with_order(splats, levels=5, cameras=(), effort=1)
    assert (lifted.leaf_of[leaf_order(lifted.tree)] == found.leaf_order).all()


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: encode(small()), TypeError, "encode_scene takes splats"),
        (lambda: encode(b""), TypeError, "not bytes: see read_tree"),  # type: ignore[arg-type]
        (lambda: encode(small_tree()), ValueError, "encode_tree chooses them"),
        (lambda: encode(small_tree(), "scene"), TypeError, r"PRESETS\['scene'\]"),  # type: ignore[arg-type]
        (lambda: encode(small_tree(), "best"), TypeError, "a preset of PRESETS"),  # type: ignore[arg-type]
        (lambda: encode_tree(small()), TypeError, "encode_scene takes splats"),
        (lambda: encode_scene(small_tree()), TypeError, "encode_tree takes trees"),
        (lambda: encode_scene("scene.ply"), TypeError, "not str: see read_ply"),  # type: ignore[arg-type]
        (lambda: encode_scene(small(), preset="best"), ValueError, "one of scene, trained"),
        (lambda: encode_scene(small(), palette=True), ValueError, "'auto' or 'never'"),  # type: ignore[arg-type]
        (lambda: encode_scene(small(), effort=30), ValueError, "effort is 30"),
        (lambda: encode_scene(small(), n_tiles=0), ValueError, "n_tiles is 0"),
        (lambda: encode(small_tree(), PRESETS["scene"], n_tiles=0), ValueError, "n_tiles is 0"),
        (lambda: leaf_order(small_tree(), -1), ValueError, "n_tiles is -1"),
        (lambda: encode_scene(small(), levels=65), ValueError, r"levels is 65, expected 1\.\.64"),
        (lambda: encode_scene(small(), levels=0), ValueError, "levels is 0"),
        (lambda: encode_scene(small(), target_psnr=math.nan), ValueError, "target_psnr is nan"),
        (lambda: encode_scene(small(), target_psnr=math.inf), ValueError, "target_psnr is inf"),
        (lambda: encode_scene(small(), target_bytes=0), ValueError, "target_bytes is 0"),
        (lambda: encode_tree(small_tree(), target_bytes=-5), ValueError, "target_bytes is -5"),
        (lambda: encode_scene_with_order(small(), level=3), TypeError, "no such option: level"),  # type: ignore[call-arg]
        (lambda: encode_scene(small(), max_error={"shape": 1}), ValueError, "max_error is of"),
        (
            lambda: encode_scene(small(), target_psnr=40, target_bytes=9),
            ValueError,
            "exclude each other",
        ),
        (
            lambda: encode_scene(small(), preset="scene", target_psnr=40),
            ValueError,
            "does not go with a target",
        ),
        (lambda: encode_scene(small(), polish=3), ValueError, "polish needs target_psnr"),
        (
            lambda: encode_scene(small(), target_psnr=40, cameras=()),
            InputError,
            "a target PSNR needs rendered views: there are no cameras",
        ),
        (lambda: encode_scene(small(), target_bytes=20), evogs_codec.TargetMissedError, "20 bytes"),
        (
            lambda: encode_scene(small(), improve=lambda _: lift(small().take([1, 2]), 1)),
            ValueError,
            "improve must keep the leaves: 2 leaves came back of 300",
        ),
    ],
)
def test_what_cannot_be_done_is_said_with_what_to_call(call, error, words):
    with pytest.raises(error, match=words):
        call()


@pytest.mark.thorough
def test_without_numba_views_are_asked_for_and_estimates_order_packets(monkeypatch):
    monkeypatch.setattr("evogs_codec.scene.request.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"a target PSNR needs rendered views: numba is missing"):
        encode_scene(small(), target_psnr=40)
    with pytest.warns(UserWarning, match="encoded with the preset scene instead"):
        data = encode_scene(small(), effort=1)
    assert data == encode_scene(small(), effort=1, cameras=())
    with pytest.warns(UserWarning, match="encoded with the preset trained instead"):
        data = encode_tree(small_tree(), effort=1)
    assert data == encode_tree(small_tree(), preset="trained", effort=1)


@pytest.mark.thorough
def test_a_generator_that_is_named_stays():
    def generator(info):
        data = encode_scene(small(), info=info, cameras=(), effort=1)
        return read_directory(data).info.text["generator"]

    assert generator(None) == f"evogs {evogs_codec.__version__}"
    assert generator(SceneInfo(text={"generator": "mine"})) == "mine"


def test_coarse_levels_may_be_improved_and_the_leaves_stay():
    seen = []

    def improve(tree):
        seen.append(tree.n_levels)
        return tree

    assert encode_scene(small(), levels=3, improve=improve, cameras=(), effort=1) == encode_scene(
        small(), levels=3, cameras=(), effort=1
    )
    assert seen == [3]


def test_progress_names_its_stages():
    stages: dict[str, float] = {}
    encode_scene(small(), progress=stages.__setitem__, effort=1, cameras=())
    assert set(stages) == {"lift", "arrange", "quantise", "pack", "verify"}


def test_a_scene_of_no_splats_is_a_stream():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = encode_scene(SplatParams.from_channels(np.zeros((14, 0))))
    assert decode(data).n_leaves == 0


@pytest.mark.thorough
def test_the_default_has_two_layers_and_is_smaller_than_the_preset_at_its_psnr():
    pytest.importorskip("numba", reason="views are rendered")
    from evogs_codec.render.demo_scene import make_scene
    from evogs_codec.render.views import Views

    splats = make_scene(4000)
    views = Views.of(splats, n_views=6)
    found, fixed = encode_scene(splats, effort=3), encode_scene(splats, preset="scene", effort=3)
    directory = read_directory(found)
    assert (directory.n_levels, read_directory(fixed).n_levels) == (3, 2)
    assert len(found) < len(fixed)
    assert views.psnr(decode(found).leaves()) > views.psnr(decode(fixed).leaves()) - 0.5


@pytest.mark.thorough
def test_a_tree_of_all_levels_has_no_room_for_a_layer(monkeypatch):
    pytest.importorskip("numba", reason="views are rendered")
    from evogs_codec.render import cameras_around

    # A search among streams of so many packets would take most of the time.
    monkeypatch.setattr("evogs_codec.scene.falls.steady.without_falls", lambda found, *_: found)
    splats = make_scene(20)
    few = cameras_around(splats, "z", 60, n=2)  # any views will do
    data = encode_scene(splats, levels=64, effort=1, cameras=few)
    assert read_directory(data).n_levels == 64


def test_splats_far_from_all_others_are_a_warning_by_default():
    pytest.importorskip("numba", reason="views are rendered")
    splats = make_scene(60)
    means = splats.means.copy()
    means[7] = 1e7
    with pytest.warns(evogs_codec.AccuracyWarning, match="position: values span so much"):
        encode_scene(replace(splats, means=means), levels=2, up="z", effort=1)


def test_a_target_below_all_streams_says_to_leave_it_out():
    pytest.importorskip("numba", reason="views are rendered")
    clear = replace(make_scene(60), opacity_logits=np.full(60, -40, np.float32))
    said = "45 dB cannot be met: every stream has more than 120 dB; leave the target out"
    with pytest.raises(evogs_codec.TargetMissedError, match=said):
        encode_scene(clear, target_psnr=45.0, up="z", effort=1)


@pytest.mark.thorough
def test_fixed_steps_that_move_splats_far_for_their_size_are_a_warning():
    splats = small()
    far = replace(splats, means=splats.means * np.float32(50))
    with pytest.warns(AccuracyWarning, match=r"moved by up to .*: try --finer \d+, or") as said:
        encode_scene(far, preset="scene", effort=1)
    (finer,) = re.findall(r"--finer (\d+)", str(said[0].message))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        encode_scene(far, preset=PRESETS["scene"].finer(int(finer)), effort=1)
        encode_scene(splats, preset="scene", effort=1)
    dots = replace(splats, log_scales=np.full_like(splats.log_scales, -1000))
    with pytest.warns(AccuracyWarning, match="a size of 0 at most: try no preset"):
        encode_scene(dots, preset="scene", effort=1)
