"""glTF in the forms that other programs write: nodes, quantized attributes, several primitives."""

import base64
import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import InputError, SceneInfo, read_scene, write_scene
from evogs_codec._generated import registry
from evogs_codec.io.interchange import gltf_file
from evogs_codec.io.interchange.frames import transformed, turn
from evogs_codec.io.interchange.scene_files import size_of_scene
from evogs_codec.io.interchange.values import unit
from tests.support.odd_scenes import covariances, odd_scene, opacities, spread
from tests.support.scene_files import sog_1, zipped

KHR = "KHR_gaussian_splatting"
FROM_GLTF = turn("LUF", "RDF")


def made(folder, scene):
    """The JSON and the bytes of the `.glb` of a scene."""
    write_scene(folder / "made.glb", scene)
    data = (folder / "made.glb").read_bytes()
    n_json = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + n_json]), data[28 + n_json :]


def gltf(folder, root, payload):
    """A `.gltf` with a file of bytes beside it."""
    root["buffers"] = [{"byteLength": len(payload), "uri": "the%20bytes.bin"}]
    (folder / "the bytes.bin").write_bytes(payload)
    (folder / "x.gltf").write_text(json.dumps(root))
    return folder / "x.gltf"


def rotation_of(x, y, z, w):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def assert_same(found, expected):
    np.testing.assert_allclose(found.means, expected.means, atol=3e-5)
    np.testing.assert_allclose(covariances(found), covariances(expected), rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(found.sh, expected.sh, atol=1e-5)
    np.testing.assert_allclose(opacities(found), opacities(expected), atol=1e-6)


def test_bytes_come_from_a_file_beside_it_and_from_a_data_uri(tmp_path):
    scene = odd_scene()
    root, payload = made(tmp_path, scene)
    assert_same(read_scene(gltf(tmp_path, root, payload)).splats, scene)
    uri = "data:application/octet-stream;base64," + base64.b64encode(payload).decode()
    root["buffers"] = [{"byteLength": len(payload), "uri": uri}]
    (tmp_path / "y.gltf").write_text(json.dumps(root))
    assert_same(read_scene(tmp_path / "y.gltf").splats, scene)


def test_the_size_of_a_scene_is_that_of_all_its_files(tmp_path):
    root, payload = made(tmp_path, odd_scene())
    path = gltf(tmp_path, root, payload)
    assert size_of_scene(path) == path.stat().st_size + len(payload)
    assert size_of_scene(tmp_path / "made.glb") == (tmp_path / "made.glb").stat().st_size
    (tmp_path / "the bytes.bin").unlink()
    with pytest.raises(InputError, match="is not there"):
        size_of_scene(path)


def test_the_size_of_a_sog_is_that_of_the_files_that_it_names(tmp_path):
    files = sog_1(odd_scene())
    for name, data in {**files, "notes.txt": b"not of the scene"}.items():
        (tmp_path / name).write_bytes(data)
    whole = sum(map(len, files.values()))
    assert size_of_scene(tmp_path) == size_of_scene(tmp_path / "meta.json") == whole
    (tmp_path / "x.sog").write_bytes(zipped(files))
    assert size_of_scene(tmp_path / "x.sog") == len(zipped(files))
    (tmp_path / "quats.webp").unlink()
    with pytest.raises(InputError, match=r"names a file that is not there: .*quats\.webp"):
        size_of_scene(tmp_path)


@pytest.mark.parametrize("degree", range(4))
def test_nodes_place_turn_and_scale_their_splats(degree, tmp_path):
    scene = odd_scene(degree=degree)
    root, payload = made(tmp_path, scene)
    turned = unit(np.array([[0.3, -0.5, 0.2, 0.7]], np.float32))[0].astype(float)
    outer = np.eye(4)
    outer[:3, :3], outer[:3, 3] = 2 * rotation_of(*unit(np.array([[1.0, 2, 0, 1]]))[0]), [5, 6, 7]
    root["nodes"] = [
        {"matrix": outer.T.ravel().tolist(), "children": [1]},
        {
            "mesh": 0,
            "rotation": turned.tolist(),
            "scale": [0.5, 0.5, 0.5],
            "translation": [1, -2, 3],
        },
    ]
    inner = np.eye(4)
    inner[:3, :3], inner[:3, 3] = 0.5 * rotation_of(*turned), [1, -2, 3]
    placed = outer @ inner
    in_gltf = transformed(scene, FROM_GLTF.T)
    expected = transformed(transformed(in_gltf, placed[:3, :3], placed[:3, 3]), FROM_GLTF)
    found = read_scene(gltf(tmp_path, root, payload)).splats
    assert_same(found, expected)
    assert np.abs(found.means - scene.means).max() > 1


def test_a_quarter_turn_of_a_node_changes_positions_exactly(tmp_path):
    scene = odd_scene(degree=1)
    root, payload = made(tmp_path, scene)
    half = 0.7071067811865476
    root["nodes"] = [{"mesh": 0, "rotation": [-half, 0, 0, half]}]  # z up to y up, as many write
    x, y, z = scene.means.T * np.array([[-1], [-1], [1]])
    expected = np.stack([-x, -z, -y], axis=1)
    found = read_scene(gltf(tmp_path, root, payload)).splats.means
    np.testing.assert_array_equal(found, expected.astype(np.float32))


def test_a_node_may_scale_its_splats_down_a_lot(tmp_path):
    scene = odd_scene(degree=1)
    root, payload = made(tmp_path, scene)
    for factor in (1e-7, 1e-20):
        root["nodes"][0]["scale"] = [factor] * 3
        found = read_scene(gltf(tmp_path, root, payload)).splats
        assert np.allclose(found.means, scene.means * factor, rtol=1e-5, atol=0)
        shift = np.log(factor)
        assert np.allclose(found.log_scales, scene.log_scales + shift, rtol=0, atol=1e-4)


def test_a_file_that_many_buffers_name_is_read_once(tmp_path, monkeypatch):
    scene = odd_scene(degree=0)
    root, payload = made(tmp_path, scene)
    path = gltf(tmp_path, root, payload)
    n_buffers = len(root["bufferViews"])
    root["buffers"] *= n_buffers
    for number, view in enumerate(root["bufferViews"]):
        view["buffer"] = number
    path.write_text(json.dumps(root))
    names = []
    read = gltf_file.read_bytes  # type: ignore[attr-defined]
    monkeypatch.setattr(gltf_file, "read_bytes", lambda at: names.append(at.name) or read(at))  # type: ignore[func-returns-value]
    assert_same(read_scene(path).splats, scene)
    assert n_buffers > 1
    assert names == ["x.gltf", "the bytes.bin"]


def test_primitives_and_meshes_are_joined_and_short_sh_filled_with_zeros(tmp_path):
    scene = odd_scene(20, 2)
    root, payload = made(tmp_path, scene)
    second = json.loads(json.dumps(root["meshes"][0]))
    attributes = second["primitives"][0]["attributes"]
    second["primitives"][0]["attributes"] = {
        name: number for name, number in attributes.items() if "SH_DEGREE_2" not in name
    }
    second["primitives"].append({"mode": 0, "attributes": {"POSITION": 0}})  # points, no splats
    root["meshes"].append(second)
    root["nodes"] = [{"children": [1, 2]}, {"mesh": 0}, {"mesh": 1, "translation": [0, 0, 9]}]
    found = read_scene(gltf(tmp_path, root, payload)).splats
    assert (len(found), found.sh_degree) == (40, 2)
    assert_same(found.take(slice(0, 20)), scene)
    np.testing.assert_array_equal(found.sh[20:, :4], found.sh[:20, :4])
    assert not found.sh[20:, 4:].any()
    np.testing.assert_allclose(found.means[20:, 2], scene.means[:, 2] + 9, atol=1e-5)


def test_a_file_without_scenes_shows_the_nodes_that_no_other_has(tmp_path):
    scene = odd_scene(6, 0)
    root, payload = made(tmp_path, scene)
    del root["scenes"], root["scene"]
    root["nodes"] = [{"mesh": 0}, {"children": [0]}]
    assert_same(read_scene(gltf(tmp_path, root, payload)).splats, scene)
    del root["nodes"]
    assert_same(read_scene(gltf(tmp_path, root, payload)).splats, scene)


def with_attribute(root, payload, name, values, component, *, normalized):
    """The file with other numbers for one attribute, in rows of four bytes or more."""
    size = values.dtype.itemsize * values.shape[1]
    stride = -(-size // 4) * 4
    rows = np.zeros((len(values), stride), np.uint8)
    rows[:, :size] = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), size)
    start = len(payload) + -len(payload) % 4
    payload = payload.ljust(start, b"\0") + b"pad!" + rows.tobytes()
    root["bufferViews"].append(
        {"buffer": 0, "byteOffset": start, "byteLength": 4 + rows.size, "byteStride": stride}
    )
    accessor = {
        "bufferView": len(root["bufferViews"]) - 1,
        "byteOffset": 4,
        "componentType": component,
        "count": len(values),
        "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]],
        "normalized": normalized,
    }
    root["accessors"].append(accessor)
    primitive = root["meshes"][0]["primitives"][0]
    primitive["attributes"][f"{KHR}:{name}"] = len(root["accessors"]) - 1
    return root, payload


@pytest.mark.parametrize(("component", "dtype", "most"), [(5120, "i1", 127), (5122, "<i2", 32767)])
def test_quantized_rotations_are_read(component, dtype, most, tmp_path):
    scene = odd_scene(30, 0)
    root, payload = made(tmp_path, scene)
    xyzw = np.roll(unit(transformed(scene, FROM_GLTF.T).quats), -1, axis=1)
    stored = np.rint(xyzw * most).astype(dtype)
    changed = with_attribute(root, payload, "ROTATION", stored, component, normalized=True)
    found = read_scene(gltf(tmp_path, *changed)).splats
    assert np.abs(np.abs(unit(found.quats)) - np.abs(unit(scene.quats))).max() < 1.5 / most


@pytest.mark.parametrize(("component", "dtype", "most"), [(5121, "u1", 255), (5123, "<u2", 65535)])
def test_quantized_opacities_are_read(component, dtype, most, tmp_path):
    scene = odd_scene(30, 0)
    root, payload = made(tmp_path, scene)
    stored = np.rint(opacities(scene) * most).astype(dtype)[:, None]
    changed = with_attribute(root, payload, "OPACITY", stored, component, normalized=True)
    found = read_scene(gltf(tmp_path, *changed)).splats
    assert np.abs(opacities(found) - opacities(scene)).max() < 0.6 / most


def test_scales_of_drafts_which_are_logarithms_are_read(tmp_path):
    scene = odd_scene(30, 0)
    root, payload = made(tmp_path, scene)
    changed = with_attribute(root, payload, "SCALE", scene.log_scales, 5126, normalized=False)
    found = read_scene(gltf(tmp_path, *changed)).splats
    np.testing.assert_array_equal(found.log_scales, scene.log_scales)


def test_scales_may_be_whole_numbers(tmp_path):
    scene = odd_scene(8, 0)
    root, payload = made(tmp_path, scene)
    stored = np.rint(spread(8, 3, low=1, high=100)).astype("i1")
    changed = with_attribute(root, payload, "SCALE", stored, 5120, normalized=False)
    found = read_scene(gltf(tmp_path, *changed)).splats
    np.testing.assert_allclose(np.exp(found.log_scales), stored, rtol=1e-6)


@pytest.mark.parametrize(("space", "grey"), [("srgb", 0.2140), ("linear", 0.5), ("", 0.2140)])
def test_the_colours_of_points_are_linear(space, grey, tmp_path):
    """`COLOR_0`, for readers that draw points, is linear in glTF, and SH mostly are not."""
    scene = odd_scene(degree=0)
    scene = replace(scene, sh=np.zeros_like(scene.sh))  # 0.5 of each colour
    spaces = registry.COLOUR_SPACES
    info = SceneInfo(colour_space=spaces.index(space) if space else 0)
    write_scene(tmp_path / "x.glb", scene, info)
    data = (tmp_path / "x.glb").read_bytes()
    n_json = struct.unpack_from("<I", data, 12)[0]
    root = json.loads(data[20 : 20 + n_json])
    number = root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    view = root["bufferViews"][root["accessors"][number]["bufferView"]]
    found = np.frombuffer(data, np.uint8, view["byteLength"], 28 + n_json + view["byteOffset"])
    assert set(found.reshape(-1, 4)[:, :3].ravel()) == {round(255 * grey)}
