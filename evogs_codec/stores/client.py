"""What is asked of stores and of servers of the web, through obstore; and what they refuse.

obstore is loaded with the first URL. It has threads of its own, which a forked process loses:
processes that are started later are to be spawned.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from evogs_codec.errors import InputError
from evogs_codec.stores.background import apart
from evogs_codec.stores.urls import Url

__all__ = ["Answer", "Client", "RangesIgnoredError", "Version", "changed", "put_object"]

PART = 8 << 20  # bytes of a part of an upload
MAX_PARTS = 9000  # of an upload; S3 takes 10,000
N_PARTS = 4  # in memory at a time
PIECE = 1 << 20  # bytes of a body in memory at a time

CONNECT_TIMEOUT = timedelta(seconds=5)
READ_TIMEOUT = timedelta(seconds=30)  # without a byte
RANGE_TIMEOUT = timedelta(minutes=3)  # of a request for a range or for a part of an upload
WHOLE_TIMEOUT = timedelta(hours=12)  # of a request for a whole file
RETRIES: dict[str, Any] = {
    "max_retries": 3,
    "retry_timeout": timedelta(minutes=1),
    "backoff": {
        "init_backoff": timedelta(milliseconds=200),
        "max_backoff": timedelta(seconds=5),
        "base": 2,
    },
}

# Where credentials may be told that obstore finds without boto3.
CREDENTIALS = (
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    "AWS_SKIP_SIGNATURE",
)
# Where credentials are looked for last, and what to set where there are none.
LAST_RESORT = re.compile(r"169\.254\.169\.254|metadata\.google|session\.get_credentials")
TO_SET = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_SKIP_SIGNATURE=true",
    "gs": "GOOGLE_SERVICE_ACCOUNT to its file, or GOOGLE_SKIP_SIGNATURE=true",
}


class RangesIgnoredError(Exception):
    """The server answers with the whole file where a part was asked for."""


@dataclass(frozen=True)
class Version:
    """What tells that a file is still the same.

    Attributes:
        size: bytes of the whole file.
        tag: its ETag; None without one.
        modified: when it was last written, as the server says it.
    """

    size: int
    tag: str | None
    modified: str

    @property
    def strong_tag(self) -> str | None:
        """The ETag, if it may be a condition: a weak one matches nothing (RFC 9110, 13.1.1)."""
        return None if self.tag is None or self.tag.startswith("W/") else self.tag


@dataclass(frozen=True)
class Answer:
    """A part of a file: its version, where the part begins and ends, and its bytes in pieces."""

    version: Version
    begin: int
    end: int
    body: Iterator[bytes]


class Client:
    """Reads one file."""

    def __init__(self, url: Url) -> None:
        """Sends nothing yet.

        Raises:
            InputError: obstore is not there, or what is set for the store is wrong.
        """
        self._url = url
        self._obstore = _loaded(url)
        self._stores: dict[timedelta, Any] = {}

    def get(self, begin: int, end: int, *, only: Version | None = None) -> Answer:
        """Bytes `begin` to `end`, or up to the end of the file if that comes first.

        Args:
            begin: the first byte.
            end: behind the last byte.
            only: fail if the file has another version.

        Raises:
            OSError: they cannot be read. The body raises it too.
            RangesIgnoredError: the server sends whole files only.
        """
        options: dict[str, Any] = {"range": (begin, end)}
        if only is not None and only.strong_tag is not None:
            options["if_match"] = only.strong_tag
        return self._get(RANGE_TIMEOUT, options)

    def get_whole(self) -> Answer:
        """The file from its first byte on.

        Raises:
            OSError: it cannot be read. The body raises it too.
        """
        return self._get(WHOLE_TIMEOUT, {})

    def _get(self, timeout: timedelta, options: dict[str, Any]) -> Answer:
        with _errors(self._url, self._obstore):
            if timeout not in self._stores:
                self._stores[timeout] = _store(self._url, self._obstore, timeout)
            key = "" if not self._url.is_store else self._url.path
            result = self._obstore.get(self._stores[timeout], key, options=options)
            meta = result.meta
            version = Version(meta["size"], meta["e_tag"], str(meta["last_modified"]))
            begin, end = result.range
            return Answer(version, begin, end, self._body(result))

    def _body(self, result: Any) -> Iterator[bytes]:  # noqa: ANN401 - obstore's are not followed
        with _errors(self._url, self._obstore):
            for piece in result.stream(min_chunk_size=PIECE):
                yield bytes(piece)


def put_object(url: str | Url, source: bytes | Path) -> None:
    """Make or replace an object. It is there when it is whole; before that the old one is.

    Args:
        url: of a store.
        source: the bytes of the object, or a file that has them, of which a few parts are in
            memory at a time.

    Raises:
        InputError: the URL is not of a store, or obstore is not there.
        OSError: it cannot be written.
    """
    url = url if isinstance(url, Url) else Url.parse(url)
    if not url.is_store:
        raise InputError(f"{url}: only s3:// and gs:// can be written")
    size = len(source) if isinstance(source, bytes) else source.stat().st_size
    obstore = _loaded(url)
    with _errors(url, obstore, verb="written"):
        put = partial(
            obstore.put,
            _store(url, obstore, RANGE_TIMEOUT),
            url.path,
            source,
            use_multipart=size > 2 * PART,
            chunk_size=max(PART, -(-size // MAX_PARTS)),
            max_concurrency=N_PARTS,
        )
        apart(put)


def _loaded(url: Url) -> Any:  # noqa: ANN401 - a module whose types are not followed
    try:
        import obstore
        import obstore.exceptions
        import obstore.store
    except ImportError as error:
        raise InputError(f"{url}: URLs need obstore: pip install -e '.[stores]'") from error
    return obstore


def _store(url: Url, obstore: Any, timeout: timedelta) -> Any:  # noqa: ANN401
    """A store of obstore."""
    client = {
        "connect_timeout": CONNECT_TIMEOUT,
        "read_timeout": READ_TIMEOUT,
        "timeout": timeout,
        "user_agent": "evogs",
        "allow_http": url.scheme == "http",
    }
    both = {"client_options": client, "retry_config": RETRIES}
    if not url.is_store:
        return obstore.store.HTTPStore.from_url(url.address, **both)
    if url.scheme == "gs":
        # Where a service account names an emulator, that speaks without TLS.
        client["allow_http"] = True
        return obstore.store.GCSStore(url.host, **both)
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL", "")
    client["allow_http"] = endpoint.startswith("http://")
    config: dict[str, Any] = {"endpoint": endpoint} if endpoint else {}
    if not any(map(os.environ.get, CREDENTIALS)) and find_spec("boto3"):
        from obstore.auth.boto3 import Boto3CredentialProvider

        config["credential_provider"] = Boto3CredentialProvider()  # also of ~/.aws
    return obstore.store.S3Store(url.host, **config, **both)


@contextmanager
def _errors(url: Url, obstore: Any, verb: str = "read") -> Iterator[None]:  # noqa: ANN401
    """What obstore raises as OSErrors that name the URL.

    An argument that is wrong is a plain ValueError of obstore, as is a lack of credentials of
    boto3.
    """
    kinds = obstore.exceptions
    try:
        yield
    except (FileNotFoundError, kinds.NotFoundError) as error:
        said = "its bucket is not there" if "NoSuchBucket" in str(error) else "is not there"
        raise FileNotFoundError(errno.ENOENT, said, str(url)) from error
    except (kinds.PermissionDeniedError, kinds.UnauthenticatedError) as error:
        said = f"may not be {verb}: the credentials do not allow it"
        raise PermissionError(errno.EACCES, said, str(url)) from error
    except kinds.PreconditionError as error:
        raise changed(url) from error
    except kinds.NotSupportedError as error:
        if "RangeNotSupported" in str(error):
            raise RangesIgnoredError from error
        raise OSError(errno.EIO, _reason(url, error, verb), str(url)) from error
    except (kinds.BaseError, ValueError) as error:
        raise OSError(errno.EIO, _reason(url, error, verb), str(url)) from error


def changed(url: Url) -> OSError:
    """That a file is not what it was when reading it began."""
    return OSError(errno.EIO, "has changed while it was read: start again", str(url))


def _reason(url: Url, error: Exception, verb: str) -> str:
    """What is wrong, in one line without the address, which may have a signature in it."""
    line = str(error).partition("\n")[0].strip()
    if url.scheme in TO_SET and LAST_RESORT.search(line):
        return f"cannot be {verb}: no credentials: set {TO_SET[url.scheme]} for what is public"
    told = re.sub(r"^Generic \w+ error: ", "", line).rpartition(" - ")[2]
    told = told.removeprefix("Server returned non-2xx status code: ").partition(": <")[0]
    return f"cannot be {verb}: {told.rstrip(': ')}"
