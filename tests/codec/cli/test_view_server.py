"""The server of `evogs view`: files by range, and nothing but what it is to serve."""

import http.client
import os
import socket
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest

from evogs_codec.cli.viewer.scenes import Folder, OneFile
from evogs_codec.cli.viewer.server import Server, page_files

SCENE = bytes(range(256)) * 1000
PAGE = {"index.html": b"<p>page</p>", "viewer.js": b"1"}


def connect(server):
    host, port = server.server_address[:2]
    return http.client.HTTPConnection(host, port, timeout=10)


@contextmanager
def served(scenes, host="127.0.0.1"):
    server = Server((host, 0), PAGE, scenes)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def folder(tmp_path):
    """A folder with `scene.evogs`, `sub dir/é.evogs` and `secret.txt`, and a scene beside it."""
    folder = tmp_path / "scenes"
    (folder / "sub dir").mkdir(parents=True)
    (folder / "scene.evogs").write_bytes(SCENE)
    (folder / "sub dir" / "é.evogs").write_bytes(b"other")
    (folder / "secret.txt").write_bytes(b"secret")
    (tmp_path / "outside.evogs").write_bytes(b"outside")
    return folder


@pytest.fixture
def ask(folder):
    """Asks for a path of the server of that folder."""
    with served(Folder(folder)) as server:

        def ask(path, method="GET", **headers):
            connection = connect(server)
            given = {key.replace("_", "-"): value for key, value in headers.items()}
            connection.request(method, path, headers=given)
            answer = connection.getresponse()
            body = answer.read()
            connection.close()
            return answer.status, dict(answer.getheaders()), body

        yield ask


def test_the_whole_file_and_its_headers(ask):
    status, headers, body = ask("/scenes/scene.evogs")
    assert (status, body) == (200, SCENE)
    assert headers["Accept-Ranges"] == "bytes"
    assert headers["Access-Control-Allow-Origin"] == "*"
    assert headers["ETag"].startswith('"')


@pytest.mark.parametrize(
    ("asked", "start", "end"),
    [
        ("bytes=0-9", 0, 10),
        ("bytes=100-", 100, len(SCENE)),
        ("bytes=-7", len(SCENE) - 7, len(SCENE)),
        ("bytes=70000-300000000", 70000, len(SCENE)),
        ("bytes=-999999999", 0, len(SCENE)),
        (f"bytes={len(SCENE) - 1}-{len(SCENE) - 1}", len(SCENE) - 1, len(SCENE)),
    ],
)
def test_a_range(ask, asked, start, end):
    status, headers, body = ask("/scenes/scene.evogs", Range=asked)
    assert (status, body) == (206, SCENE[start:end])
    assert headers["Content-Range"] == f"bytes {start}-{end - 1}/{len(SCENE)}"
    assert headers["Content-Length"] == str(end - start)


@pytest.mark.parametrize("asked", [f"bytes={len(SCENE)}-", "bytes=999999999-", "bytes=-0"])
def test_a_range_behind_the_end(ask, asked):
    status, headers, body = ask("/scenes/scene.evogs", Range=asked)
    assert (status, body) == (416, b"")
    assert headers["Content-Range"] == f"bytes */{len(SCENE)}"


@pytest.mark.parametrize(
    "asked", ["bytes=5-2", "bytes=-", "bytes=a-b", "lines=1-2", "bytes=0-1,5-6"]
)
def test_what_is_no_single_range_is_answered_with_the_whole_file(ask, asked):
    assert ask("/scenes/scene.evogs", Range=asked)[::2] == (200, SCENE)


def test_a_range_of_an_old_file_is_answered_with_the_new_one(ask, folder):
    tag = ask("/scenes/scene.evogs", "HEAD")[1]["ETag"]
    asked = {"Range": "bytes=0-9", "If_Range": tag}
    assert ask("/scenes/scene.evogs", **asked)[::2] == (206, SCENE[:10])
    path = folder / "scene.evogs"
    path.write_bytes(b"new" + SCENE)
    os.utime(path, ns=(1, 1))
    status, headers, body = ask("/scenes/scene.evogs", **asked)
    assert (status, body) == (200, b"new" + SCENE)
    assert headers["ETag"] != tag


def test_a_file_that_the_client_has_is_not_sent_again(ask):
    tag = ask("/scenes/scene.evogs", "HEAD")[1]["ETag"]
    for condition in (tag, f'"x", W/{tag}', "*"):
        assert ask("/scenes/scene.evogs", If_None_Match=condition)[::2] == (304, b"")
    assert ask("/scenes/scene.evogs", If_None_Match='"x"')[0] == 200


def test_head_has_the_headers_without_the_bytes(ask):
    status, headers, body = ask("/scenes/scene.evogs", "HEAD", Range="bytes=0-9")
    assert (status, headers["Content-Length"], body) == (206, "10", b"")
    assert ask("/", "HEAD")[::2] == (200, b"")


def test_pages_of_other_origins_may_ask(ask):
    status, headers, _ = ask("/scenes/scene.evogs", "OPTIONS", Origin="https://example.org")
    assert status == 204
    assert "Range" in headers["Access-Control-Allow-Headers"]


def test_the_page_its_list_and_names_with_odd_characters(ask):
    status, headers, body = ask("/")
    assert (status, body) == (200, PAGE["index.html"])
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    listing = ask("/scenes/")[2].decode()
    assert listing.count("<li>") == 2
    assert "/?src=/scenes/sub%2520dir/%25C3%25A9.evogs" in listing
    assert ask("/scenes/sub%20dir/%C3%A9.evogs")[::2] == (200, b"other")


def test_names_are_escaped_in_the_list(tmp_path):
    (tmp_path / "<script>.evogs").write_bytes(b"")
    with served(Folder(tmp_path)) as server:
        connection = connect(server)
        connection.request("GET", "/scenes/")
        assert b"<script>" not in connection.getresponse().read()
        connection.close()


@pytest.mark.parametrize(
    "path",
    [
        "/scenes/../outside.evogs",
        "/scenes/%2e%2e/outside.evogs",
        "/scenes/..%2foutside.evogs",
        "/scenes/sub%20dir/../../outside.evogs",
        "/scenes/..%5coutside.evogs",
        "/scenes//etc/passwd.evogs",
        "/scenes/%2fetc%2fpasswd.evogs",
        "/scenes/scene.evogs%00.evogs",
        "/scenes/link.evogs",
        "/scenes/secret.txt",
        "/scenes/unknown.evogs",
        "/scenes/sub%20dir",
        "/../server.py",
        "/unknown.html",
        "/scenes/" + "a" * 5000 + ".evogs",
    ],
)
def test_nothing_else_is_served(ask, folder, path):
    (folder / "link.evogs").symlink_to(folder.parent / "outside.evogs")
    status, _, body = ask(path)
    assert status == 404
    assert b"outside" not in body
    assert b"secret" not in body


def test_one_file_is_served_under_its_name_alone(tmp_path):
    (tmp_path / "a.evogs").write_bytes(b"a")
    (tmp_path / "b.evogs").write_bytes(b"b")
    scenes = OneFile(tmp_path / "a.evogs", "a.evogs")
    assert scenes.find("a.evogs") == tmp_path / "a.evogs"
    assert scenes.find("b.evogs") is None
    assert scenes.names() == ["a.evogs"]


def test_other_names_of_this_machine_are_refused(ask):
    assert ask("/scenes/scene.evogs", Host="evil.example:80")[0] == 403
    assert ask("/scenes/scene.evogs", Host="localhost:80")[0] == 200


def test_a_file_that_is_gone_is_not_found(ask, folder):
    (folder / "scene.evogs").unlink()
    assert ask("/scenes/scene.evogs")[0] == 404


def test_other_methods_are_refused(ask):
    assert ask("/scenes/scene.evogs", "PUT")[0] == 501


def test_a_client_that_goes_away_is_no_error(tmp_path, capsys):
    (tmp_path / "big.evogs").write_bytes(bytes(20_000_000))
    with served(Folder(tmp_path)) as server:
        with socket.create_connection(server.server_address[:2]) as client:
            client.sendall(b"GET /scenes/big.evogs HTTP/1.1\r\nHost: localhost\r\n\r\n")
            client.recv(100)
        connection = connect(server)
        connection.request("HEAD", "/")
        assert connection.getresponse().status == 200
        connection.close()
    assert capsys.readouterr().err == ""


def test_the_built_page_is_there_and_complete():
    page = page_files()
    assert {"index.html", "viewer.css", "viewer.js", "worker.js", "LICENSES.txt"} <= set(page)
    text = page["index.html"].decode()
    assert 'src="viewer.js"' in text
    for package in ("three", "@sparkjsdev/spark"):
        assert f"\n{package} " in page["LICENSES.txt"].decode()


SOURCES = Path(__file__).parents[3] / "tools" / "web" / "viewer" / "page"


@pytest.mark.parametrize("name", sorted(path.name for path in SOURCES.iterdir()))
def test_files_of_the_page_that_are_copied_are_those_of_tools_web(name):
    assert page_files()[name] == (SOURCES / name).read_bytes(), "`make web`, and commit the page"


def test_the_page_has_no_file_that_make_web_does_not_make():
    built = {"LICENSES.txt", "renderer.js", "viewer.js", "worker.js"}
    assert set(page_files()) == built | {path.name for path in SOURCES.iterdir()}
