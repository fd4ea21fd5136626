"""Files of strangers: what they say of sizes is checked before anything is allocated."""

from __future__ import annotations

import zlib
from pathlib import Path

import zstandard

from evogs_codec.errors import InputError

__all__ = ["FREE", "RATIO", "check_size", "check_splats", "gunzip", "read_bytes", "unzstd", "zstd"]

# A small file may become so many bytes of splats, a larger one so many times its own. Scenes are
# compressed 2 to 20 times; what is compressed 50 times has no scene in it.
FREE = 64 << 20
RATIO = 50


def read_bytes(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def check_splats(path: Path, n: int, n_coefficients: int, n_file: int) -> None:
    """Refuse a file of `n_file` bytes that says it has `n` splats with so many SH coefficients.

    Raises:
        InputError: those are too many.
    """
    check_size(path, n * 4 * (11 + 3 * n_coefficients), n_file)


def check_size(path: Path, n_bytes: int, n_file: int) -> None:
    """Refuse a file of `n_file` bytes that says it has `n_bytes` in it.

    Raises:
        InputError: those are too many.
    """
    if n_bytes > max(FREE, RATIO * n_file):
        raise InputError(
            f"{path}: its {n_file:,} bytes say that they hold {n_bytes:,}, more than"
            f" {RATIO} times as many: refused"
        )


def gunzip(path: Path, data: bytes, n_bytes: int) -> bytes:
    """The first `n_bytes` bytes of gzip data, or all if it has fewer, with the right checksum.

    Raises:
        InputError: the data is damaged or cut short.
    """
    stream = zlib.decompressobj(wbits=31)
    try:
        found = stream.decompress(data, n_bytes)
    except zlib.error as error:
        raise InputError(f"{path}: its gzip data is damaged: {error}") from error
    if len(found) < n_bytes and not stream.eof:
        raise InputError(f"{path}: cut short: its gzip data has no end")
    return found


def unzstd(path: Path, frame: bytes | memoryview, n_bytes: int) -> bytes:
    """The `n_bytes` bytes of a Zstandard frame.

    Raises:
        InputError: the frame is damaged, or has another number of bytes.
    """
    try:
        known = zstandard.frame_content_size(frame)
        if known not in (-1, n_bytes):
            raise InputError(f"{path}: a part has {known:,} bytes, expected {n_bytes:,}")
        data = zstandard.ZstdDecompressor().decompress(frame, max_output_size=max(1, n_bytes))
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: its Zstandard data is damaged: {error}") from error
    if len(data) != n_bytes:
        raise InputError(f"{path}: a part has {len(data):,} bytes, expected {n_bytes:,}")
    return data


def zstd(data: bytes, level: int) -> bytes:
    """One Zstandard frame, which states its size."""
    return zstandard.ZstdCompressor(level=level).compress(data)
