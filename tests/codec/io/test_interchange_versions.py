"""Versions and forms of files that are read and never written."""

import json
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import InputError, read_ply, read_scene, write_scene
from evogs_codec.io.interchange import compressed_ply, spz
from evogs_codec.io.interchange.bounded import zstd
from evogs_codec.io.interchange.frames import turn
from evogs_codec.io.interchange.values import unit
from tests.support.odd_scenes import covariances, odd_scene, signed_alike, spread
from tests.support.scene_files import old_spz, sog_1

KNOWN_WARNINGS = "ignore:.*(infinite opacity|no SH above band 0|beyond what)"
pytestmark = pytest.mark.filterwarnings(KNOWN_WARNINGS)


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
