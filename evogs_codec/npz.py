"""A `.npz` from a stranger: every array's type and shape are known before any is allocated."""

from __future__ import annotations

import math
import os
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import InputError
from evogs_codec.splats import F32, I64

__all__ = ["Npz"]

# Deflate expands a byte to 1032 at most; a file that claims more lies or holds overlapping entries.
MAX_EXPANSION = 1032
MAX_TEXT = 1000  # characters of a text value
# All that `zipfile` and numpy raise for damaged bytes.
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    tokenize.TokenError,
    EOFError,
    RuntimeError,
    ValueError,
)
_READ_HEADER = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


class _Entry(NamedTuple):
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]


class Npz:
    """Reads the arrays of a `.npz`, never with pickle; use it in a `with` statement.

    Every method raises `InputError`, which names the file and the key.

    Raises:
        InputError: the file cannot be read or is no `.npz`.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(f"{path}: is not a file; expected a .tree.npz")
        try:
            self._zip = zipfile.ZipFile(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
        except _BROKEN as error:
            raise InputError(f"{path}: is not a .npz or is cut short: {error}") from error
        claimed, size = sum(i.file_size for i in self._zip.infolist()), Path(path).stat().st_size
        if claimed > MAX_EXPANSION * size:
            self._zip.close()
            raise InputError(f"{path}: claims to hold {claimed} bytes in {size}; it is damaged")
        self._entries: dict[str, _Entry] = {}
        self.names = frozenset(
            name.removesuffix(".npy") for name in self._zip.namelist() if name.endswith(".npy")
        )

    def __enter__(self) -> Npz:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._zip.close()

    def error(self, key: str, detail: str) -> InputError:
        """The error that says what is wrong with `key`."""
        return InputError(f"{self._path}: {key} {detail}")

    def shape(self, key: str) -> tuple[int, ...]:
        """Shape that the entry declares, consistent with its size in the file."""
        return self._entry(key).shape

    def check_shape(self, key: str, expected: tuple[int, ...]) -> None:
        """Refuse any other shape."""
        if self.shape(key) != expected:
            raise self.error(key, f"has shape {self.shape(key)}, expected {expected}")

    def floats(self, key: str) -> F32:
        """The array as float32; what does not fit becomes infinite."""
        if self._entry(key).dtype.kind != "f":
            raise self.error(key, f"is {self._entry(key).dtype}, expected float32")
        with np.errstate(over="ignore"):
            return self._read(key).astype(np.float32)

    def integers(self, key: str, low: int, high: int) -> I64:
        """The array as int64, every value in `low`..`high`."""
        shape, dtype = self._entry(key)
        if 0 in shape:
            return np.empty(shape, np.int64)  # an empty list comes as float64
        if dtype.kind not in "iu":
            raise self.error(key, f"is {dtype}, expected integers")
        values: npt.NDArray[np.integer] = self._read(key)
        wrong = np.flatnonzero((values < low) | (values > high))
        if len(wrong):
            row = wrong[0]
            raise self.error(key, f"row {row} is {values[row]}, expected {low} to {high}")
        return values.astype(np.int64)

    def text(self, key: str) -> str:
        """A text value."""
        shape, dtype = self._entry(key)
        if dtype.kind not in "US" or math.prod(shape) != 1 or dtype.itemsize > 4 * MAX_TEXT:
            raise self.error(key, f"is {dtype} of shape {shape}, expected a short text")
        value = self._read(key).reshape(-1)[0]
        return value.decode("latin-1") if isinstance(value, bytes) else str(value)

    def _entry(self, key: str) -> _Entry:
        if key not in self.names:
            raise self.error(key, "is missing")
        if key not in self._entries:
            self._entries[key] = self._declared(key)
        return self._entries[key]

    def _declared(self, key: str) -> _Entry:
        info = self._zip.getinfo(key + ".npy")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise self.error(
                key, "is compressed in a way that numpy does not use; write it with np.savez"
            )
        try:
            with self._zip.open(info) as stream:
                shape, dtype, start = _npy_header(stream)
        except (*_BROKEN, OSError) as error:
            raise self.error(key, f"cannot be read: {_line(error)}") from error
        if dtype.hasobject:
            raise self.error(key, "holds Python objects; expected numbers")
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or start + size != info.file_size:
            raise self.error(
                key, f"has shape {shape} of {dtype}, which its {info.file_size} bytes do not hold"
            )
        return _Entry(shape, dtype)

    def _read(self, key: str) -> npt.NDArray[Any]:
        try:
            with self._zip.open(key + ".npy") as stream:
                array: npt.NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        except (*_BROKEN, OSError) as error:
            raise self.error(key, f"cannot be read: {_line(error)}") from error
        return array


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[np.generic], int]:
    """Shape, dtype and the offset of the data."""
    version = np.lib.format.read_magic(stream)
    if version not in _READ_HEADER:
        raise ValueError(f"version {version} of the .npy format")
    shape, _, dtype = _READ_HEADER[version](stream)
    return shape, dtype, stream.tell()


def _line(error: Exception) -> str:
    """The message of `error` as one line."""
    return " ".join(str(error).split())
