"""Commands whose input or output is a URL, against an S3 server on this machine."""

import json
from contextlib import closing

import numpy as np
import pytest

from evogs_codec import encode_scene, read_directory, read_ply, write_ply
from evogs_codec.cli.commands import main
from evogs_codec.cli.viewer.server import Server
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.stores import client, remote_file
from tests.support.object_store import Bucket, credentials, cut_off, need_store, object_store
from tests.support.range_server import serving


@pytest.fixture(scope="module")
def address():
    """That of the store of this module."""
    need_store()
    with object_store() as address:
        yield address


@pytest.fixture
def store(address, monkeypatch):
    """The bucket, which the commands reach."""
    credentials(monkeypatch, address)
    with closing(Bucket(address)) as bucket:
        yield bucket


@pytest.fixture(scope="module")
def tiled():
    return encode_scene(
        make_scene(2000), levels=5, n_tiles=12, preset="scene", effort=1, cameras=()
    )


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """The folder of scratch files, which is to be empty in the end."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


# --- from and to a store --------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_scene_of_the_web_is_encoded_to_an_object(evogs, made, store, scratch, tmp_path):
    options = ["--preset", "scene"]
    with serving({"scene.ply": (made / "scene.ply").read_bytes()}) as site:
        source = f"{site.url}scene.ply?sig=secret"
        code, out, err = evogs("encode", source, "s3://bucket/a b/scene.evogs", *options)
    assert code == 0
    assert out.startswith("s3://bucket/a b/scene.evogs: 3,000 splats")
    assert err.startswith(f"evogs: {site.url}scene.ply: ")
    assert ": fetched " in err
    assert "secret" not in out + err
    assert evogs("encode", made / "scene.ply", tmp_path / "same.evogs", *options)[0] == 0
    assert store["a b/scene.evogs"] == (tmp_path / "same.evogs").read_bytes()
    code, out, err = evogs("decode", "s3://bucket/a b/scene.evogs", tmp_path / "same.ply")
    assert (code, len(read_ply(tmp_path / "same.ply"))) == (0, 3000)


def test_a_region_of_an_object_is_decoded_by_its_ranges(
    evogs, store, scratch, tiled, tmp_path, monkeypatch
):
    monkeypatch.setattr(remote_file, "MAX_GAP", 0)
    store["tiled.evogs"] = tiled
    (tmp_path / "tiled.evogs").write_bytes(tiled)
    options = ["--box", -20, -20, -20, 0, 0, 20, "--level", 2]
    code, _, err = evogs("decode", "s3://bucket/tiled.evogs", tmp_path / "a.ply", *options)
    n_fetched = int(err.split(": fetched ")[1].split(" bytes")[0].replace(",", ""))
    assert (code, n_fetched < 0.6 * len(tiled)) == (0, True)
    assert evogs("decode", tmp_path / "tiled.evogs", tmp_path / "b.ply", *options)[0] == 0
    one, other = (read_ply(tmp_path / name).channels() for name in ("a.ply", "b.ply"))
    assert np.array_equal(one, other)


def test_info_of_an_object_fetches_the_directory(evogs, store, scratch, tiled):
    store["tiled.evogs"] = tiled
    code, out, err = evogs("info", "s3://bucket/tiled.evogs")
    assert (code, err) == (0, "")
    assert "fetched  32,768 bytes in 1 request;" in out
    assert "present" not in out
    code, out, _ = evogs("info", "s3://bucket/tiled.evogs", "--json")
    found = json.loads(out)
    assert (found["size"], found["bytes_present"]) == (len(tiled), len(tiled))
    assert (found["bytes_fetched"], found["requests"], found["groups"]) == (32768, 1, {})


def test_an_object_is_extracted_from_and_to_the_store(evogs, store, scratch, tiled, tmp_path):
    store["tiled.evogs"] = tiled
    (tmp_path / "tiled.evogs").write_bytes(tiled)
    code, out, err = evogs(
        "extract", "s3://bucket/tiled.evogs", "s3://bucket/s.evogs", "--level", 1
    )
    assert (code, ": fetched " in err) == (0, True)
    assert out.startswith("s3://bucket/s.evogs: 2 of 5 levels")
    assert evogs("extract", tmp_path / "tiled.evogs", tmp_path / "s.evogs", "--level", 1)[0] == 0
    assert store["s.evogs"] == (tmp_path / "s.evogs").read_bytes()
    code, out, _ = evogs("validate", "s3://bucket/s.evogs")
    assert (code, out.startswith("s3://bucket/s.evogs: valid")) == (0, True)


@pytest.mark.thorough
def test_other_formats_are_converted_in_the_store(evogs, made, store, scratch):
    store["c.ply"] = (made / "scene.ply").read_bytes()
    assert evogs("convert", "s3://bucket/c.ply", "s3://bucket/c.glb")[0] == 0
    code, out, _ = evogs("lift", "s3://bucket/c.glb", "s3://bucket/c.tree.npz")
    assert (code, out) == (0, "s3://bucket/c.tree.npz: 3,000 splats, 5 levels\n")
    code, out, _ = evogs("encode", "s3://bucket/c.tree.npz", "s3://bucket/c.evogs", "--json",
                         "--preset", "scene")  # fmt: skip
    assert (code, json.loads(out)["output"]) == (0, "s3://bucket/c.evogs")
    assert read_directory(store["c.evogs"]).size == len(store["c.evogs"])


def test_a_stream_in_gltf_is_read_in_the_store(evogs, made, store, tmp_path):
    store["g.evogs"] = (made / "scene.evogs").read_bytes()
    assert evogs("convert", "s3://bucket/g.evogs", "s3://bucket/g.glb")[0] == 0
    assert evogs("info", "s3://bucket/g.glb")[0] == 0
    assert evogs("decode", "s3://bucket/g.glb", tmp_path / "g.ply", "--level", 1)[0] == 0
    assert evogs("convert", "s3://bucket/g.glb", "s3://bucket/back.evogs")[0] == 0
    assert store["back.evogs"] == store["g.evogs"]
    code, out, err = evogs("convert", "s3://bucket/g.evogs", "s3://bucket/g.gltf")
    assert (code, out, "g.gltf" in store) == (1, "", False)
    assert "g.gltf: a .gltf names its stream by a path below its own folder" in err


@pytest.mark.thorough
def test_several_objects_are_encoded_as_one_scene(evogs, refused, store, scratch, tmp_path):
    for name, seed in (("one.ply", 1), ("two.ply", 2)):
        write_ply(tmp_path / name, make_scene(1500, seed=seed))
        store[name] = (tmp_path / name).read_bytes()
    objects = ["s3://bucket/one.ply", "s3://bucket/two.ply", "s3://bucket/both.evogs"]
    code, out, err = evogs("encode", *objects, "--engine", "serial")
    assert (code, out.splitlines()[0].split(" splats")[0]) == (0, "s3://bucket/both.evogs: 3,000")
    assert err.count(": fetched ") == 2
    files = [tmp_path / name for name in ("one.ply", "two.ply", "both.evogs")]
    assert evogs("encode", *files, "--engine", "serial")[0] == 0
    assert store["both.evogs"] == files[-1].read_bytes()
    refused("encode", *objects, "--resume", words=["--resume: needs inputs on the disk"])


def test_an_object_goes_through_standard_output(made, store, scratch, capfdbinary):
    store["p.evogs"] = (made / "scene.evogs").read_bytes()
    assert main(["decode", "s3://bucket/p.evogs", "-"]) == 0
    assert capfdbinary.readouterr().out.startswith(b"ply\n")


def test_an_object_is_viewed(evogs, store, scratch, tiled, monkeypatch):
    store["v.evogs"] = tiled
    found = {}

    def serve(server):
        found["scene"] = server.scenes.find("v.evogs").read_bytes()
        raise KeyboardInterrupt

    monkeypatch.setattr(Server, "serve_forever", serve)
    code, out, _ = evogs("view", "s3://bucket/v.evogs", "--no-browser")
    assert (code, found["scene"]) == (0, tiled)
    assert "?src=/scenes/v.evogs" in out
    code, out, _ = evogs("export-html", "s3://bucket/v.evogs", "s3://bucket/v.html")
    assert (code, out.startswith("s3://bucket/v.html: ")) == (0, True)
    assert b"<html" in store["v.html"]


# --- what is there already ------------------------------------------------------------------------


def test_an_object_is_replaced_if_the_same_command_made_it(evogs, refused, made, store, scratch):
    store["in.evogs"] = (made / "scene.evogs").read_bytes()
    decode = ["decode", "s3://bucket/in.evogs", "s3://bucket/out.ply"]
    assert evogs(*decode)[0] == 0
    first = store["out.ply"]
    assert evogs(*decode, "--level", 1)[0] == 0
    second = store["out.ply"]
    assert len(second) < len(first)
    words = ["s3://bucket/out.ply: exists and was not made by `evogs convert`", "--force"]
    refused("convert", made / "scene.ply", "s3://bucket/out.ply", words=words)
    assert store["out.ply"] == second
    assert evogs("convert", made / "scene.ply", "s3://bucket/out.ply", "--force")[0] == 0
    assert store["out.ply"] != second


def test_an_object_of_another_kind_is_not_replaced(refused, made, store, scratch):
    store["mine.evogs"] = b"a letter"
    words = ["s3://bucket/mine.evogs: exists and is no EvoGS stream"]
    refused("encode", made / "scene.ply", "s3://bucket/mine.evogs", words=words)
    assert store["mine.evogs"] == b"a letter"


def test_an_object_is_no_output_of_its_own_command(refused, store, scratch, tiled):
    store["t.evogs"] = tiled
    words = ["s3://bucket/t.evogs: is an input of the command"]
    arguments = ["extract", "s3://bucket/t.evogs", "s3://bucket/t.evogs", "--level", 1, "--force"]
    refused(*arguments, words=words)
    assert store["t.evogs"] == tiled


# --- what is refused ------------------------------------------------------------------------------


def test_what_is_not_there_or_cannot_be_written_is_one_line(refused, made, store, scratch):
    scene = made / "scene.ply"
    refused("info", "s3://bucket/gone.evogs", words=["s3://bucket/gone.evogs: is not there"])
    refused("convert", "s3://gone/a.ply", "x.ply", words=["s3://gone/a.ply: its bucket is not th"])
    refused("encode", scene, "s3://gone/a.evogs", words=["s3://gone/a.evogs: its bucket is not th"])
    refused("convert", scene, "s3://bucket/a.xyz", words=["s3://bucket/a.xyz: scenes are written"])
    words = ["https://h/a.evogs: an output is written to a file, s3:// or gs://"]
    refused("encode", scene, "https://h/a.evogs", words=words)
    refused("encode", scene.with_name("x"), "s3://bucket/a.evogs", words=["x: No such file"])
    refused("encode", scene, "s3://bucket/", words=["s3://bucket/: names no file"], code=2)


def test_an_object_of_another_kind_is_named_by_its_url(evogs, refused, made, store, scratch):
    store["k.ply"] = (made / "scene.ply").read_bytes()
    words = ["s3://bucket/k.ply: is a .ply scene", "`evogs encode s3://bucket/k.ply OUT.evogs`"]
    refused("info", "s3://bucket/k.ply", words=words)
    store["k.bin"] = b"no scene"
    code, out, err = evogs("lift", "s3://bucket/k.bin", "s3://bucket/k.tree.npz")
    assert (code, out) == (1, "")
    assert err.splitlines()[1].startswith("evogs: s3://bucket/k.bin: does not start with")


def test_without_credentials_it_is_said_what_to_set(refused, store, scratch, monkeypatch, tmp_path):
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    for name in ("AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        monkeypatch.setenv(name, str(tmp_path / "none"))
    words = ["s3://bucket/a.evogs: cannot be read: no credentials", "AWS_ACCESS_KEY_ID"]
    refused("info", "s3://bucket/a.evogs", words=words)


def test_credentials_of_a_file_are_found_by_boto3(evogs, store, tiled, monkeypatch, tmp_path):
    store["tiled.evogs"] = tiled
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    (tmp_path / "keys").write_text(
        "[default]\naws_access_key_id = test\naws_secret_access_key = test\n"
    )
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "keys"))
    assert evogs("info", "s3://bucket/tiled.evogs")[0] == 0


# --- a store that goes away -----------------------------------------------------------------------


@pytest.mark.thorough
def test_nothing_is_left_of_an_input_that_breaks_off(
    refused, store, scratch, tiled, address, monkeypatch, tmp_path
):
    store["far.evogs"] = tiled
    with cut_off(address, down=60_000) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy)
        words = ["s3://bucket/far.evogs: cannot be read"]
        refused("decode", "s3://bucket/far.evogs", tmp_path / "far.ply", words=words)
    assert not (tmp_path / "far.ply").exists()


@pytest.mark.thorough
@pytest.mark.parametrize("part", [client.PART, 1 << 15], ids=["one put", "many parts"])
@pytest.mark.parametrize("is_there", [False, True])
def test_there_is_no_half_object_where_the_store_goes_away(
    refused, made, store, scratch, address, monkeypatch, part, is_there
):
    monkeypatch.setattr(client, "PART", part)
    key = f"half-{part}-{is_there}.ply"
    if is_there:
        store[key] = b"ply\nold"
    with cut_off(address, up=200_000) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy)
        words = [f"s3://bucket/{key}: cannot be written"]
        arguments = ["decode", made / "scene.evogs", f"s3://bucket/{key}", "--force"]
        refused(*arguments, words=words)
    assert (key in store) == is_there
    if is_there:
        assert store[key] == b"ply\nold"


@pytest.mark.thorough
def test_an_object_of_many_parts_is_whole(evogs, made, store, scratch, monkeypatch):
    monkeypatch.setattr(client, "PART", 5 << 20)
    splats = make_scene(50_000)
    path = scratch.parent / "large.ply"
    write_ply(path, splats)
    assert path.stat().st_size > 2 * client.PART
    assert evogs("convert", path, "s3://bucket/large.ply")[0] == 0
    assert len(store["large.ply"]) > 2 * client.PART


# --- many files, and edits ------------------------------------------------------------------------


def test_many_files_go_to_a_folder_of_a_store_and_come_from_one(evogs, store, scratch, tmp_path):
    for name, n in (("a.ply", 20), ("b.ply", 30)):
        write_ply(tmp_path / name, make_scene(n))
    both = [tmp_path / "a.ply", tmp_path / "b.ply"]
    code, out, err = evogs("convert", *both, "--out-dir", "s3://bucket/many", "--to", "glb")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "s3://bucket/many/a.glb: 20 splats, SH degree 3",
        "s3://bucket/many/b.glb: 30 splats, SH degree 3",
        "2 of 2 written to s3://bucket/many",
    ]
    places = ["s3://bucket/many/a.glb", "s3://bucket/many/gone.glb", "s3://bucket/many/b.glb"]
    code, out, err = evogs("convert", *places, "--out-dir", tmp_path / "back")
    assert code == 1
    assert out.splitlines()[-1] == f"2 of 3 written to {tmp_path}/back, 1 failed"
    assert "gone.glb" in err
    assert len(read_ply(tmp_path / "back" / "b.ply")) == 30


@pytest.mark.thorough
def test_a_stream_of_a_store_is_moved_there(evogs, store, scratch, tiled):
    store["tiled.evogs"] = tiled
    words = ["s3://bucket/tiled.evogs", "s3://bucket/moved.evogs", "--translate", 1, 2, 3]
    code, out, _ = evogs("edit", *words)
    assert code == 0
    assert out.splitlines()[1] == "exact: origins moved by 1 2 3"
    assert len(store["moved.evogs"]) == len(tiled)
