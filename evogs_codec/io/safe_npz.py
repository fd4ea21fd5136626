"""A `.npz` from a stranger: every array's type and shape are known before any is allocated."""

from __future__ import annotations

import math
import os
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.model.splats import F32, I64

__all__ = ["Npz"]

# Deflate expands a byte to 1032 at most; a file that claims more lies or holds overlapping entries.
MAX_EXPANSION = 1032
MAX_TEXT = 1000  # characters of a text value
MAX_HEADER = 10_100  # bytes of a `.npy` header; numpy takes no more than 10,000 and a few
MAX_SIDE = 2**63 - 1
END_SIZE = 22  # bytes of the end of the directory, before a comment
MANY_ENTRIES = 0xFFFF  # the number is somewhere else
_NUMPY_USES = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
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
        except Exception as error:  # of many kinds, as in `_reading`
            raise InputError(f"{path}: is not a .npz or is cut short: {shown(error)}") from error
        try:
            self._check_entries()
        except BaseException:
            self._zip.close()
            raise
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

    def _check_entries(self) -> None:
        """Refuse sizes that cannot be, and a directory that is not that of the entries."""
        entries, size = self._zip.infolist(), Path(self._path).stat().st_size
        claimed = sum(entry.file_size for entry in entries)
        if claimed > MAX_EXPANSION * size:
            raise InputError(
                f"{self._path}: claims to hold {claimed} bytes in {size}; it is damaged"
            )
        with Path(self._path).open("rb") as file:  # `zipfile` may skip entries without a word
            file.seek(size - END_SIZE - len(self._zip.comment))
            (n_entries,) = struct.unpack_from("<H", file.read(END_SIZE).ljust(END_SIZE), 10)
        if n_entries not in (len(entries), MANY_ENTRIES):
            raise InputError(f"{self._path}: says that it holds {n_entries} arrays, and does not")
        for entry in entries:
            if entry.compress_type in _NUMPY_USES:
                with self._reading(shown(entry.filename)), self._zip.open(entry):
                    pass  # opening compares the two names

    def error(self, key: str, detail: str) -> InputError:
        """The error that says what is wrong with `key`."""
        return InputError(f"{self._path}: {key} {detail}")

    def shape(self, key: str) -> tuple[int, ...]:
        """Shape that the entry declares, consistent with its size in the file."""
        return self._entry(key).shape

    def check_shape(self, key: str, expected: tuple[int, ...]) -> None:
        """Refuse any other shape."""
        if self.shape(key) != expected:
            raise self.error(key, f"has shape {shown(self.shape(key))}, expected {expected}")

    def floats(self, key: str) -> F32:
        """The array as float32; what does not fit becomes infinite."""
        if self._entry(key).dtype.kind != "f":
            raise self.error(key, f"is {shown(self._entry(key).dtype)}, expected float32")
        with np.errstate(over="ignore"):
            return self._read(key).astype(np.float32)

    def integers(self, key: str, low: int, high: int) -> I64:
        """The array as int64, every value in `low`..`high`."""
        shape, dtype = self._entry(key)
        if 0 in shape:
            return np.empty(shape, np.int64)  # an empty list comes as float64
        if dtype.kind not in "iu":
            raise self.error(key, f"is {shown(dtype)}, expected integers")
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
            found = f"{shown(dtype)} of shape {shown(shape)}"
            raise self.error(key, f"is {found}, expected a short text")
        array = self._read(key)
        if dtype.kind == "S":
            return array.tobytes().rstrip(b"\0").decode("latin-1")
        # Not an element of the array: of a number that is no character numpy makes a broken `str`.
        characters = array.astype(dtype.newbyteorder("<")).tobytes()
        with self._reading(key):
            return characters.decode("utf-32-le").rstrip("\0")

    def _entry(self, key: str) -> _Entry:
        if key not in self.names:
            raise self.error(key, "is missing")
        if key not in self._entries:
            self._entries[key] = self._declared(key)
        return self._entries[key]

    def _declared(self, key: str) -> _Entry:
        info = self._zip.getinfo(key + ".npy")
        if info.compress_type not in _NUMPY_USES:
            raise self.error(
                key, "is compressed in a way that numpy does not use; write it with np.savez"
            )
        with self._reading(key), self._zip.open(info) as stream:
            shape, dtype, start = _npy_header(stream.read(MAX_HEADER))
        if dtype.hasobject:
            raise self.error(key, "holds Python objects; expected numbers")
        size = math.prod(shape) * dtype.itemsize
        if start + size != info.file_size:
            found = f"shape {shown(shape)} of {shown(dtype)}"
            raise self.error(key, f"has {found}, which its {info.file_size} bytes do not hold")
        return _Entry(shape, dtype)

    def _read(self, key: str) -> npt.NDArray[Any]:
        with self._reading(key), self._zip.open(key + ".npy") as stream:
            array: npt.NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        return array

    @contextmanager
    def _reading(self, key: str) -> Iterator[None]:
        """Make an error of `key` of whatever is raised over damaged bytes.

        `zipfile` raises a dozen types, and numpy reads headers with the parser of Python and the
        constructor of dtypes, which raise anything: a list of types would never be whole. Nothing
        but calls of these two goes in here.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the parser, about what is read or refused
                yield
        except MemoryError:
            raise
        except Exception as error:
            raise self.error(key, f"cannot be read: {shown(error)}") from error


def _npy_header(start: bytes) -> tuple[tuple[int, ...], np.dtype[np.generic], int]:
    """Shape, dtype and the offset of the data."""
    stream = BytesIO(start)
    version = np.lib.format.read_magic(stream)
    if version not in _READ_HEADER:
        raise ValueError(f"version {version} of the .npy format")
    try:
        shape, _, dtype = _READ_HEADER[version](stream)
    except MemoryError as error:  # Python's parser says so of 10 kB that are nested too deeply
        raise ValueError("the header is nested too deeply") from error
    if not all(0 <= side <= MAX_SIDE for side in shape):
        raise ValueError("its shape has a side below 0 or above 2^63 - 1")
    return shape, dtype, stream.tell()
