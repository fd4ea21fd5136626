"""Commands on glTF files with a stream in them: they read the stream, and convert keeps it."""

import hashlib
import json
import shutil

import numpy as np
import pytest

from evogs_codec import decode_leaves, read_gltf_stream, read_scene


@pytest.fixture(scope="module")
def forms(made, tmp_path_factory):
    """A folder with a stream, and glTF files with it."""
    from evogs_codec.cli.commands import main

    folder = tmp_path_factory.mktemp("gltf")
    shutil.copy(made / "scene.evogs", folder / "scene.evogs")
    for name in ("x.glb", "x.gltf"):
        assert main(["convert", str(folder / "scene.evogs"), str(folder / name)]) == 0
    words = ["convert", str(folder / "scene.evogs"), str(folder / "f.glb"), "--fallback"]
    assert main(words) == 0
    return folder


def sha256(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("name", ["x.glb", "x.gltf", "f.glb"])
def test_a_stream_comes_out_of_gltf_with_the_same_sha_256(name, forms, evogs, tmp_path):
    code, said, _ = evogs("convert", forms / name, tmp_path / "back.evogs")
    size = (forms / "scene.evogs").stat().st_size
    assert (code, said.split(": ")[1]) == (
        0,
        f"3,000 splats, a stream of {size:,} bytes, as it was, in {size:,}\n",
    )
    assert sha256(tmp_path / "back.evogs") == sha256(forms / "scene.evogs")


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    ["x.glb", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("x.gltf", "f.glb"))],
)
def test_commands_read_the_stream(name, forms, evogs, tmp_path):
    path = forms / name
    found = json.loads(evogs("info", path, "--json")[1])
    expected = json.loads(evogs("info", forms / "scene.evogs", "--json")[1])
    assert found == expected
    assert "valid, 3,000 splats" in evogs("validate", path)[1]
    for level in (0, 4):
        assert evogs("decode", path, tmp_path / "y.ply", "--level", level)[0] == 0
        own = decode_leaves(forms / "scene.evogs", level=level)
        np.testing.assert_array_equal(read_scene(tmp_path / "y.ply").splats.means, own.means)
    words = ["--level", 1]
    for source in (path, forms / "scene.evogs"):
        assert evogs("extract", source, tmp_path / f"{source.name}.evogs", *words)[0] == 0
    assert sha256(tmp_path / f"{name}.evogs") == sha256(tmp_path / "scene.evogs.evogs")
    code, said, _ = evogs("render", path, tmp_path / "y.png", "--level", 1, "--size", 8)
    n_splats = len(decode_leaves(forms / "scene.evogs", level=1))
    assert (code, f"{n_splats:,} splats" in said) == (0, True)
    assert evogs("compare", forms / "scene.evogs", path, "--size", 8)[0] == 0
    code, _, _ = evogs("encode", path, tmp_path / "z.evogs", "--preset", "scene", "--levels", 2)
    assert code == 0


def test_a_cut_glb_shows_what_is_there(forms, evogs, refused, tmp_path):
    data = (forms / "x.glb").read_bytes()
    (tmp_path / "cut.glb").write_bytes(data[: len(data) // 2])
    code, said, _ = evogs("decode", tmp_path / "cut.glb", tmp_path / "y.ply", "--partial")
    assert code == 0
    assert ", from " in said
    assert "truncated" in evogs("info", tmp_path / "cut.glb")[1]
    refused("decode", tmp_path / "cut.glb", tmp_path / "y.ply", words=["--partial takes"])
    refused("convert", tmp_path / "cut.glb", tmp_path / "y.evogs", words=["cut short"])
    assert not (tmp_path / "y.evogs").exists()
    (tmp_path / "cut.evogs").write_bytes((forms / "scene.evogs").read_bytes()[:9000])
    refused("convert", tmp_path / "cut.evogs", tmp_path / "y.glb", words=["get all of it first"])


def test_a_stream_in_gltf_becomes_any_other_format(forms, evogs, tmp_path):
    for ending in ("ply", "glb"):
        assert evogs("convert", forms / "x.glb", tmp_path / f"y.{ending}")[0] == 0
        assert len(read_scene(tmp_path / f"y.{ending}").splats) == 3000
    assert read_gltf_stream(tmp_path / "y.glb") is None  # plain attributes, for all readers


def test_what_convert_cannot_write_is_refused(forms, made, refused, tmp_path):
    ply = made / "scene.ply"
    refused("convert", ply, tmp_path / "x.gltf", words=["scenes are written as"])
    refused("convert", ply, tmp_path / "x.evogs", words=["`evogs encode` makes a stream"])
    refused("convert", ply, tmp_path / "x.glb", "--fallback", words=["--fallback: only a stream"])
    refused("convert", forms / "scene.evogs", tmp_path / "x.gltf", words=["below its own folder"])
    refused("convert", forms / "scene.evogs", tmp_path / "x.evogs", words=["evogs encode"])
    refused("convert", forms / "x.gltf", forms / "x.gltf", words=["is an input"])


def test_a_gltf_of_others_is_replaced_with_force_alone(forms, evogs, refused):
    theirs = forms / "theirs.gltf"
    theirs.write_text('{"asset":{"version":"2.0"}}')
    words = ["convert", forms / "scene.evogs", theirs]
    refused(*words, words=["was not made by `evogs convert`"])
    assert evogs(*words, "--force")[0] == 0
    assert evogs(*words)[0] == 0


def test_a_page_of_a_stream_in_gltf_has_its_bytes(forms, evogs, tmp_path):
    from evogs_codec.cli.viewer.given import stream_of

    name, data = stream_of(forms / "x.glb")
    assert (name, data) == ("x.evogs", (forms / "scene.evogs").read_bytes())
