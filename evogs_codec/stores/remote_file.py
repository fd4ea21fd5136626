"""A file behind a URL, read by ranges: only the bytes that are asked for are fetched, once."""

from __future__ import annotations

import errno
import mmap
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import BinaryIO

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.stores.background import apart, each_apart
from evogs_codec.stores.client import Answer, Client, RangesIgnoredError, Version, changed
from evogs_codec.stores.ranges import Range, length, merged, pieces, without
from evogs_codec.stores.urls import Url

__all__ = ["RemoteFile"]

FIRST_BYTES = 1 << 15  # bytes that are always fetched: small directories are in them
MAX_GAP = 1 << 14  # bytes between two ranges that take less time than another request
PIECE_BYTES = 8 << 20  # bytes of a request
N_REQUESTS = 8  # at a time
# Of a piece; obstore repeats requests, and the rest of a body where an ETag allows it.
MAX_TRIES = 3


class RemoteFile:
    """A file behind a URL. What is fetched of it lies in a scratch file, which `close` removes.

    The scratch file has holes where nothing was fetched. Every answer must be of the version of
    the first: a file that changes while it is read is refused.

    Attributes:
        url: where it is.
        path: the scratch file, named as the file is.
        n_fetched: bytes that came so far.
        n_requests: requests that were answered so far.

    Example:
        >>> with RemoteFile("s3://bucket/scene.evogs") as remote:   # doctest: +SKIP
        ...     directory = read_directory(remote)
        ...     splats = decode_leaves(remote, level=1, directory=directory)
        ...     print(remote.n_fetched, "of", remote.size, "bytes")
    """

    def __init__(self, url: str | Url) -> None:
        """Fetches the first bytes.

        Raises:
            InputError: the URL is none that is known, or obstore is not there.
            OSError: the file cannot be read; the error names the URL.
        """
        self.url = url if isinstance(url, Url) else Url.parse(url)
        self.n_fetched = self.n_requests = 0
        self._client = Client(self.url)
        self._have: list[Range] = []
        self._stream: Iterator[bytes] | None = None  # of a server that ignores ranges
        self._map: mmap.mmap | None = None
        self._lock = Lock()
        folder = Path(tempfile.mkdtemp(prefix="evogs-"))
        self.path = folder / self.url.name
        self._file = self.path.open("w+b", buffering=0)
        self._close = weakref.finalize(self, _remove, self._file, folder)
        try:
            in_order = apart(self._begin)
            self._make_room()
        except BaseException:
            self.close()
            raise
        if in_order:
            said = f"{self.url}: the server ignores ranges: the file is read from its first byte on"
            warnings.warn(said, stacklevel=2)

    def __enter__(self) -> RemoteFile:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _: BaseException | None, _at: TracebackType | None
    ) -> None:
        self.close()

    def __str__(self) -> str:
        return str(self.url)

    def __repr__(self) -> str:
        return f"RemoteFile({str(self.url)!r}, {self.n_fetched} of {self.size} bytes fetched)"

    @property
    def size(self) -> int:
        """Bytes of the whole file."""
        return self._version.size

    def close(self) -> None:
        """Remove the scratch file. Views that `having` returned stay as they are."""
        self._stream = None
        self._close()

    def having(self, ranges: Iterable[Range], progress: Progress = no_progress) -> memoryview:
        """The whole file as one view, of which these bytes are there; others may be zeros.

        Args:
            ranges: (begin, end) in bytes; what is beyond the end of the file counts for nothing.
            progress: called with the stage "fetch" and the part of the bytes that have come.

        Raises:
            OSError: they cannot be read, or the scratch file cannot hold them.
        """
        wanted = merged(((max(begin, 0), min(end, self.size)) for begin, end in ranges), MAX_GAP)
        missing = without(wanted, self._have)
        if missing and self._stream is not None:
            apart(partial(self._read_on, missing[-1][1], progress))
        elif missing:
            self._fetch(missing, progress)
        if self._map is None and self.size:
            self._map = mmap.mmap(self._file.fileno(), self.size, access=mmap.ACCESS_READ)
        return memoryview(self._map or b"")

    def whole(self, progress: Progress = no_progress) -> Path:
        """The scratch file, after all of it has come; it is there until `close`.

        Raises:
            OSError: as `having`.
        """
        self.having([(0, self.size)], progress)
        return self.path

    # --- requests ---------------------------------------------------------------------------------

    def _begin(self) -> bool:
        """Get the version of the file, and first bytes with it; whether ranges are ignored."""
        try:
            answer = self._client.get(0, FIRST_BYTES)
        except RangesIgnoredError:
            self._version = self._begin_stream()
            return True
        except OSError as error:
            if "416" not in (error.strerror or ""):
                raise
            self._version = self._client.get_whole().version  # an empty file has no range
            return False
        self._version, first = answer.version, (0, answer.end)
        self._copy_retrying(first, answer)
        self._have = [first]
        return False

    def _fetch(self, missing: list[Range], progress: Progress) -> None:
        """These ranges, some of them at a time."""
        goal, n_come = length(missing), 0
        self._check_disk(goal)
        for part in each_apart(self._fetch_piece, pieces(missing, PIECE_BYTES), N_REQUESTS):
            self._have = merged([*self._have, part])
            n_come += part[1] - part[0]
            progress("fetch", n_come / goal)

    def _fetch_piece(self, part: Range) -> Range:
        self._copy_retrying(part, self._ask(part))
        return part

    def _ask(self, part: Range) -> Answer:
        """The answer with a part of the version that is read."""
        try:
            answer = self._client.get(*part, only=self._version)
        except RangesIgnoredError:
            said = "its server sent a part before, and now sends whole files only"
            raise OSError(errno.EIO, said, str(self.url)) from None
        if answer.version != self._version:
            raise changed(self.url)
        return answer

    def _copy_retrying(self, part: Range, answer: Answer) -> None:
        """Copy an answer; ask again where it breaks off."""
        for n_left in reversed(range(MAX_TRIES)):
            try:
                self._copy(part, answer)
            except _BrokenError as broken:
                if not n_left:
                    raise broken.cause from None
                answer = self._ask(part)
            else:
                return

    def _copy(self, part: Range, answer: Answer) -> None:
        with self._lock:
            self.n_requests += 1
        at, end = part
        for piece in self._unbroken(answer.body):
            self._write(at, piece[: end - at])
            at += len(piece)
            if at >= end:
                break
        if at < end:
            said = f"{at - part[0]:,} bytes came of {end - part[0]:,} that were asked for"
            raise _BrokenError(OSError(errno.EIO, said, str(self.url)))

    # --- of a server that ignores ranges ----------------------------------------------------------

    def _begin_stream(self) -> Version:
        answer = self._client.get_whole()
        self._stream, self._have = self._unbroken(answer.body), []
        self.n_requests += 1
        return answer.version

    def _read_on(self, end: int, progress: Progress) -> None:
        """Read up to byte `end`, or a little further; from the begin again where that breaks."""
        for n_left in reversed(range(MAX_TRIES)):
            try:
                self._read_stream(end, progress)
            except _BrokenError as broken:
                if not n_left:
                    raise broken.cause from None
                if self._begin_stream() != self._version:
                    raise changed(self.url) from None
            else:
                return

    def _read_stream(self, end: int, progress: Progress) -> None:
        assert self._stream is not None
        at = self._have[0][1] if self._have else 0
        self._check_disk(end - at)
        while at < end:
            piece = next(self._stream, b"")
            if not piece or at + len(piece) > self.size:
                said = f"{at + len(piece):,} bytes came of {self.size:,}"
                raise _BrokenError(OSError(errno.EIO, said, str(self.url)))
            self._write(at, piece)
            at += len(piece)
            self._have = [(0, at)]
            progress("fetch", min(at / end, 1.0))

    # --- the scratch file -------------------------------------------------------------------------

    def _make_room(self) -> None:
        """Give the scratch file its size, as a hole."""
        try:
            self._file.truncate(self.size)
        except (OSError, OverflowError) as error:
            said = f"has {self.size:,} bytes, for which there is no scratch file: {error}"
            raise OSError(errno.EFBIG, said, str(self.url)) from error

    def _check_disk(self, n_bytes: int) -> None:
        folder = self.path.parent.parent
        free = shutil.disk_usage(folder).free
        if n_bytes > free:
            said = f"{n_bytes:,} bytes are to be fetched to {folder}, which has {free:,} free"
            raise OSError(errno.ENOSPC, said, str(self.url))

    def _write(self, at: int, piece: bytes) -> None:
        left = memoryview(piece)
        with self._lock:
            self.n_fetched += len(piece)
            self._file.seek(at)
            while left:
                left = left[self._file.write(left) :]

    def _unbroken(self, body: Iterator[bytes]) -> Iterator[bytes]:
        """The pieces of a body, whose errors are told from those of the disk."""
        try:
            yield from body
        except OSError as error:
            raise _BrokenError(error) from error


class _BrokenError(Exception):
    """An answer broke off: asking again may help."""

    def __init__(self, cause: OSError) -> None:
        super().__init__(str(cause))
        self.cause = cause


def _remove(file: BinaryIO, folder: Path) -> None:
    file.close()
    shutil.rmtree(folder, ignore_errors=True)
