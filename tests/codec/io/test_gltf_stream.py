"""Streams in glTF files: the same bytes come out, splats stand where they stood, nothing hostile.

Letters of frames are those of `evogs_codec.io.interchange.frames`.
"""

import json
import random
import struct
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from evogs_codec import (
    InputError,
    SceneInfo,
    decode_leaves,
    encode_scene,
    read_directory,
    read_gltf_stream,
    read_scene,
    write_gltf_stream,
)
from evogs_codec._generated import registry
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.io.interchange import gltf_stream
from evogs_codec.io.interchange.gltf_stream import EXTENSION, KHR
from tests.support import damaged_files as damage
from tests.support import scene_files
from tests.support.odd_scenes import covariances, odd_scene

refusal = partial(scene_files.refusal, peak=100 << 20)

FORMS = ("x.glb", "x.gltf", "fallback.glb", "fallback.gltf")


@cache
def encoded(n):
    return encode_scene(odd_scene(n, 1), levels=3, preset="scene")


def stream(info=None, n=40):
    """A stream that says this of its scene."""
    data = encoded(n)
    directory = read_directory(data)
    said = replace(directory, info=info or SceneInfo())
    head = rebuild_directory(said, said.tiles, said.packets, said.digests)
    return head + data[directory.data_offset :]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A stream, and all forms of glTF files with it."""
    made = tmp_path_factory.mktemp("forms")
    (made / "x y.evogs").write_bytes(stream(SceneInfo(text={"title": "Odd", "author": "Me"})))
    for name in FORMS:
        write_gltf_stream(made / name, made / "x y.evogs", fallback="fallback" in name)
    return made


def root_of(path):
    data = path.read_bytes()
    if data[:4] == b"glTF":
        data = data[20 : 20 + struct.unpack_from("<I", data, 12)[0]]
    return json.loads(data)


@pytest.mark.parametrize("name", FORMS)
def test_the_same_bytes_come_out(name, folder):
    data = (folder / "x y.evogs").read_bytes()
    assert read_gltf_stream(folder / name) == data
    if name.endswith(".glb"):
        assert (folder / name).read_bytes().rstrip(b"\0").endswith(data.rstrip(b"\0"))


@pytest.mark.parametrize("name", FORMS)
def test_a_scene_is_read_as_the_stream_has_it(name, folder):
    found, expected = read_scene(folder / name), decode_leaves(folder / "x y.evogs")
    np.testing.assert_array_equal(found.splats.means, expected.means)
    np.testing.assert_array_equal(found.splats.sh, expected.sh)
    np.testing.assert_array_equal(found.splats.log_scales, expected.log_scales)
    assert found.info.text == {"title": "Odd", "author": "Me"}
    assert root_of(folder / name)["asset"]["copyright"] == "Me"


@pytest.mark.parametrize("system", registry.COORDINATE_SYSTEMS)
def test_the_matrix_turns_the_axes_of_the_stream_to_those_of_gltf(system, tmp_path):
    data = stream(SceneInfo(coordinate_system=registry.COORDINATE_SYSTEMS.index(system)))
    write_gltf_stream(tmp_path / "x.glb", data)
    found, own = read_scene(tmp_path / "x.glb"), decode_leaves(data)
    x, y, z = own.means.T
    in_rdf = {
        "RUB": (x, -y, -z), "RUF": (x, -y, z), "FLU": (-y, -z, x), "RFU": (x, -z, y)
    }.get(system, (x, y, z))  # fmt: skip
    np.testing.assert_array_equal(found.splats.means, np.stack(in_rdf, axis=1))
    assert registry.UP_AXES[found.info.up_axis] == "-y"
    turned = np.linalg.eigvalsh(covariances(found.splats))
    np.testing.assert_allclose(turned, np.linalg.eigvalsh(covariances(own)), rtol=1e-4)


@pytest.mark.parametrize("up", registry.UP_AXES[1:])
def test_up_is_y_where_a_stream_says_no_more_than_what_is_up(up, tmp_path):
    data = stream(SceneInfo(up_axis=registry.UP_AXES.index(up)))
    write_gltf_stream(tmp_path / "x.glb", data)
    heights = decode_leaves(data).means[:, "xyz".index(up[1])] * (-1 if up[0] == "-" else 1)
    np.testing.assert_array_equal(-read_scene(tmp_path / "x.glb").splats.means[:, 1], heights)
    matrix = np.reshape(root_of(tmp_path / "x.glb")["nodes"][0]["matrix"], (4, 4))
    assert np.linalg.det(matrix) == 1  # no mirror


def test_counts_and_bounds_are_those_of_the_stream_and_the_fallback_has_its_level_0(folder):
    plain, fallback = root_of(folder / "x.glb"), root_of(folder / "fallback.glb")
    means = decode_leaves(folder / "x y.evogs").means
    (accessor,) = plain["accessors"]
    assert accessor["count"] == 40
    assert (np.array(accessor["min"]) <= means.min(0)).all()
    assert (np.array(accessor["max"]) >= means.max(0)).all()
    low = decode_leaves(folder / "x y.evogs", level=0)
    assert {one["count"] for one in fallback["accessors"]} == {len(low)}
    del fallback["meshes"][0]["primitives"][0]["extensions"][KHR]["extensions"]
    text = json.dumps(fallback).encode()
    data = (folder / "fallback.glb").read_bytes()
    rest = data[20 + struct.unpack_from("<I", data, 12)[0] :]
    text += b" " * (-len(text) % 4)
    head = struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    (folder / "unknown.glb").write_bytes(b"glTF" + head + text + rest)
    found = read_scene(folder / "unknown.glb").splats  # as a reader that knows no streams
    np.testing.assert_array_equal(found.means, low.means)


def test_any_prefix_of_a_glb_has_a_prefix_of_its_stream_last(folder, tmp_path):
    whole, data = (folder / "x.glb").read_bytes(), (folder / "x y.evogs").read_bytes()
    start = whole.index(data)
    for size in (start, start + 1, start + 300, start + len(data) - 1):
        (tmp_path / "cut.glb").write_bytes(whole[:size])
        assert read_gltf_stream(tmp_path / "cut.glb") == data[: size - start]
        with pytest.raises(InputError, match="cut short"):
            read_scene(tmp_path / "cut.glb")
    for size in (4, 19, 20, start - 9):
        (tmp_path / "cut.glb").write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"cut short|damaged"):
            read_gltf_stream(tmp_path / "cut.glb")


def test_a_file_beside_that_is_cut_short_has_a_prefix_too(folder, tmp_path):
    data = (folder / "x y.evogs").read_bytes()
    (tmp_path / "x y.evogs").write_bytes(data[:700])
    (tmp_path / "x.gltf").write_bytes((folder / "x.gltf").read_bytes())
    assert read_gltf_stream(tmp_path / "x.gltf") == data[:700]
    with pytest.raises(InputError, match="cut short: 700 of"):
        read_scene(tmp_path / "x.gltf")


def test_what_cannot_be_written_is_refused(folder, tmp_path):
    data = (folder / "x y.evogs").read_bytes()
    (tmp_path / "sub").mkdir()
    cases = {
        "get all of it first": ("x.glb", data[:-1]),
        "give its path": ("x.gltf", data),
        "below its own folder": ("x.gltf", folder / "x y.evogs"),
        "at least one splat": ("x.glb", encode_scene(odd_scene(4).take(slice(0, 0)))),
    }
    for said, (name, given) in cases.items():
        with pytest.raises(InputError, match=said):
            write_gltf_stream(tmp_path / name, given)
        assert not (tmp_path / name).exists()


# --- hostile files --------------------------------------------------------------------------------


def written(folder, root, payload):
    """A `.gltf` of this JSON, whose last buffer is a file of these bytes."""
    (folder / "x.bin").write_bytes(payload)
    root["buffers"][-1]["uri"] = "x.bin"
    (folder / "y.gltf").write_text(json.dumps(root))
    return folder / "y.gltf"


def test_what_is_said_of_a_stream_is_not_believed(folder, tmp_path):
    data = (folder / "x y.evogs").read_bytes()
    cases = [
        ("has version 2, only 1", ("version", 2)),
        ("has version True", ("version", True)),
        ("has version None", ("version", None)),
        ("no number 5", ("bufferView", 5)),
        ("no number -1", ("bufferView", -1)),
        ("no number True", ("bufferView", True)),
        ("no number ", ("bufferView", {"a": 1})),
    ]
    for said, (key, value) in cases:
        root = root_of(folder / "x.gltf")
        inside = root["meshes"][0]["primitives"][0]["extensions"][KHR]["extensions"]
        inside[EXTENSION][key] = value
        path = written(tmp_path, root, data)
        assert said in refusal(path)
        with pytest.raises(InputError):
            read_gltf_stream(path)
    for said, (place, key, value) in {  # type: ignore[assignment]
        "ends after the end of its buffer": ("bufferViews", "byteLength", len(data) + 1),
        "are compressed": ("bufferViews", "extensions", {"EXT_meshopt_compression": {}}),
        "its stream: E_": ("bufferViews", "byteLength", len(data) - 1),
        "cut short": ("buffers", "byteLength", 1 << 39),
    }.items():
        root = root_of(folder / "x.gltf")
        root[place][0][key] = value
        if said == "cut short":
            root["bufferViews"][0]["byteLength"] = 1 << 39
        assert said in refusal(written(tmp_path, root, data)), said
    root = root_of(folder / "x.gltf")
    root["meshes"][0]["primitives"][0]["extensions"][KHR]["extensions"][EXTENSION] = "x"
    assert "has version None" in refusal(written(tmp_path, root, data))


def test_many_views_of_one_stream_are_decoded_once(folder, tmp_path, monkeypatch):
    data, root = (folder / "x y.evogs").read_bytes(), root_of(folder / "x.gltf")
    (primitive,) = root["meshes"][0]["primitives"]
    root["bufferViews"] *= 300
    root["meshes"][0]["primitives"] = []
    for number in range(300):
        one = json.loads(json.dumps(primitive))
        one["extensions"][KHR]["extensions"][EXTENSION]["bufferView"] = number
        root["meshes"][0]["primitives"].append(one)
    n_decoded = []

    def decoded(view, **options):
        n_decoded.append(len(view))
        return decode_leaves(view, **options)

    monkeypatch.setattr(gltf_stream, "decode_leaves", decoded)
    assert len(read_scene(written(tmp_path, root, data)).splats) == 300 * 40
    assert n_decoded == [len(data)]


def test_streams_that_overlap_are_refused(folder, tmp_path):
    data, root = (folder / "x y.evogs").read_bytes(), root_of(folder / "x.gltf")
    root["buffers"][0]["byteLength"] = n_bytes = 200 * len(data)
    root["bufferViews"][0]["byteLength"] = n_bytes
    (primitive,) = root["meshes"][0]["primitives"]
    second = json.loads(json.dumps(primitive))
    second["extensions"][KHR]["extensions"][EXTENSION]["bufferView"] = 1
    root["bufferViews"].append({"buffer": 0, "byteOffset": 0, "byteLength": len(data)})
    root["meshes"][0]["primitives"] = [second, primitive]
    path = written(tmp_path, root, data + bytes(n_bytes - len(data)))
    assert "take more bytes than it has" in refusal(path)


@pytest.mark.thorough
def test_one_stream_at_many_nodes_is_refused_before_memory_is_full(folder, tmp_path):
    root = root_of(folder / "x.gltf")
    root["nodes"] = [{"mesh": 0}] * 9000
    root["scenes"] = [{"nodes": list(range(9000))}]
    root["meshes"][0]["primitives"] *= 20
    path = written(tmp_path, root, (folder / "x y.evogs").read_bytes())
    assert "more than 50 times" in refusal(path, peak=300 << 20)


def test_a_stream_that_says_it_has_very_many_splats_is_refused(folder, monkeypatch):
    monkeypatch.setattr(gltf_stream, "FREE", 100)
    monkeypatch.setattr(gltf_stream, "MAX_RATIO", 0.1)
    assert "say that they hold 3,680" in refusal(folder / "x.glb")


def test_a_file_with_two_streams_is_a_scene_of_both(folder, tmp_path):
    root = root_of(folder / "x.gltf")
    other = stream(n=10)
    data = (folder / "x y.evogs").read_bytes()
    root["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": len(other)})
    second = json.loads(json.dumps(root["meshes"][0]["primitives"][0]))
    second["extensions"][KHR]["extensions"][EXTENSION]["bufferView"] = 1
    root["meshes"][0]["primitives"].append(second)
    root["buffers"][0]["byteLength"] = len(data) + len(other)
    path = written(tmp_path, root, data + other)
    assert read_gltf_stream(path) is None
    found = read_scene(path)
    assert len(found.splats) == 50
    assert found.info.text == {}


@pytest.mark.parametrize("name", ["x.glb", "x.gltf"])
def test_damaged_files_are_read_or_refused_in_one_line(name, folder, tmp_path):
    whole, drawn = (folder / name).read_bytes(), random.Random(name)
    (tmp_path / "x y.evogs").write_bytes((folder / "x y.evogs").read_bytes())
    said = []
    for _ in range(150):
        change = drawn.choice([damage.flipped, damage.cut_short])
        (tmp_path / name).write_bytes(change(whole, drawn))
        try:
            read_scene(tmp_path / name)
        except InputError as error:
            said.append(str(error))
    assert len(said) > 50
    assert all(map(str.isprintable, said))


def test_files_without_a_stream_have_none(folder, tmp_path):
    (tmp_path / "x.json").write_text("{}")
    for path in (folder / "x y.evogs", tmp_path / "x.json", tmp_path):
        assert read_gltf_stream(path) is None
    info = replace(read_directory(folder / "x y.evogs").info, text={})
    assert info == SceneInfo()
