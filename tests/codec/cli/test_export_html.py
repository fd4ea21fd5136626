"""The command `evogs export-html`; that its page works in a browser is tested in tools/web."""

import base64
import gzip
import hashlib
import re
import shutil
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from evogs_codec import SceneInfo, encode_scene, write_ply
from evogs_codec._generated import registry
from evogs_codec.cli.viewer import command
from evogs_codec.cli.viewer.server import page_files
from evogs_codec.cli.viewer.standalone import one_page
from evogs_codec.cli.viewer.upright import shown_axis
from evogs_codec.format.directory import read_directory
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.render.demo_scene import make_scene

PEERS = Path(__file__).resolve().parents[1] / "io" / "peers"
EXAMPLE = Path(__file__).resolve().parents[3] / "spec" / "example.evogs"


@pytest.fixture
def export(evogs, tmp_path):
    """Runs the command; gives what it printed, and the page."""

    def export(scene, *words):
        target = tmp_path / "page.html"
        code, out, err = evogs("export-html", scene, target, *words)
        assert (code, err) == (0, "")
        return out, target.read_text()

    return export


class Quiet(SimpleHTTPRequestHandler):
    """Serves a folder, and prints nothing."""

    def log_message(self, *_):
        pass


@pytest.fixture
def address(tmp_path):
    """Of a server with `scene.evogs` and `text.evogs`."""
    folder = tmp_path / "served"
    folder.mkdir()
    shutil.copy(EXAMPLE, folder / "scene.evogs")
    (folder / "text.evogs").write_text("text")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder)) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def scene_of(text):
    """The name and the bytes of the scene of a page."""
    ((name, packed),) = re.findall(r'data-scene="([^"]*)">([^<]*)<', text)
    return name, base64.b64decode(packed, validate=True)


def test_a_page_holds_its_scene_and_all_modules(export):
    out, text = export(EXAMPLE)
    assert "bytes, for a stream of" in out
    assert scene_of(text) == ("example.evogs", EXAMPLE.read_bytes())
    modules = re.findall(r'data-module="([^"]*)">([^<]*)<', text)
    page = page_files()
    assert {name for name, _ in modules} == {"renderer.js", "viewer.js", "worker.js"}
    for name, packed in modules:
        assert gzip.decompress(base64.b64decode(packed)) == page[name]


def test_a_module_stands_behind_those_that_it_names(export):
    order = re.findall(r'data-module="([^"]*)"', export(EXAMPLE)[1])
    page = page_files()
    for place, name in enumerate(order):
        for later in order[place:]:
            assert f'{later}"'.encode() not in page[name]


def test_a_page_names_no_other_file_and_allows_none(export):
    _, text = export(EXAMPLE)
    assert not re.search(r'\b(src|href)="(?!data:)', text)
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)
    assert "default-src 'none'" in policy
    assert "http" not in policy
    (script,) = re.findall(r'<script type="module">(.*?)</script>', text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in policy


def test_a_page_has_the_licences_of_what_it_holds(export):
    assert "@sparkjsdev/spark 2.2.0 (MIT)" in export(EXAMPLE)[1]


def test_a_name_is_text_on_the_page():
    text = one_page(page_files(), '"><script>\udcff.evogs', b"").decode()
    assert '"><script>\udcff' not in text
    assert scene_of(text)[0] == "&quot;&gt;&lt;script&gt;?.evogs"


@pytest.mark.thorough
@pytest.mark.parametrize("form", ["file", "folder", "meta.json"])
def test_a_sog_is_encoded_in_any_form_and_its_page_has_its_name(form, export, tmp_path):
    shutil.copy(PEERS / "splat-transform-2.7.1-sh2.sog", tmp_path / "scan.sog")
    scene = tmp_path / "scan.sog"
    if form != "file":
        shutil.unpack_archive(scene, tmp_path / "scan", "zip")
        scene = tmp_path / "scan" if form == "folder" else tmp_path / "scan" / "meta.json"
    out, text = export(scene, "--fast")
    assert "encoded" in out
    assert scene_of(text)[0] == "scan.evogs"
    assert "psnr" not in read_directory(scene_of(text)[1]).info.text  # which --fast leaves out


@pytest.mark.thorough
def test_a_scene_is_encoded_first(export, tmp_path):
    write_ply(tmp_path / "scene.ply", make_scene(60))
    out, text = export(tmp_path / "scene.ply")
    name, data = scene_of(text)
    assert "encoded" in out
    assert name == "scene.evogs"
    assert read_directory(data).size == len(data)


def test_a_folder_with_one_stream_is_that_stream(export, refused, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    shutil.copy(EXAMPLE, folder / "a.evogs")
    assert scene_of(export(folder)[1]) == ("a.evogs", EXAMPLE.read_bytes())
    shutil.copy(EXAMPLE, folder / "b.evogs")
    refused("export-html", folder, tmp_path / "page.html", words=["2 .evogs files", "name one"])


def test_a_stream_of_a_server_is_read(export, refused, address, tmp_path):
    assert scene_of(export(f"{address}/scene.evogs?x=1")[1]) == (
        "scene.evogs",
        EXAMPLE.read_bytes(),
    )
    page = tmp_path / "other.html"
    refused("export-html", f"{address}/text.evogs", page, words=["no EvoGS stream"])
    refused("export-html", f"{address}/missing.evogs", page, words=["404"])


def test_what_cannot_be_shown_is_refused(refused, monkeypatch, tmp_path):
    page = tmp_path / "page.html"
    refused("export-html", tmp_path / "missing.evogs", page, words=["No such file"])
    (tmp_path / "text.evogs").write_text("text")
    refused("export-html", tmp_path / "text.evogs", page, words=["text.evogs"])
    (tmp_path / "short.evogs").write_bytes(EXAMPLE.read_bytes()[:100])
    refused("export-html", tmp_path / "short.evogs", page, words=["E_TRUNCATED"])
    stream = tmp_path / "scene.evogs"
    shutil.copy(EXAMPLE, stream)
    refused("export-html", EXAMPLE, stream, words=["is no page"])
    assert stream.read_bytes() == EXAMPLE.read_bytes()
    assert not page.exists()
    monkeypatch.setattr(command, "page_files", dict)
    refused("export-html", EXAMPLE, page, words=["make web"])


def test_a_page_replaces_a_page(export):
    assert export(EXAMPLE) == export(EXAMPLE)


@pytest.mark.thorough
def test_a_scene_is_encoded_in_the_least_time_unless_another_effort_is_asked_for(export, tmp_path):
    write_ply(tmp_path / "scene.ply", make_scene(300))
    streams = [
        scene_of(export(tmp_path / "scene.ply", *words)[1])[1]
        for words in ((), ("--fast",), ("--effort", "default"))
    ]
    assert streams[0] == streams[1]
    assert "psnr" not in read_directory(streams[0]).info.text
    assert "psnr" in read_directory(streams[2]).info.text


# --- what is up -----------------------------------------------------------------------------------

Z_TO_MINUS_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
TURNED = transformed(make_scene(500), Z_TO_MINUS_Y)


def test_a_page_of_a_stream_that_does_not_say_what_is_up_opens_as_the_splats_show(export, tmp_path):
    (tmp_path / "turned.evogs").write_bytes(encode_scene(TURNED, effort=1, cameras=()))
    assert 'data-scene="turned.evogs" data-up="-y">' in export(tmp_path / "turned.evogs")[1]


@pytest.mark.parametrize(
    "info",
    [
        SceneInfo(up_axis=registry.UP_AXES.index("+x")),
        SceneInfo(text={"camera": '{"position":[0,-2,0.5],"target":[0,0,0.25],"fov_y":45}'}),
    ],
    ids=["header", "camera"],
)
def test_what_a_stream_says_of_up_is_not_doubted(info):
    assert shown_axis(encode_scene(TURNED, effort=1, cameras=(), info=info)) is None


def test_pages_of_streams_with_z_up_or_a_fault_are_told_nothing():
    data = encode_scene(make_scene(500), effort=1, cameras=())
    assert shown_axis(data) is None
    assert shown_axis(data[:2000]) is None
    assert shown_axis(b"none") is None
