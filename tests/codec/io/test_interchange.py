"""Round trips through every format: numbers stay within the rounding of docs/interchange.md."""

import gzip
import json
import struct
import warnings
import zipfile
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from evogs_codec import InputError, SceneInfo, SplatParams, read_ply, read_scene, write_scene
from evogs_codec.io.interchange import compressed_ply, spz
from evogs_codec.io.interchange import splat as dot_splat
from evogs_codec.io.interchange.bounded import zstd
from evogs_codec.io.interchange.frames import turn
from evogs_codec.io.interchange.scene_files import kind_to_write, scene_format
from evogs_codec.io.interchange.values import largest_and_rest, unit
from evogs_codec.io.ply import OPAQUE
from tests.support.odd_scenes import covariances, odd_scene, opacities, spread

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


def signed_alike(quats, like):
    """Unit quaternions, of q and -q that which is nearer."""
    one, other = unit(quats), unit(like)
    return one * np.where((one * other).sum(1) < 0, -1, 1)[:, None]


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


@pytest.mark.parametrize(("ending", "n"), [("spz", 5), ("compressed.ply", 3)])
@pytest.mark.filterwarnings("default")
def test_a_warning_counts_the_splats_that_a_format_cannot_hold(ending, n, tmp_path):
    with pytest.warns(UserWarning, match=f"{n} of 32 splats have .* beyond what"):
        write_scene(tmp_path / f"x.{ending}", extreme_scene())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_scene(tmp_path / f"x.{ending}", odd_scene())


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.filterwarnings("default")
@pytest.mark.filterwarnings("ignore:a .splat has no SH")
def test_infinite_opacities_of_every_format_become_finite_and_are_counted(ending, tmp_path):
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
    with pytest.warns(UserWarning, match=r"3 of 10 splats have an infinite opacity: 20 or -20"):
        found = read_scene(tmp_path / f"x.{ending}").splats
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


def test_a_glb_without_splats_is_refused(tmp_path):
    with pytest.raises(InputError, match="at least one splat"):
        write_scene(tmp_path / "x.glb", odd_scene(4).take(np.arange(0)))


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


def old_spz(scene, version):
    """An `.spz` of version 1 to 3, of a scene in its own axes."""
    n = len(scene)
    if version == 1:
        positions = scene.means.astype("<f2").tobytes()
    else:
        fixed = np.rint(scene.means * 4096.0).astype("<i4")
        positions = fixed.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    xyzw = np.roll(unit(scene.quats), -1, axis=1)
    if version < 3:
        xyz = xyzw[:, :3] * np.where(xyzw[:, 3:] < 0, -1, 1)
        rotations = np.rint(xyz * 127.5 + 127.5).clip(0, 255).astype(np.uint8).tobytes()
    else:
        largest, rest = largest_and_rest(xyzw)
        words = largest.astype("<u4") << 30
        for i, at in enumerate((20, 10, 0)):
            part = rest[:, i]
            step = np.rint(np.abs(part) * 511 * 2**0.5).astype("<u4")
            words |= (step | (part < 0).astype("<u4") << 9) << at
        rotations = words.tobytes()
    head = struct.pack("<4sIIBBBB", b"NGSP", version, n, scene.sh_degree, 12, 1, 0)
    as_bytes = [
        opacities(scene) * 255,
        (scene.sh[:, 0] * 0.15 + 0.5) * 255,
        (scene.log_scales + 10) * 16,
    ]
    alphas, colours, scales = (
        np.rint(part).clip(0, 255).astype(np.uint8).tobytes() for part in as_bytes
    )
    sh = (np.rint(scene.sh[:, 1:] * 128) + 128).clip(0, 255).astype(np.uint8).tobytes()
    return gzip.compress(head + positions + alphas + colours + scales + rotations + sh)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("version", [1, 2, 3])
def test_older_versions_of_spz_are_read(version, degree, tmp_path):
    scene = odd_scene(degree=degree)
    (tmp_path / "x.spz").write_bytes(old_spz(scene, version))
    found = read_scene(tmp_path / "x.spz")
    assert found.info.antialiased
    back = replace(
        found.splats, means=found.splats.means * np.array([1, -1, -1], np.float32), sh=scene.sh * 0
    )
    np.testing.assert_allclose(back.means, scene.means, atol=2e-3 if version == 1 else 2.0**-12)
    turned = np.array([1.0, -1, -1])
    expected = covariances(scene) * turned[:, None] * turned
    assert np.abs(covariances(found.splats) - expected).max() < 0.01
    assert np.abs(found.splats.sh[:, 0] - scene.sh[:, 0]).max() < 0.0132
    assert np.abs(np.abs(found.splats.sh) - np.abs(scene.sh)).max() < 0.0132


def test_bands_of_an_spz_above_3_are_left_out_with_a_warning(tmp_path):
    write_scene(tmp_path / "x.spz", odd_scene(6, 0))
    data = bytearray((tmp_path / "x.spz").read_bytes())
    rest = np.full(6 * 72, 130, np.uint8).tobytes()
    frame = zstd(rest, 3)
    data[12], data[15] = 4, 6
    table_end = 32 + 16 * 5
    data[table_end:table_end] = struct.pack("<QQ", len(frame), len(rest))
    (tmp_path / "x.spz").write_bytes(bytes(data) + frame)
    with pytest.warns(UserWarning, match="SH of band 4 are left out"):
        found = read_scene(tmp_path / "x.spz").splats
    assert found.sh.shape == (6, 16, 3)
    np.testing.assert_allclose(np.abs(found.sh[:, 1:]), 2 / 128)


@pytest.mark.parametrize("name", ["RDF", "RUB", "LUF", "RFU", "LBD", "RUF"])
def test_the_record_of_axes_of_an_spz_is_followed(name, tmp_path):
    scene = odd_scene()
    write_scene(tmp_path / "x.spz", scene)
    data = bytearray((tmp_path / "x.spz").read_bytes())
    data[14] |= 2
    data[16:20] = struct.pack("<I", 32 + 24)
    number = spz.FRAMES.index(name, 1)
    unknown = struct.pack("<III", 0xADBE0002, 4, 0)
    data[32:32] = unknown + struct.pack("<III", 0xADBE0003, 4, number)
    (tmp_path / "x.spz").write_bytes(data)
    in_file = scene.means * np.array([1, -1, -1], np.float32)
    expected = in_file @ turn(name, "RDF").T
    found = read_scene(tmp_path / "x.spz")
    np.testing.assert_allclose(found.splats.means, expected, atol=2e-4)
    assert found.info.up_axis == 4


def webp(values, width=16):
    """A picture that has these bytes, (N, 1 to 4), as its first pixels."""
    height = -(-len(values) // width)
    pixels = np.zeros((width * height, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(values), : values.shape[1]] = values
    stream = BytesIO()
    image = Image.fromarray(pixels.reshape(height, width, 4), "RGBA")
    image.save(stream, "WEBP", lossless=True, exact=True)
    return stream.getvalue()


def sog_1(scene):
    """The files of a `.sog` of version 1, which has ranges and no codebooks."""
    logs = np.sign(scene.means) * np.log1p(np.abs(scene.means))
    low, high = logs.min(0), logs.max(0)
    steps = np.rint((logs - low) / (high - low) * 65535).astype(np.uint16)
    largest, rest = largest_and_rest(unit(scene.quats))
    three = np.rint((rest * 2**0.5 + 1) * 127.5).clip(0, 255)
    colours = np.concatenate([scene.sh[:, 0], scene.opacity_logits[:, None]], axis=1)

    def in_bytes(values):
        least, most = values.min(0), values.max(0)
        part = np.rint((values - least) / (most - least) * 255).astype(np.uint8)
        return part, {"mins": least.tolist(), "maxs": most.tolist()}

    scale_bytes, scale_range = in_bytes(scene.log_scales)
    colour_bytes, colour_range = in_bytes(colours)
    k = scene.sh.shape[1] - 1
    palette, (rest_low, rest_high) = scene.sh[:, 1:], (scene.sh.min(), scene.sh.max())
    entries = np.zeros((64, k, 3), np.uint8)
    entries[: len(scene)] = np.rint((palette - rest_low) / (rest_high - rest_low) * 255)
    n = len(scene)
    labels = np.arange(n, dtype=np.uint8)[:, None] * [1, 0]
    meta = {
        "means": {
            "shape": [n, 3], "mins": low.tolist(), "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {**scale_range, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {**colour_range, "files": ["sh0.webp"]},
        "shN": {
            "mins": float(rest_low), "maxs": float(rest_high),
            "files": ["centroids.webp", "labels.webp"],
        },
    }  # fmt: skip
    if not k:
        del meta["shN"]
    return {
        "meta.json": json.dumps(meta).encode(),
        "means_l.webp": webp(steps & 255),
        "means_u.webp": webp(steps >> 8),
        "scales.webp": webp(scale_bytes),
        "quats.webp": webp(np.concatenate([three, largest[:, None] + 252], axis=1)),
        "sh0.webp": webp(colour_bytes),
        "centroids.webp": webp(entries.reshape(-1, 3), 64 * k) if k else b"",
        "labels.webp": webp(labels),
    }


@pytest.mark.parametrize("form", ["zip", "zip with a folder", "folder", "meta.json"])
@pytest.mark.parametrize("degree", range(4))
def test_a_sog_of_version_1_is_read_from_a_zip_and_from_a_folder(form, degree, tmp_path):
    scene = odd_scene(degree=degree)
    files, path = sog_1(scene), tmp_path / "scene"
    if form.startswith("zip"):
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in files.items():
                archive.writestr(("inner/" if "folder" in form else "") + name, data)
    else:
        path.mkdir()
        for name, data in files.items():
            (path / name).write_bytes(data)
        path = path / "meta.json" if form == "meta.json" else path
    found = read_scene(path).splats
    np.testing.assert_allclose(found.means, scene.means, atol=3e-4)
    np.testing.assert_allclose(found.log_scales, scene.log_scales, atol=0.0062)
    np.testing.assert_allclose(found.opacity_logits, scene.opacity_logits, atol=0.02)
    np.testing.assert_allclose(found.sh, scene.sh, atol=0.01)
    assert np.abs(signed_alike(found.quats, scene.quats) - unit(scene.quats)).max() < 0.009


def test_a_sog_says_that_it_is_antialiased(tmp_path):
    files = sog_1(odd_scene(degree=1))
    for key, value, expected in (("model", "antialiased", True), ("model", "2dgs", False)):
        meta = json.loads(files["meta.json"]) | {key: value}
        for name, data in (files | {"meta.json": json.dumps(meta).encode()}).items():
            (tmp_path / name).write_bytes(data)
        assert read_scene(tmp_path).info.antialiased == expected


def test_without_pillow_a_sog_is_refused_in_one_line(tmp_path, monkeypatch):
    for name, data in sog_1(odd_scene(degree=1)).items():
        (tmp_path / name).write_bytes(data)
    monkeypatch.setitem(__import__("sys").modules, "PIL", None)
    with pytest.raises(InputError, match=r"needs Pillow: pip install -e '\.\[interchange\]'"):
        read_scene(tmp_path)


def test_bounds_of_colours_may_be_missing_in_a_compressed_ply(tmp_path):
    scene = odd_scene(20, 0)
    scene = replace(scene, sh=scene.sh.clip(-1.7, 1.7))
    write_scene(tmp_path / "x.compressed.ply", scene)
    data = (tmp_path / "x.compressed.ply").read_bytes()
    head, _, body = data.partition(b"end_header\n")
    for name in (b"min_r", b"min_g", b"min_b", b"max_r", b"max_g", b"max_b"):
        head = head.replace(b"property float %s\n" % name, b"")
    bound = np.frombuffer(body, "<f4", 18)
    (tmp_path / "y.ply").write_bytes(head + b"end_header\n" + body[:48] + body[72:])
    found = read_scene(tmp_path / "y.ply").splats
    expected = scene.take(compressed_ply.order_of(scene))
    # The bytes are now parts of 0 to 1, not of the range of the chunk.
    low, high = bound[12:15], bound[15:18]
    parts = (found.sh[:, 0] * 0.28209479 + 0.5) * (high - low) + low
    np.testing.assert_allclose((parts - 0.5) / 0.28209479, expected.sh[:, 0], atol=0.01)
    np.testing.assert_allclose(found.means, expected.means, atol=0.01)


def test_a_ply_is_read_as_by_read_ply(tmp_path):
    write_scene(tmp_path / "x.ply", odd_scene(9, 2))
    one, other = read_ply(tmp_path / "x.ply"), read_scene(tmp_path / "x.ply").splats
    np.testing.assert_array_equal(one.channels(), other.channels())


def test_positions_of_doubles_are_rounded_once(tmp_path):
    values = spread(3, 14, low=-3, high=3)
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    for order, form in (("<", "binary_little_endian"), (">", "binary_big_endian")):
        kinds = [(name, f"{order}f8" if name in "xyz" else f"{order}f4") for name in names]
        rows = np.array([tuple(row) for row in values], kinds)
        lines = [f"property {'double' if name in 'xyz' else 'float'} {name}" for name in names]
        header = "\n".join(
            ["ply", f"format {form} 1.0", "element vertex 3", *lines, "end_header\n"]
        )
        (tmp_path / "x.ply").write_bytes(header.encode() + rows.tobytes())
        found = read_scene(tmp_path / "x.ply").splats
        np.testing.assert_array_equal(found.means, values[:, :3].astype(np.float32))
