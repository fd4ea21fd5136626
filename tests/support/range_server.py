"""A server of the web on this machine, good and bad: files by range, and ways to get them wrong."""

import re
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

MOST = 64 << 20  # bytes that a server sends which would never end


@dataclass
class Site:
    """What a server has and how it answers.

    Attributes:
        files: their bytes by path.
        tag: the ETag of all of them; None for none.
        manner: what is wrong with it; "good" if nothing is.
        asked: the Range header of each request, or None.
        conditions: the If-Match header of each request, or None.
        n_sent: bytes of bodies.
        n_breaks: so many bodies break off in their middle.
        n_busy: so many requests are answered with 503.
        on_silence: called where a "silent" server is asked; it answers nothing until `ended`.
        url: where the files are; it ends with a slash.
    """

    files: dict[str, bytes]
    tag: str | None = '"one"'
    manner: str = "good"
    asked: list[str | None] = field(default_factory=list)
    conditions: list[str | None] = field(default_factory=list)
    n_sent: int = 0
    n_breaks: int = 0
    n_busy: int = 0
    on_silence: Callable[[], object] = lambda: None
    ended: threading.Event = field(default_factory=threading.Event)
    url: str = ""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = 20

    @property
    def site(self) -> Site:
        assert isinstance(self.server, _Server)
        return self.server.site

    def log_message(self, *_):
        pass

    def do_GET(self):
        site = self.site
        if site.manner == "gone":
            self.close_connection = True
            return
        if site.manner == "silent":
            site.on_silence()
            site.ended.wait(20)
            return
        site.asked.append(self.headers.get("Range"))
        site.conditions.append(self.headers.get("If-Match"))
        data = site.files.get(self._name())
        if site.n_busy:
            site.n_busy -= 1
            self._say(503, b"busy")
        elif data is None:
            self._say(404, b"not here <script>")
        elif site.manner == "forbidden":
            self._say(403, b"no")
        elif self.headers.get("If-Match", site.tag) != site.tag and site.manner != "unconditional":
            self._say(412, b"")
        else:
            self._send(data)

    def _name(self):
        return unquote(self.path.partition("?")[0].removeprefix("/"))

    def do_PUT(self):
        self.site.files[self._name()] = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.send_header("ETag", '"new"')
        self.end_headers()

    def _send(self, data):
        site = self.site
        found = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        if site.manner == "no ranges" or not found:
            self._head(200, len(data))
            self._body(data)
            return
        begin, end = int(found[1]), min(int(found[2] or len(data)) + 1, len(data))
        if begin >= len(data):
            self._say(416, b"")
            return
        part, size = data[begin:end], len(data)
        if site.manner == "endless":
            self._head(206, None, f"bytes {begin}-{end - 1}/{size}")
            self._chunks()
        elif site.manner == "too long":
            self._head(206, MOST, f"bytes {begin}-{end - 1}/{size}")
            self._body(part + bytes(MOST - len(part)))
        elif site.manner == "other range":
            self._head(206, len(part), f"bytes {begin + 1}-{end}/{size}")
            self._body(part)
        elif site.manner == "too short":
            self._head(206, len(part) // 2, f"bytes {begin}-{end - 1}/{size}")
            self._body(part[: len(part) // 2])
        elif site.manner == "huge":
            self._head(206, len(part), f"bytes {begin}-{end - 1}/{1 << 62}")
            self._body(part)
        else:
            self._head(206, len(part), f"bytes {begin}-{end - 1}/{size}")
            self._body(part)

    def _head(self, status, size, content_range=None):
        self.send_response(status)
        if size is None:
            self.send_header("Transfer-Encoding", "chunked")
        else:
            self.send_header("Content-Length", str(size))
        if content_range:
            self.send_header("Content-Range", content_range)
        self.send_header("Last-Modified", "Mon, 23 Nov 2026 09:00:00 GMT")
        if self.site.tag:
            self.send_header("ETag", self.site.tag)
        self.end_headers()

    def _body(self, data):
        site = self.site
        if site.n_breaks and len(data) > 1:
            site.n_breaks -= 1
            data = data[: len(data) // 2]
            self.close_connection = True
        try:
            for at in range(0, len(data), 1 << 16):
                self.wfile.write(data[at : at + (1 << 16)])
                site.n_sent += len(data[at : at + (1 << 16)])
        except OSError:  # the client has enough
            self.close_connection = True

    def _chunks(self):
        try:
            for _ in range(MOST >> 16):
                self.wfile.write(b"10000\r\n" + bytes(1 << 16) + b"\r\n")
                self.site.n_sent += 1 << 16
        except OSError:
            pass
        self.close_connection = True

    def _say(self, status, body):
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, site: Site):
        self.site = site
        super().__init__(("127.0.0.1", 0), _Handler)

    def handle_error(self, *_):
        pass  # clients go away


@contextmanager
def serving(files, **manners):
    """A `Site` that is served; its `url` ends with a slash."""
    site = Site(dict(files), **manners)
    server = _Server(site)
    site.url = f"http://127.0.0.1:{server.server_address[1]}/"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield site
    finally:
        site.ended.set()
        site.manner = "gone"  # of connections that are open still
        server.shutdown()
        thread.join()
        server.server_close()


def wait_until(true, seconds=20):
    """Look again until it is, or the time is over."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.02)
