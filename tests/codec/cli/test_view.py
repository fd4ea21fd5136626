"""The command `evogs view`, from its arguments to what a browser would get."""

import re
import shutil
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from evogs_codec import encode_scene, write_ply
from evogs_codec.cli.viewer import command
from evogs_codec.cli.viewer.server import Server
from evogs_codec.format.directory import read_directory
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.render.demo_scene import make_scene
from tests.support.tilesets import small_tileset

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "spec" / "example.evogs"
NAMES = ["tileset.json", "tiles/1.json", "tiles/1-0.evogs"]
NAMES += ["secret.json", "other.evogs", "tiles/../secret.json"]


@pytest.fixture
def view(evogs, monkeypatch):
    """Runs the command; instead of serving, it asks for the scene of the address that it opens."""
    opened: list[str] = []

    def view(*arguments):
        opened.clear()
        got = {}

        def serve(server):
            got["address"] = server.server_address

            address = opened[0] if opened else server.url
            source = parse_qs(urlsplit(address).query).get("src", [""])[0]
            if source.startswith("/"):
                name = urllib.request.url2pathname(source.removeprefix("/scenes/"))
                got["scene"] = server.scenes.find(name).read_bytes()
            got["names"] = server.scenes.names()
            got["find"] = server.scenes.find
            raise KeyboardInterrupt

        monkeypatch.setattr(Server, "serve_forever", serve)
        monkeypatch.setattr("webbrowser.open", opened.append)
        code, out, err = evogs("view", *arguments)
        return code, out, err, opened[:], got

    return view


def test_a_stream_that_does_not_say_what_is_up_opens_as_its_splats_show(view, tmp_path):
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    scene = transformed(make_scene(500), turn)
    (tmp_path / "turned.evogs").write_bytes(encode_scene(scene, effort=1, cameras=()))
    _, _, _, opened, got = view(tmp_path / "turned.evogs")
    assert opened[0].endswith("?src=/scenes/turned.evogs&up=-y")
    assert got["scene"] == (tmp_path / "turned.evogs").read_bytes()


def test_a_stream_is_opened_in_the_browser(view):
    code, out, _, opened, got = view(EXAMPLE)
    assert code == 0
    assert opened == [out.splitlines()[0]]
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?src=/scenes/example\.evogs", opened[0])
    assert got["scene"] == EXAMPLE.read_bytes()


def test_of_a_tileset_its_own_files_are_served_and_no_others(view, tmp_path):
    small_tileset(tmp_path / "city", max_json=1)
    (tmp_path / "city" / "secret.json").write_text("{}")
    (tmp_path / "city" / "other.evogs").write_bytes(b"other")
    for given in (tmp_path / "city", tmp_path / "city" / "tileset.json"):
        code, _, _, opened, got = view(given)
        assert code == 0
        assert opened[0].endswith("?src=/scenes/tileset.json")
        assert got["names"] == ["tileset.json"]
        assert got["scene"] == (tmp_path / "city" / "tileset.json").read_bytes()
        found = {name: got["find"](name) is not None for name in NAMES}
        assert found == dict(zip(NAMES, [True, True, True, False, False, False], strict=True))
    (tmp_path / "bad.json").write_text("{}")
    code, _, err, opened, _ = view(tmp_path / "bad.json")
    assert (code, opened) == (1, [])
    assert "is no tileset" in err


def test_files_of_a_tileset_are_served_by_names_that_json_escapes(view, tmp_path):
    folder = tmp_path / "city"
    small_tileset(folder)
    (folder / "tiles" / "1-0.evogs").rename(folder / "tiles" / "north & east.evogs")
    text = (folder / "tileset.json").read_text()
    (folder / "tileset.json").write_text(text.replace("1-0.evogs", "north%20%26%20east.evogs"))
    code, _, _, _, got = view(folder)
    assert code == 0
    assert got["find"]("tiles/north & east.evogs").is_file()
    assert got["find"]("tiles/north%20%26%20east.evogs") is None


def test_no_browser_is_opened_if_it_is_not_wanted(view):
    code, out, _, opened, _ = view(EXAMPLE, "--no-browser")
    assert (code, opened) == (0, [])
    assert "/scenes/example.evogs" in out


def test_a_scene_is_encoded_on_the_way(view, tmp_path):
    splats = make_scene(500)
    write_ply(tmp_path / "a scene.ply", splats)
    code, out, _, opened, got = view(tmp_path / "a scene.ply")
    assert code == 0
    assert "encoded" in out
    assert read_directory(got["scene"]).n_levels == 2
    assert "a%2520scene.evogs" in opened[0]
    assert [path.name for path in tmp_path.iterdir()] == ["a scene.ply"]


@pytest.mark.thorough
def test_a_sog_that_is_unpacked_is_no_tileset(view, tmp_path):
    scan = Path(__file__).resolve().parents[1] / "io" / "peers" / "splat-transform-2.7.1-sh2.sog"
    shutil.unpack_archive(scan, tmp_path / "scan", "zip")
    for given in (tmp_path / "scan", tmp_path / "scan" / "meta.json"):
        code, _, _, opened, got = view(given, "--fast")
        assert code == 0
        assert opened[0].endswith("/scenes/scan.evogs")
        assert read_directory(got["scene"]).n_levels == 2


@pytest.mark.thorough
def test_a_tree_is_encoded_on_the_way(view, evogs, tmp_path):
    write_ply(tmp_path / "scene.ply", make_scene(300))
    assert evogs("lift", tmp_path / "scene.ply", tmp_path / "scene.tree.npz", "--levels", 3)[0] == 0
    code, _, _, opened, got = view(tmp_path / "scene.tree.npz")
    assert code == 0
    assert opened[0].endswith("/scenes/scene.evogs")
    assert read_directory(got["scene"]).n_levels == 4


def test_a_folder_is_listed_or_its_only_scene_opened(view, tmp_path):
    data = encode_scene(make_scene(200))
    (tmp_path / "one.evogs").write_bytes(data)
    assert view(tmp_path)[3][0].endswith("/?src=/scenes/one.evogs")
    (tmp_path / "two.evogs").write_bytes(data)
    _, _, _, opened, got = view(tmp_path)
    assert opened[0].endswith("/scenes/")
    assert got["names"] == ["one.evogs", "two.evogs"]


def test_an_address_is_given_to_the_page(view):
    _, _, _, opened, got = view("https://example.org/a.evogs?x=1&y=2")
    query = parse_qs(urlsplit(opened[0]).query)
    assert query == {"src": ["https://example.org/a.evogs?x=1&y=2"]}
    assert got["names"] == []


def test_only_this_machine_is_served_unless_asked(view):
    _, _, err, _, got = view(EXAMPLE)
    assert (got["address"][0], err) == ("127.0.0.1", "")
    _, _, err, opened, got = view(EXAMPLE, "--host", "0.0.0.0")
    assert got["address"][0] == "0.0.0.0"
    assert "everyone" in err
    assert opened[0].startswith("http://127.0.0.1:")


def test_what_cannot_be_shown_is_refused(refused, tmp_path):
    refused("view", tmp_path / "missing.evogs", words=["No such file"])
    refused("view", tmp_path, words=["no .evogs file"])
    (tmp_path / "text.evogs").write_text("text")
    refused("view", tmp_path / "text.evogs", words=["text.evogs"])


def test_a_port_that_is_taken_is_named_before_a_scene_is_encoded(refused, monkeypatch):
    monkeypatch.setattr(command, "_scenes", lambda *_: pytest.fail("it is encoded"))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        refused("view", EXAMPLE, "--port", port, words=[f"127.0.0.1, port {port}", "another port"])


def test_a_page_that_was_not_built_is_asked_for(refused, monkeypatch):
    monkeypatch.setattr(command, "page_files", dict)
    refused("view", EXAMPLE, words=["make web"])


def test_the_process_serves_the_page_and_the_scene():
    arguments = [
        sys.executable,
        "-m",
        "evogs_codec.cli.commands",
        "view",
        str(EXAMPLE),
        "--no-browser",
    ]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            base = address.partition("?")[0]
            with urllib.request.urlopen(base, timeout=30) as answer:
                assert b"viewer.js" in answer.read()
            asked = urllib.request.Request(
                base + "scenes/example.evogs", headers={"Range": "bytes=0-7"}
            )
            with urllib.request.urlopen(asked, timeout=30) as answer:
                assert (answer.status, answer.read()) == (206, EXAMPLE.read_bytes()[:8])
        finally:
            process.terminate()
