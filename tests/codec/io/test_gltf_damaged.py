"""Damaged and hostile glTF files: one line each, and memory in proportion to the file."""

import json
import warnings

import pytest

from evogs_codec import write_scene
from tests.support.odd_scenes import odd_scene
from tests.support.scene_files import glb_of, gltf_of, refusal, with_words

pytestmark = pytest.mark.filterwarnings("ignore:.*(infinite opacity|no SH above|band 4)")


@pytest.fixture(scope="module")
def glb(tmp_path_factory):
    """The bytes of an undamaged file."""
    path = tmp_path_factory.mktemp("whole") / "x.glb"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_scene(path, odd_scene(20, 1))
    return path.read_bytes()


def test_gltf_files_that_are_not_what_they_say_are_refused(glb, tmp_path):
    path = tmp_path / "x.gltf"

    def root(change):
        made = gltf_of(glb)
        change(made)
        return made

    def sets(*place):
        *keys, last, value = place

        def change(made):
            for key in keys:
                made = made[key]
            made[last] = value

        return root(change)

    primitive = ("meshes", 0, "primitives", 0)
    khr = "KHR_gaussian_splatting"
    two_fold = {"nodes": [{"children": [0, 0]}]}
    cases = {
        "no number 7 in 'meshes'": sets("nodes", 0, "mesh", 7),
        "no number 999 in 'accessors'": sets(*primitive, "attributes", "POSITION", 999),
        "kernel": sets(*primitive, "extensions", khr, "kernel", "\x1b]0;x"),
        "is it a mesh": sets(*primitive, "extensions", {}),
        "no attribute POSITION": sets(*primitive, "attributes", {}),
        "compressed (KHR_x)": root(lambda made: (
            made["meshes"][0]["primitives"][0].update(attributes={}),
            made["meshes"][0]["primitives"][0]["extensions"][khr].update(extensions={"KHR_x": {}}),
        )),
        "is not VEC3": sets("accessors", 0, "type", "VEC2"),
        "of a known type": sets("accessors", 0, "componentType", "float"),
        "VEC3 of a known type": sets("accessors", 0, "componentType", []),
        "ends after": sets("accessors", 0, "count", 10**11),
        "number of bytes or splats": sets("accessors", 0, "count", -1),
        "'count' is no": sets("accessors", 0, "count", 1e300),
        "is sparse": sets("accessors", 0, "sparse", {}),
        "different lengths": sets("accessors", 0, "count", 19),
        "after the end of its bytes": sets("bufferViews", 0, "byteOffset", 10**9),
        "end of its bytes": sets("bufferViews", 0, "byteStride", 1),
        "(EXT_meshopt)": sets("bufferViews", 0, "extensions", {"EXT_meshopt": {}}),
        "cut short: buffer 0": sets("buffers", 0, "byteLength", 10**9),
        "not a file beside it": sets("buffers", 0, "uri", "../../etc/passwd"),
        "is not a file": sets("buffers", 0, "uri", "/etc/passwd"),
        "buffer https": sets("buffers", 0, "uri", "https://example.org/x.bin"),
        "is not there": sets("buffers", 0, "uri", "absent.bin"),
        "data URI": sets("buffers", 0, "uri", "data:;base64,AAA"),
        "no uri": root(lambda made: (
            made["buffers"].append({}), made["bufferViews"][0].update(buffer=1)
        )),
        "unevenly": sets("nodes", 0, "scale", [1, 2, 1]),
        "a node is not 3 numbers": sets("nodes", 0, "scale", [1, "2", 1]),
        "is not 16 numbers": sets("nodes", 0, "matrix", [1e308] * 16),
        "no tree": root(lambda made: made.update(two_fold)),
        "nodes are no tree": sets("nodes", 0, "children", [0]),
        "'nodes' is no list": sets("nodes", 5),
        "'primitives' is no list": sets("meshes", 0, "primitives", "x"),
    }  # fmt: skip
    for said, case in cases.items():
        path.write_text(json.dumps(case))
        assert said in refusal(path), said
    for said, data in {
        "JSON is damaged": b'{"asset":' + b"[" * 100_000,
        "its JSON is": b'{"asset": \xff}',
        "is damaged": b'{"asset": 1' + b"0" * 5000 + b"}",
    }.items():
        path.write_bytes(data)
        assert said in refusal(path)


@pytest.mark.thorough
def test_one_mesh_at_many_nodes_is_refused_before_memory_is_full(glb, tmp_path):
    made = gltf_of(glb)
    made["nodes"] = [{"mesh": 0}] * 9000
    made["scenes"] = [{"nodes": list(range(9000))}]
    made["meshes"][0]["primitives"] *= 10
    (tmp_path / "x.gltf").write_text(json.dumps(made))
    assert "more than 50 times" in refusal(tmp_path / "x.gltf", 200 << 20)
    made["nodes"] *= 2
    made["meshes"][0]["primitives"] = made["meshes"][0]["primitives"][:1]
    made["scenes"] = [{"nodes": list(range(18_000))}]
    (tmp_path / "x.gltf").write_text(json.dumps(made))
    assert "over 10,000" in refusal(tmp_path / "x.gltf", 200 << 20)


def test_glbs_whose_sizes_are_not_true_are_refused(glb, tmp_path):
    path, data = tmp_path / "x.glb", glb
    cases = {
        "version 2": with_words(data, at_4=1),
        "cut short": with_words(data, at_8=1 << 31),
        "cut short: ": with_words(data, at_12=1 << 31),
        "begins with JSON": with_words(data, at_16=5),
        "JSON is damaged": with_words(data, at_12=100),
        "is no object": glb_of(b"[1, 2]  "),
        "no splats": glb_of({"asset": {"version": "2.0"}}),
    }
    for said, case in cases.items():
        path.write_bytes(case)
        assert said in refusal(path, 4 << 20)
