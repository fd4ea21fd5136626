"""The server of `evogs view`: the page, and scenes by range.

It answers GET and HEAD, for the files of the page and for scenes that `Scenes` finds. While it
listens on loopback only, it refuses requests whose Host is another machine's name: a page of a
stranger could give its own name our address.
"""

from __future__ import annotations

import html
import os
import sys
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import BinaryIO
from urllib.parse import quote, unquote, urlsplit

from evogs_codec.cli.viewer.byte_range import etag_of, part_asked
from evogs_codec.cli.viewer.scenes import Scenes

__all__ = ["LOOPBACK", "SCENE_PATH", "Server", "address_of", "page_files"]

SCENE_PATH = "/scenes/"  # alone, it is the list of all
PIECE = 1 << 16
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
TYPES = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "txt": "text/plain; charset=utf-8",
}
# Spark makes workers from text (blob:), and WebAssembly from a data: address.
POLICY = (
    "default-src 'none'; script-src 'self' blob: 'wasm-unsafe-eval'; worker-src 'self' blob:;"
    " connect-src * data: blob:; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'"
)


def page_files() -> dict[str, bytes]:
    """The files of the built page, by name. Empty if it was not built."""
    page = files("evogs_codec.cli.viewer").joinpath("page")
    if not page.is_dir():
        return {}
    return {entry.name: entry.read_bytes() for entry in page.iterdir() if entry.is_file()}


class Server(ThreadingHTTPServer):
    """Serves one page and its scenes until it is shut down."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], page: Mapping[str, bytes], scenes: Scenes) -> None:
        self.page = page
        self.scenes = scenes
        self.is_local = address[0] in LOOPBACK
        super().__init__(address, _Handler)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds the page."""
        host = str(self.server_address[0])
        if host in ("0.0.0.0", "::"):
            host = "127.0.0.1"
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server_address[1]}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Clients that go away are no error; anything else is told as usual."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    server_version = "evogs"
    sys_version = ""
    timeout = 60

    def do_GET(self) -> None:
        self._answer()

    def do_HEAD(self) -> None:
        self._answer()

    def do_OPTIONS(self) -> None:
        """Pages of other origins ask first if their request has headers of its own."""
        headers = {
            "Access-Control-Allow-Methods": "GET, HEAD",
            "Access-Control-Allow-Headers": "Range, If-Range, If-None-Match",
            "Access-Control-Max-Age": "86400",
        }
        self._send(HTTPStatus.NO_CONTENT, b"", headers | _SHARED)

    def log_message(self, *_: object) -> None:
        """Nothing is printed for each request."""

    def _answer(self) -> None:
        if not self._is_addressed():
            self._refuse(HTTPStatus.FORBIDDEN)
            return
        path = urlsplit(self.path).path
        if path == SCENE_PATH:
            self._send(
                HTTPStatus.OK, _listing(self.server.scenes.names()), {"Content-Type": TYPES["html"]}
            )
        elif path.startswith(SCENE_PATH):
            self._send_scene(unquote(path.removeprefix(SCENE_PATH)))
        else:
            self._send_page(path.removeprefix("/") or "index.html")

    def _is_addressed(self) -> bool:
        """Whether the Host of the request may be ours."""
        if not self.server.is_local:
            return True
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        return host in LOOPBACK

    def _send_page(self, name: str) -> None:
        body = self.server.page.get(name)
        if body is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        headers = {
            "Content-Type": TYPES.get(name.rpartition(".")[2], "application/octet-stream"),
            "Content-Security-Policy": POLICY,
            "Referrer-Policy": "no-referrer",
        }
        self._send(HTTPStatus.OK, body, headers)

    def _send_scene(self, name: str) -> None:
        path = self.server.scenes.find(name)
        try:
            file = None if path is None else path.open("rb")
        except OSError:
            file = None
        if file is None:
            self._refuse(HTTPStatus.NOT_FOUND, _SHARED)
            return
        with file:
            self._send_part(file)

    def _send_part(self, file: BinaryIO) -> None:
        status = os.fstat(file.fileno())
        etag = etag_of(status)
        part = part_asked(self.headers, status.st_size, etag)
        self.send_response(part.status)
        for key, value in _SHARED.items():
            self.send_header(key, value)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("ETag", etag)
        self.send_header("Cache-Control", "no-cache")
        if part.status == HTTPStatus.PARTIAL_CONTENT:
            self.send_header("Content-Range", f"bytes {part.start}-{part.end - 1}/{status.st_size}")
        if part.status == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            self.send_header("Content-Range", f"bytes */{status.st_size}")
        if part.status != HTTPStatus.NOT_MODIFIED:
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(part.end - part.start))
        self.end_headers()
        if self.command == "HEAD":
            return
        file.seek(part.start)
        left = part.end - part.start
        while left > 0:
            piece = file.read(min(PIECE, left))
            if not piece:  # the file was cut short: the client sees that bytes are missing
                self.close_connection = True
                return
            self.wfile.write(piece)
            left -= len(piece)

    def _refuse(self, status: HTTPStatus, headers: Mapping[str, str] | None = None) -> None:
        self._send(status, f"{status} {status.phrase}\n".encode(), dict(headers or {}))

    def _send(self, status: HTTPStatus, body: bytes, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-cache")
        for key, value in headers.items():
            self.send_header(key, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


# Scenes may be read by pages of other origins.
_SHARED = {
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Expose-Headers": "Content-Range, ETag, Content-Length",
    "X-Content-Type-Options": "nosniff",
}


def address_of(name: str) -> str:
    """What shows a scene, behind the address of the page."""
    return f"?src={quote(SCENE_PATH + quote(name), safe='/')}"


def _listing(names: list[str]) -> bytes:
    """A page with a link for each scene."""
    links = "".join(
        f'<li><a href="/{address_of(name)}">{html.escape(name)}</a></li>' for name in names
    )
    body = f"<ul>{links}</ul>" if names else "<p>There is no .evogs file here.</p>"
    return f'<!doctype html><meta charset="utf-8"><title>Scenes</title>{body}'.encode()
