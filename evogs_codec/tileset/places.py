"""Where the files of a tileset are: a folder, or addresses that begin alike."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import is_there
from evogs_codec.stores.remote_file import RemoteFile
from evogs_codec.stores.sources import ByteSource, source_of
from evogs_codec.stores.urls import WEB, Url

__all__ = ["Place"]

MAX_JSON = 1 << 24  # bytes of a file that is read
STRANGE = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:|/|\\")  # begins what is no relative path


class Place:
    """The files beside a `tileset.json`, by the names that tiles give them.

    Attributes:
        n_fetched: bytes that came by URL.
        n_requests: of these.
    """

    def __init__(self, root: Path | Url | RemoteFile) -> None:
        """Of the root, a folder with a `tileset.json` or that file; nothing is read yet."""
        if isinstance(root, Path) and root.is_dir():
            root = root / "tileset.json"
        self._remote = root if isinstance(root, RemoteFile) else None
        self._at: Path | Url = root.url if isinstance(root, RemoteFile) else root
        self._stack = ExitStack()
        self._opened: list[RemoteFile] = [self._remote] if self._remote else []
        self.root = self._at.name if isinstance(self._at, Path) else _last(self._at.path)

    def __enter__(self) -> Place:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __str__(self) -> str:
        return str(self._at)

    @property
    def n_fetched(self) -> int:
        """Bytes that came by URL."""
        return sum(remote.n_fetched for remote in self._opened)

    @property
    def n_requests(self) -> int:
        """Requests that were answered."""
        return sum(remote.n_requests for remote in self._opened)

    @property
    def is_remote(self) -> bool:
        """Whether files come by URL."""
        return isinstance(self._at, Url)

    def holds(self, path: Path) -> bool:
        """Whether a path, its links followed, is in the folder of the root."""
        return isinstance(self._at, Path) and self._at.resolve().parent in path.resolve().parents

    def close(self) -> None:
        """Remove what was fetched, but not what the root was given as."""
        self._stack.close()

    def named(self, uri: str, base: str) -> str:
        """The name of a file from the folder of the root.

        Args:
            uri: as a tile gives it.
            base: name of the file that the tile is in.

        Raises:
            InputError: it leads elsewhere.
        """
        path = uri.partition("#")[0].partition("?")[0]
        parts: list[str] = list(PurePosixPath(base).parent.parts)
        if not path or STRANGE.match(path):
            raise InputError(f"{self}: '{shown(uri)}' is not a file beside it")
        for part in path.split("/"):
            plain = unquote(part)  # `%2e%2e` is `..`, too
            if plain == ".." and parts:
                parts.pop()
            elif plain == ".." or "\\" in plain or "/" in plain:
                raise InputError(f"{self}: '{shown(uri)}' leads out of its folder")
            elif plain not in ("", "."):
                parts.append(part)
        return "/".join(parts)

    def text(self, name: str) -> bytes:
        """The bytes of a JSON file.

        Raises:
            InputError: it is not there, or too large.
            OSError: it cannot be read.
        """
        source = self.open(name)
        if source.size > MAX_JSON:
            raise InputError(f"{self.path_of(name)}: {source.size:,} bytes are too much of JSON")
        return bytes(source.having([(0, source.size)])[: source.size])

    def open(self, name: str) -> ByteSource:
        """What gives the bytes of a file.

        Raises:
            InputError: it is not there, or no file.
            OSError: it cannot be read.
        """
        at = self.path_of(name)
        if isinstance(at, Url):
            if self._remote is not None and name == self.root:
                return self._remote
            remote = self._stack.enter_context(RemoteFile(at))
            self._opened.append(remote)
            return remote
        if not is_there(at):
            raise InputError(f"{at}: is not there")
        if not at.stat().st_size:
            return source_of(b"")
        return source_of(np.memmap(at, np.uint8, "r").data)

    def path_of(self, name: str) -> Path | Url:
        """Where a file is."""
        if isinstance(self._at, Path):
            return self._at.parent.joinpath(*map(unquote, name.split("/")))
        folder = self._at.path.rpartition("/")[0]
        name = name if self._at.scheme in WEB else unquote(name)
        return replace(self._at, path=f"{folder}/{name}" if folder else name)


def _last(path: str) -> str:
    return path.rpartition("/")[2]
