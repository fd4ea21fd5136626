"""Names of files that are elsewhere: `s3://BUCKET/KEY`, `gs://BUCKET/KEY`, `https://HOST/PATH`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import unquote, urlsplit

from evogs_codec.errors import InputError

__all__ = ["Url", "is_url"]

STORES = ("s3", "gs")
WEB = ("https", "http")
_URL = re.compile(rf"({'|'.join(STORES + WEB)})://", re.IGNORECASE)


def is_url(text: str) -> bool:
    """Whether a text names a file that is elsewhere, not a path."""
    return _URL.match(text) is not None


@dataclass(frozen=True)
class Url:
    """Where a file is that is elsewhere.

    Attributes:
        scheme: one of `STORES` or `WEB`.
        host: the bucket, or the host with its port, and perhaps a user with a password.
        path: the key as it is written, or the path with its escapes; no slash before it.
        query: what follows `?` in an address of the web, for instance a signature.
    """

    scheme: str
    host: str
    path: str
    query: str = ""

    @staticmethod
    def parse(text: str) -> Url:
        """The URL that a text says.

        Raises:
            InputError: it is none of these schemes, or has no bucket, host or key.
        """
        if not is_url(text):
            raise InputError(f"{text}: is no URL of {', '.join(STORES + WEB)}")
        scheme, _, rest = text.partition("://")
        scheme, query = scheme.lower(), ""
        if scheme in WEB:
            try:
                parts = urlsplit(text)
                _ = parts.port
            except ValueError as error:
                raise InputError(f"{text}: is no URL: {error}") from error
            host, path, query = parts.netloc, parts.path.removeprefix("/"), parts.query
        else:  # a key may have any character, also ? and #
            host, _, path = rest.partition("/")
        url = Url(scheme, host, path, query)
        if not host or (scheme in STORES and (not path or path.endswith("/"))):
            raise InputError(f"{url}: names no file, which has the form {scheme}://{_form(scheme)}")
        return url

    def __str__(self) -> str:
        """The URL without what is secret in it: a password or a signature."""
        return f"{self.scheme}://{self.host.rpartition('@')[2]}/{self.path}"

    @property
    def address(self) -> str:
        """All of it, to be asked for and not to be shown."""
        query = f"?{self.query}" if self.query else ""
        return f"{self.scheme}://{self.host}/{self.path}{query}"

    @property
    def name(self) -> str:
        """The last part of the path, as a file on the disk may be called; never empty."""
        last = self.path.rpartition("/")[2]
        last = unquote(last) if self.scheme in WEB else last
        safe = re.sub(r'[\x00-\x1f/\\:*?"<>|\x7f]', "_", last)
        stem, dot, ending = safe.rpartition(".")
        safe = f"{stem[:60]}{dot}{ending[:20]}"  # a name of 255 bytes fits everywhere
        return safe if safe.strip(". ") else "file"

    @property
    def is_store(self) -> bool:
        """Whether it names an object of a store, which may be written."""
        return self.scheme in STORES


def _form(scheme: str) -> str:
    return "BUCKET/KEY" if scheme in STORES else "HOST/PATH"
