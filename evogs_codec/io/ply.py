"""Reading and writing 3DGS `.ply` files (the layout of the INRIA trainer; spec annex B).

`ply_header` reads what comes before the numbers. A binary body is read through a memory map, an
ASCII one by numpy's parser, since `plyfile` takes Python steps per row for ASCII. `plyfile` reads a
body only where lists before the vertices hide where they begin.

Letters: N splats, K SH coefficients, P properties of a vertex.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO, TextIO

import numpy as np
import numpy.typing as npt
from plyfile import PlyData, PlyElement, PlyParseError

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.files import write_atomic
from evogs_codec.io.finite import with_finite_opacities
from evogs_codec.io.ply_header import (
    LOG_SCALES,
    MEANS,
    OPACITY,
    QUATS,
    REQUIRED,
    SH_DC,
    PathLike,
    PlyHeader,
    expect_splats,
    read_header,
    rest_names,
)
from evogs_codec.model.splats import SplatParams, sh_degree_of

__all__ = ["PlyBlocks", "read_ply", "write_ply"]

BLOCK = 4096  # rows converted at a time, so that one block of all properties stays in cache


def read_ply(path: PathLike) -> SplatParams:
    """Splats of a 3DGS `.ply`: ASCII or binary of either byte order, SH degree 0 to 3.

    Other properties and elements are ignored. Infinite opacities are made finite as by
    `finite_opacities`, and a warning says how many; other numbers that are not finite are returned
    as they are. Doubles become float32; a warning says how many splats that moves by much.

    Raises:
        InputError: the file cannot be read or is no 3DGS `.ply`.
    """
    try:
        header = read_header(path)
        rows = _read_rows(path, header)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    splats = _splats(rows, expect_splats(path, header.names))
    _warn_of_moved(path, rows, splats)
    return with_finite_opacities(path, splats)


def _warn_of_moved(path: PathLike, rows: npt.NDArray[np.void], splats: SplatParams) -> None:
    """Say how many splats float32 moves by more than a tenth of their mean size."""
    n_moved = 0
    if rows.dtype[MEANS[0]].itemsize <= 4:
        return
    for start in range(0, len(rows), BLOCK):
        part = slice(start, start + BLOCK)
        block = np.asarray(rows[part])
        with np.errstate(invalid="ignore", over="ignore"):
            way = [np.abs(block[m] - splats.means[part, i]) for i, m in enumerate(MEANS)]
            n_moved += splats.take(part).n_moved(np.maximum.reduce(way))
    if n_moved:
        text = f"{path}: float32 moves {n_moved:,} splats by more than a tenth of their size"
        said = f"{text}: `evogs encode --workers 2` and `evogs tileset` keep double positions"
        warnings.warn(said, stacklevel=3)


@dataclass(frozen=True, eq=False)
class PlyBlocks:
    """A binary `.ply` whose rows can be read from anywhere.

    Attributes:
        rows: (N,) structured, mapped from the file.
        n_rest: properties `f_rest_*`.
        comments: as of `PlyHeader`.
    """

    rows: npt.NDArray[np.void]
    n_rest: int
    comments: tuple[str, ...]

    @staticmethod
    def of(path: PathLike) -> PlyBlocks | None:
        """Of a 3DGS `.ply`; None if it is text, or has lists before its vertices.

        Raises:
            InputError: the file cannot be read or is no 3DGS `.ply`.
        """
        try:
            header = read_header(path)
            n_rest = expect_splats(path, header.names)
            if header.text or header.n_before[1] is None:
                return None
            return PlyBlocks(_read_rows(path, header), n_rest, header.comments)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error

    @property
    def n(self) -> int:
        """N."""
        return len(self.rows)

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients, 0..3."""
        return sh_degree_of(1 + self.n_rest // 3)

    def read(self, start: int, stop: int) -> tuple[npt.NDArray[np.float64], SplatParams]:
        """(n, 3) positions, as exact as the file has them, and the splats of these rows."""
        rows = self._mapped(start, stop)
        means = np.empty((len(rows), 3))
        for axis, name in enumerate(MEANS):
            means[:, axis] = rows[name]
        return means, _splats(rows, self.n_rest)

    def _mapped(self, start: int, stop: int) -> npt.NDArray[np.void]:
        """Some rows, mapped for as long as they are used: what a mapping read counts as memory."""
        some = self.rows[start:stop]
        if not isinstance(self.rows, np.memmap) or not len(some):
            return np.asarray(some)
        at = self.rows.offset + start * self.rows.itemsize
        again = np.memmap(os.fspath(self.rows.filename or ""), some.dtype, "r", at, some.shape)
        return np.asarray(again)


def write_ply(path: PathLike, splats: SplatParams, comments: Iterable[str] = ()) -> None:
    """Write `splats` as a binary little-endian float `.ply` in the INRIA order, without normals.

    Raises:
        OSError: the file cannot be written.
        ValueError: a comment has a line break or is not ASCII.
    """
    n = len(splats)
    n_rest = 3 * (splats.sh.shape[1] - 1)
    names = (*MEANS, *SH_DC, *rest_names(n_rest), OPACITY, *LOG_SCALES, *QUATS)
    row = np.empty(1, [(name, "<f4") for name in names])
    of_all = PlyElement.describe(np.broadcast_to(row, n), "vertex")  # for the header alone
    header = PlyData([of_all], byte_order="<", comments=list(comments)).header

    def fill(stream: BinaryIO) -> None:
        stream.write(f"{header}\n".encode("ascii"))
        for at in range(0, n, BLOCK):
            stream.write(_columns(splats.take(slice(at, at + BLOCK))).data)

    write_atomic(path, fill)


def _columns(splats: SplatParams) -> npt.NDArray[np.float32]:
    """(n, properties) numbers in the order in which `write_ply` names them."""
    n_rest = 3 * (splats.sh.shape[1] - 1)
    columns = np.empty((len(splats), len(REQUIRED) + n_rest), "<f4")
    columns[:, 0:3] = splats.means
    columns[:, 3:6] = splats.sh[:, 0]
    for colour in range(3):
        columns[:, 6 + colour * n_rest // 3 :][:, : n_rest // 3] = splats.sh[:, 1:, colour]
    columns[:, -8] = splats.opacity_logits
    columns[:, -7:-4] = splats.log_scales
    columns[:, -4:] = splats.quats
    return columns


def _read_rows(path: PathLike, header: PlyHeader) -> npt.NDArray[np.void]:
    """(N,) structured, one field per property."""
    expect_splats(path, header.names)  # refuse other files before paying for their rows
    n_before, bytes_before = header.n_before
    # Check the claim before paying for it: an ASCII number takes a digit and a separator.
    size = Path(path).stat().st_size - header.body
    per_row = 2 * len(header.names) if header.text else header.dtype.itemsize
    need = header.n_rows * per_row + (-1 if header.text else bytes_before or 0)
    if need > size or n_before > size:
        raise InputError(
            f"{path}: cut short: {header.n_rows} vertices need {need} bytes, there are {size}"
        )
    if header.n_rows == 0:
        return np.empty(0, header.dtype)
    if header.text:
        with Path(path).open("rb") as stream, TextIOWrapper(stream, "latin-1") as text:
            stream.seek(header.body)
            return _parse_text(path, header, text)
    if bytes_before is not None:
        at = header.body + bytes_before
        return np.memmap(path, header.dtype, "r", at, (header.n_rows,))
    try:
        rows: npt.NDArray[np.void] = PlyData.read(os.fspath(path))["vertex"].data
    except (PlyParseError, ValueError) as error:
        raise InputError(f"{path}: the body does not fit its header: {shown(error)}") from error
    return rows


def _parse_text(path: PathLike, header: PlyHeader, text: TextIO) -> npt.NDArray[np.void]:
    n, p = header.n_rows, len(header.names)
    try:
        with warnings.catch_warnings():
            # "input contained no data" is the row count below.
            warnings.simplefilter("ignore", UserWarning)
            numbers = np.loadtxt(
                text,
                np.float64,
                comments=None,
                skiprows=header.n_before[0],
                max_rows=n,
                ndmin=2,
            )
    except ValueError as error:
        raise InputError(f"{path}: a vertex row is not {p} numbers: {shown(error)}") from error
    if len(numbers) < n:
        raise InputError(f"{path}: cut short: {len(numbers)} vertex rows, the header says {n}")
    if numbers.shape[1] != p:
        raise InputError(
            f"{path}: vertex rows have {numbers.shape[1]} numbers, the header declares {p}"
        )
    return numbers.view([(name, np.float64) for name in header.names])[:, 0]


def _splats(rows: npt.NDArray[np.void], n_rest: int) -> SplatParams:
    n, k = len(rows), 1 + n_rest // 3
    means = np.empty((n, 3), np.float32)
    quats = np.empty((n, 4), np.float32)
    log_scales = np.empty((n, 3), np.float32)
    opacity_logits = np.empty(n, np.float32)
    sh = np.empty((n, k, 3), np.float32)
    targets = {
        OPACITY: opacity_logits,
        **{name: means[:, i] for i, name in enumerate(MEANS)},
        **{name: quats[:, i] for i, name in enumerate(QUATS)},
        **{name: log_scales[:, i] for i, name in enumerate(LOG_SCALES)},
        **{name: sh[:, 0, i] for i, name in enumerate(SH_DC)},
        # Channel-major: every coefficient of red, then of green, then of blue.
        **{name: sh[:, 1 + i % (k - 1), i // (k - 1)] for i, name in enumerate(rest_names(n_rest))},
    }
    with np.errstate(over="ignore"):  # a double beyond float32 is infinite: the caller counts it
        for start in range(0, n, BLOCK):
            block = np.asarray(rows[start : start + BLOCK])
            for name, target in targets.items():
                target[start : start + BLOCK] = block[name]
    return SplatParams(means, quats, log_scales, opacity_logits, sh)
