"""Round trips through every format: numbers stay within the rounding of docs/interchange.md."""

import struct
import warnings
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import InputError, SceneInfo, SplatParams, read_ply, read_scene, write_scene
from evogs_codec.io.finite import OPAQUE
from evogs_codec.io.interchange import compressed_ply, spz
from evogs_codec.io.interchange import splat as dot_splat
from evogs_codec.io.interchange.frames import turn
from evogs_codec.io.interchange.scene_files import kind_to_write, scene_format
from evogs_codec.io.interchange.values import unit
from tests.support.odd_scenes import odd_scene, opacities, signed_alike

ENDINGS = ("ply", "compressed.ply", "spz", "splat", "glb")
KNOWN_WARNINGS = "ignore:.*(infinite opacity|no SH above band 0|beyond what)"
pytestmark = pytest.mark.filterwarnings(KNOWN_WARNINGS)


def ordered(scene, ending):
    """The scene in the order in which a format writes it."""
    if ending == "compressed.ply":
        return scene.take(compressed_ply.order_of(scene))
    return scene.take(dot_splat.order_of(scene)) if ending == "splat" else scene


def there_and_back(scene, ending, folder, info=None):
    write_scene(folder / f"x.{ending}", scene, info)
    return read_scene(folder / f"x.{ending}").splats


def assert_within(found, scene, *, means, quats, log_scales, opacity, dc, sh):
    """Every number within its bound; of orientations the unit quaternions."""
    assert np.all(np.abs(found.means - scene.means) <= means)
    assert np.abs(signed_alike(found.quats, scene.quats) - unit(scene.quats)).max() <= quats
    assert np.abs(found.log_scales - scene.log_scales).max() <= log_scales
    assert np.abs(opacities(found) - opacities(scene)).max() <= opacity
    assert np.abs(found.sh[:, 0] - scene.sh[:, 0]).max() <= dc
    assert np.all(np.abs(found.sh[:, 1:] - scene.sh[:, 1:]) <= np.asarray(sh)[:, None])


def bounds(ending, scene):
    """What each format rounds by (docs/interchange.md)."""
    n_rest = scene.sh.shape[1] - 1
    if ending in ("ply", "glb"):
        rounding = 0.0 if ending == "ply" else 1e-6
        sh = np.zeros(n_rest)
        return {
            "means": 0, "quats": 1e-6, "log_scales": 2 * rounding,
            "opacity": 1e-7, "dc": 0, "sh": sh,
        }  # fmt: skip
    if ending == "splat":
        return {
            "means": 0, "quats": 0.012, "log_scales": 1e-6, "opacity": 1 / 510 + 1e-6,
            "dc": 0.00696, "sh": np.zeros(0),
        }  # fmt: skip
    three = 3 * 0.5 * 2**0.5 / 1023  # half a step of ten bits, and what it does to the fourth
    if ending == "spz":
        sh = np.where(np.arange(n_rest) < 3, 4.5, 8.5) / 128 + 1e-6
        return {
            "means": 2.0**-13 + 1e-6, "quats": three, "log_scales": 1 / 32 + 1e-6,
            "opacity": 1 / 510 + 1e-6, "dc": 0.5 / 255 / 0.15 + 1e-6, "sh": sh,
        }  # fmt: skip
    steps = np.array([2047, 1023, 2047])
    chunks = np.arange(len(scene)) // 256

    def half_steps(values):
        each = [np.ptp(values[chunks == c], axis=0) / steps / 2 for c in range(chunks[-1] + 1)]
        return np.array(each)[chunks] * 1.01 + 1e-6

    return {
        "means": half_steps(scene.means), "quats": three,
        "log_scales": half_steps(scene.log_scales).max(), "opacity": 1 / 510 + 1e-6,
        "dc": np.ptp(scene.sh[:, 0], axis=0).max() / 510 + 1e-6,
        "sh": np.full(n_rest, 1 / 64 + 1e-6),
    }  # fmt: skip


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("n", [1, 48, 700])
def test_every_number_comes_back_within_the_rounding_of_the_format(ending, degree, n, tmp_path):
    scene = odd_scene(n, degree)
    found = there_and_back(scene, ending, tmp_path)
    expected = ordered(scene, ending)
    if ending == "splat":
        expected = replace(expected, sh=expected.sh[:, :1])
    assert found.sh.shape == expected.sh.shape
    assert_within(found, expected, **bounds(ending, expected))


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_came_back_comes_back_the_same_again(ending, tmp_path):
    first = there_and_back(odd_scene(300), ending, tmp_path)
    second = there_and_back(first, ending, tmp_path)
    expected = ordered(first, ending)
    np.testing.assert_allclose(second.means, expected.means, atol=2e-6, rtol=1e-6)
    np.testing.assert_allclose(second.sh, expected.sh, atol=2e-6)
    np.testing.assert_allclose(second.log_scales, expected.log_scales, atol=4e-6)
    assert np.abs(opacities(second) - opacities(expected)).max() < 1e-6


@pytest.mark.parametrize("ending", ["spz", "glb"])
@pytest.mark.parametrize("frame", [1, 2, 3, 4, 5])
def test_a_format_with_axes_of_its_own_gets_the_same_scene_from_any_axes(ending, frame, tmp_path):
    info = SceneInfo(coordinate_system=frame)
    names = ("", "RDF", "RUB", "RUF", "FLU", "RFU")
    scene = odd_scene()
    write_scene(tmp_path / f"x.{ending}", scene, info)
    found = read_scene(tmp_path / f"x.{ending}")
    expected = scene.means @ turn(names[frame], "RDF").T
    np.testing.assert_allclose(found.splats.means, expected, atol=2e-4)
    assert (found.info.coordinate_system, found.info.up_axis) == (1, 4)  # RDF, -y up


def test_the_numbers_in_a_file_have_the_axes_of_its_format(tmp_path):
    scene = odd_scene(5)
    write_scene(tmp_path / "x.glb", scene)
    data = (tmp_path / "x.glb").read_bytes()
    n_json = struct.unpack_from("<I", data, 12)[0]
    positions = np.frombuffer(data, "<f4", 15, 28 + n_json).reshape(5, 3)
    np.testing.assert_array_equal(positions, scene.means * np.array([-1, -1, 1], np.float32))
    # The bytes of a .spz, without its axes, are those of the scene with y and z negated.
    write_scene(tmp_path / "x.spz", scene)
    as_it_is = scene.means * np.array([1, -1, -1], np.float32)
    raw = spz._splats(*spz._read_4(tmp_path / "x.spz", (tmp_path / "x.spz").read_bytes())[:2])
    np.testing.assert_allclose(raw.means, as_it_is, atol=2e-4)


@pytest.mark.parametrize("ending", ENDINGS)
def test_pictures_are_the_same_from_the_same_camera(ending, tmp_path):
    render = pytest.importorskip("evogs_codec.render", reason="the rasterizer is compiled")
    scene = odd_scene(48, 0 if ending == "splat" else 3)
    camera = render.Camera.look_at(
        [1, -2, -9], [1.3, -0.7, 2.1], (0, -1, 0), width=80, height=60, fov_x=1.2
    )
    found = there_and_back(scene, ending, tmp_path)
    pictures = [render.render(splats, camera, (1.0, 1.0, 1.0)) for splats in (found, scene)]
    least = {"ply": 100, "glb": 90, "spz": 32, "compressed.ply": 42, "splat": 42}
    assert render.psnr(*pictures) > least[ending]


# --- extreme numbers ------------------------------------------------------------------------------


def extreme_scene():
    """Numbers at and beyond what formats hold, in every attribute."""
    scene = odd_scene(32)
    means = scene.means.copy()
    means[:4] = [[1e6, -1e6, 3], [1e-9, 0, -1e-9], [-5000, 5000, 1], [0, 0, 0]]
    log_scales = scene.log_scales.copy()
    log_scales[:5] = np.array([-80, -19, 9, 60, -10.5])[:, None]
    logits = scene.opacity_logits.copy()
    logits[:6] = [80, -80, 17, -17, 0, 5]
    sh = scene.sh.copy()
    sh[:2, 0], sh[2, 1:], sh[3, 1:] = 9, 5, -5
    quats = scene.quats.copy()
    quats[:3] = [[0, 0, 0, 0], [1e-6, 0, 0, 1e-6], [0, -1e6, 0, 0]]
    return SplatParams(means, quats, log_scales, logits, sh)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.filterwarnings("ignore:positions are far from zero")
def test_extreme_numbers_become_the_nearest_that_the_format_holds(ending, tmp_path):
    scene = extreme_scene()
    found, expected = there_and_back(scene, ending, tmp_path), ordered(scene, ending)
    assert found.finite().all()
    reach = {"spz": 0.15, "compressed.ply": 2e6 / 1023}.get(ending, 0)
    assert np.abs(found.means - expected.means).max() <= reach
    assert np.abs(opacities(found) - opacities(expected)).max() <= 1 / 510 + 1e-6
    held = {"spz": (-10, 95 / 16), "compressed.ply": (-20, 20)}.get(ending, (-80, 60))
    rounding = {"ply": 0, "spz": 1 / 32 + 1e-6, "compressed.ply": 80 / 1023}.get(ending, 1e-5)
    nearest = np.clip(expected.log_scales, *held)
    assert np.abs(found.log_scales - nearest).max() <= rounding
    colour = {"spz": (-1 / 0.3, 1 / 0.3), "splat": (-1.7725, 1.7725)}.get(ending, (-99, 99))
    rounding = {"ply": 0, "glb": 0, "compressed.ply": 0.03}.get(ending, 0.0132)
    assert np.abs(found.sh[:, 0] - np.clip(expected.sh[:, 0], *colour)).max() <= rounding
    if ending != "splat":
        sh = {"spz": (-1, 127 / 128), "compressed.ply": (-4, 4)}.get(ending, (-99, 99))
        rounding = {"ply": 0, "glb": 0, "compressed.ply": 1 / 64 + 1e-6}.get(ending, 0.067)
        assert np.abs(found.sh[:, 1:] - np.clip(expected.sh[:, 1:], *sh)).max() <= rounding


@pytest.mark.filterwarnings("ignore:positions are far from zero")
@pytest.mark.parametrize(("ending", "n"), [("spz", 5), ("compressed.ply", 3), ("splat", 2)])
@pytest.mark.filterwarnings("default")
@pytest.mark.filterwarnings("ignore:a .splat has no SH")
def test_a_warning_counts_the_splats_that_a_format_cannot_hold(ending, n, tmp_path):
    with pytest.warns(UserWarning, match=f"{n} of 32 splats have .* beyond what"):
        write_scene(tmp_path / f"x.{ending}", extreme_scene())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "a .splat has no SH")
        write_scene(tmp_path / f"x.{ending}", odd_scene())


@pytest.mark.filterwarnings("default")
def test_an_spz_of_splats_far_from_zero_says_how_many_it_moves(tmp_path):
    far = odd_scene()
    far = replace(far, means=far.means + np.float32(1e6))
    with pytest.warns(UserWarning, match="far from zero: an .spz moves up to 48 splats"):
        write_scene(tmp_path / "x.spz", far)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.filterwarnings("default")
@pytest.mark.filterwarnings("ignore:a .splat has no SH")
def test_infinite_opacities_of_every_format_become_finite(ending, tmp_path):
    """Those of a `.ply` are counted; elsewhere they are bytes of 255, or opacities of 1."""
    scene = odd_scene(10, 1)
    logits = scene.opacity_logits.copy()
    logits[:3] = [60, -60, 200]  # an opacity of 1, or of 0
    if ending in ("ply", "glb"):
        logits[:3] = [np.inf, -np.inf, np.inf]
    scene = replace(scene, opacity_logits=logits)
    if ending == "glb":  # only a .ply holds infinite numbers: here the opacities are 1 and 0
        logits[:3] = [60, -200, 200]
        scene = replace(scene, opacity_logits=logits)
    write_scene(tmp_path / f"x.{ending}", scene)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_scene(tmp_path / f"x.{ending}").splats
    counted = "3 of 10 splats have an infinite opacity: 20 or -20"
    assert [counted in str(one.message) for one in said] == [True] * (ending == "ply")
    assert sorted(found.opacity_logits)[0] == -OPAQUE
    assert sorted(found.opacity_logits)[-2:] == [OPAQUE, OPAQUE]


@pytest.mark.parametrize("ending", [ending for ending in ENDINGS if ending != "ply"])
def test_numbers_that_are_not_finite_are_written_by_a_ply_alone(ending, tmp_path):
    means = odd_scene(4).means.copy()
    means[2, 1] = np.nan
    with pytest.raises(InputError, match=r"1 splats have a NaN"):
        write_scene(tmp_path / f"x.{ending}", replace(odd_scene(4), means=means))
    assert not (tmp_path / f"x.{ending}").exists()


@pytest.mark.parametrize("ending", ["ply", "compressed.ply", "spz"])
def test_a_scene_without_splats_comes_back(ending, tmp_path):
    empty = odd_scene(4, 2).take(np.arange(0))
    found = there_and_back(empty, ending, tmp_path)
    assert (len(found), found.sh_degree) == (0, 2)


@pytest.mark.filterwarnings("ignore:a .splat has no SH")
def test_a_splat_file_that_could_not_be_told_is_not_written(tmp_path):
    far = replace(odd_scene(4), means=odd_scene(4).means + np.float32(1e10))
    for scene in (odd_scene(4).take(np.arange(0)), far):
        with pytest.raises(InputError, match=r"could not be read again; name a \.ply"):
            write_scene(tmp_path / "x.splat", scene)
        assert not (tmp_path / "x.splat").exists()


def test_a_glb_without_splats_is_refused(tmp_path):
    with pytest.raises(InputError, match="at least one splat"):
        write_scene(tmp_path / "x.glb", odd_scene(4).take(np.arange(0)))


@pytest.mark.filterwarnings("ignore:positions are far from zero")
def test_an_spz_has_finer_positions_for_a_small_scene_and_coarser_for_a_large_one(tmp_path):
    for factor, rounding in ((1e-3, 1e-7), (1.0, 2**-13), (1e3, 2**-11), (1e6, 0.5)):
        scene = odd_scene(48, 0)
        scene = replace(scene, means=scene.means * np.float32(factor))
        found = there_and_back(scene, "spz", tmp_path)
        assert np.abs(found.means - scene.means).max() <= rounding * 1.001 + 1e-9, factor
    scene = replace(scene, means=scene.means * np.float32(1e6))
    with pytest.raises(InputError, match="positions reach"):
        write_scene(tmp_path / "x.spz", scene)


# --- what files say -------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["ply", "compressed.ply", "spz"])
@pytest.mark.parametrize("antialiased", [True, False])
def test_antialiased_scenes_are_marked_and_read_as_such(ending, antialiased, tmp_path):
    write_scene(tmp_path / f"x.{ending}", odd_scene(4), SceneInfo(antialiased=antialiased))
    assert read_scene(tmp_path / f"x.{ending}").info.antialiased == antialiased


@pytest.mark.parametrize("ending", ["ply", "compressed.ply"])
@pytest.mark.parametrize("up", range(7))
def test_the_up_axis_is_kept_by_a_ply(ending, up, tmp_path):
    write_scene(tmp_path / f"x.{ending}", odd_scene(4), SceneInfo(up_axis=up))
    assert read_scene(tmp_path / f"x.{ending}").info.up_axis == up


@pytest.mark.parametrize(("space", "said"), [(0, 1), (1, 1), (2, 2)])
def test_the_colour_space_is_kept_by_a_glb(space, said, tmp_path):
    write_scene(tmp_path / "x.glb", odd_scene(4), SceneInfo(colour_space=space))
    assert read_scene(tmp_path / "x.glb").info.colour_space == said


def test_the_bytes_and_not_the_name_say_what_a_file_is(tmp_path):
    for ending, name in zip(
        ENDINGS, ["ply", "compressed.ply", "spz", "splat", "gltf"], strict=True
    ):
        write_scene(tmp_path / f"x.{ending}", odd_scene(300, 0))
        other = tmp_path / ("any.splat" if ending == "splat" else f"any-{ending}.txt")
        (tmp_path / f"x.{ending}").rename(other)
        assert scene_format(other) == name
        assert len(read_scene(other).splats) == 300


def test_an_ending_that_is_not_written_is_refused_with_the_list(tmp_path):
    for name in ("x.txt", "x.evogs.part", "x.ksplat", "x.sog"):
        with pytest.raises(InputError, match=r"\.compressed\.ply, \.ply, \.spz, \.splat, \.glb"):
            kind_to_write(tmp_path / name)
    with pytest.raises(InputError, match="evogs encode"):
        write_scene(tmp_path / "x.evogs", odd_scene(4))
    assert list(tmp_path.iterdir()) == []


def test_a_name_without_an_ending_gets_a_ply(tmp_path):
    write_scene(tmp_path / "x", odd_scene(4))
    assert len(read_ply(tmp_path / "x")) == 4


# --- versions and forms that we do not write ------------------------------------------------------
