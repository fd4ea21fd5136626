"""Reading and writing 3DGS `.ply` files (the layout of the INRIA trainer; spec annex B).

`plyfile` reads the header and writes files. Bodies are read here: a binary one through a memory
map, an ASCII one by numpy's parser, since `plyfile` takes Python steps per row for ASCII. It reads
the body itself only where lists before the vertices hide where they begin.

Letters: N splats, K SH coefficients, P properties of a vertex.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO, TextIO, TypeAlias

import numpy as np
import numpy.typing as npt
from plyfile import PlyData, PlyElement, PlyListProperty, PlyParseError

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.files import write_atomic
from evogs_codec.io.finite import with_finite_opacities
from evogs_codec.io.foreign import hint_for_no_ply
from evogs_codec.model.splats import SplatParams, sh_degree_of

__all__ = [
    "PlyBlocks",
    "PlyHeader",
    "read_ply",
    "read_ply_header",
    "write_ply",
]

PathLike: TypeAlias = "str | os.PathLike[str]"

MAX_HEADER = 1 << 20  # bytes; real headers have 2 kB, comments of an hour's work a little more
BLOCK = 4096  # rows converted at a time, so that one block of all properties stays in cache


MEANS = ("x", "y", "z")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
LOG_SCALES = ("scale_0", "scale_1", "scale_2")
OPACITY = "opacity"
SH_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
REQUIRED = (*MEANS, *SH_DC, OPACITY, *LOG_SCALES, *QUATS)


def read_ply(path: PathLike) -> SplatParams:
    """Splats of a 3DGS `.ply`: ASCII or binary of either byte order, SH degree 0 to 3.

    Other properties and elements are ignored. Infinite opacities are made finite as by
    `finite_opacities`, and a warning says how many; other numbers that are not finite are returned
    as they are. Doubles become float32; a warning says how many splats that moves by much.

    Raises:
        InputError: the file cannot be read or is no 3DGS `.ply`.
    """
    try:
        header = _read_header(path)
        rows = _read_rows(path, header)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    splats = _splats(rows, _n_rest(path, header.names))
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
            sizes = np.exp(splats.log_scales[part].mean(axis=1))
            furthest = np.maximum.reduce(way)
            n_moved += int(np.count_nonzero(np.isfinite(furthest) & (furthest > 0.1 * sizes)))
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
            header = _read_header(path)
            n_rest = _n_rest(path, header.names)
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


def read_ply_header(path: PathLike) -> PlyHeader:
    """What a `.ply` says before its numbers.

    Raises:
        InputError: the file cannot be read or is no `.ply` with vertices.
    """
    try:
        return _read_header(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def write_ply(path: PathLike, splats: SplatParams, comments: Iterable[str] = ()) -> None:
    """Write `splats` as a binary little-endian float `.ply` in the INRIA order, without normals.

    Raises:
        OSError: the file cannot be written.
        ValueError: a comment has a line break or is not ASCII.
    """
    n = len(splats)
    n_rest = 3 * (splats.sh.shape[1] - 1)
    names = (*MEANS, *SH_DC, *_rest(n_rest), OPACITY, *LOG_SCALES, *QUATS)
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


# ---------------------------------------------------------------------------------------- header


@dataclass(frozen=True)
class PlyHeader:
    """What the header declares.

    Attributes:
        text: ASCII body.
        body: file offset of the first byte after the header.
        n_rows: vertices.
        dtype: of one vertex.
        n_before: (rows, bytes) of the elements before the vertices; bytes None where they have
            lists.
        elements: name, rows and dtype of a row of each element; dtype None where it has lists.
        comments: the comment lines, without the word.
    """

    text: bool
    body: int
    n_rows: int
    dtype: np.dtype[np.void]
    n_before: tuple[int, int | None]
    elements: tuple[tuple[str, int, np.dtype[np.void] | None], ...]
    comments: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the properties of a vertex."""
        return self.dtype.names or ()


def _read_header(path: PathLike) -> PlyHeader:
    if not Path(path).is_file() and Path(path).exists():
        raise InputError(f"{path}: is not a file; expected a 3DGS .ply")
    with Path(path).open("rb") as stream:
        start = stream.read(MAX_HEADER)
    first = re.match(rb"ply(\r\n|\n|\r)", start)
    if first is None:
        raise InputError(f"{path}: {hint_for_no_ply(start, Path(path))}")
    newline = first[1]
    end = start.find(newline + b"end_header" + newline)
    if end < 0:
        raise InputError(f"{path}: the header has no line 'end_header'; is the file cut short?")
    body = end + 2 * len(newline) + len(b"end_header")
    lines, counts, comments = [], [], []
    for line in start[:body].split(newline):
        if line.startswith((b"comment", b"obj_info")):
            comments.append(line.decode("latin-1").partition(" ")[2])
            continue  # may hold any bytes in practice, which `plyfile` refuses
        element = re.fullmatch(rb"element\s+(\S+)\s+(\d{1,18})\s*", line)
        if element:
            counts.append(int(element[2]))
            # With no rows to read, `plyfile` parses the header alone.
            lines.append(b"element %s 0" % element[1])
        elif line.startswith(b"element"):
            found = shown(line.decode("latin-1"))
            raise InputError(f"{path}: header line '{found}'; expected 'element NAME COUNT'")
        else:
            lines.append(line)
    try:
        ply = PlyData.read(BytesIO(newline.join(lines)))
    except (PlyParseError, ValueError) as error:
        raise InputError(f"{path}: the header is not that of a .ply: {shown(error)}") from error
    return _vertex_header(path, ply, counts, body, tuple(comments))


def _vertex_header(
    path: PathLike,
    ply: Any,  # noqa: ANN401 - plyfile has no types
    counts: list[int],
    body: int,
    comments: tuple[str, ...],
) -> PlyHeader:
    elements = list(ply.elements)
    if "vertex" not in ply:
        listed = shown(", ".join(element.name for element in elements) or "none")
        raise InputError(f"{path}: no element 'vertex' (elements: {listed}); expected a 3DGS .ply")
    order = ply.byte_order if not ply.text else "="
    at = [element.name for element in elements].index("vertex")
    for prop in elements[at].properties:
        if isinstance(prop, PlyListProperty):
            raise InputError(
                f"{path}: vertex property '{shown(prop.name)}' is a list; expected only numbers"
            )
    before = list(zip(elements[:at], counts[:at], strict=True))
    has_lists = any(map(_has_lists, elements[:at]))
    n_bytes = None if has_lists else sum(e.dtype("<").itemsize * n for e, n in before)
    return PlyHeader(
        text=bool(ply.text),
        body=body,
        n_rows=counts[at],
        dtype=elements[at].dtype(order),
        n_before=(sum(n for _, n in before), n_bytes),
        elements=tuple(
            (element.name, n, None if _has_lists(element) else element.dtype(order))
            for element, n in zip(elements, counts, strict=True)
        ),
        comments=comments,
    )


def _has_lists(element: Any) -> bool:  # noqa: ANN401 - plyfile has no types
    return any(isinstance(prop, PlyListProperty) for prop in element.properties)


def _n_rest(path: PathLike, names: tuple[str, ...]) -> int:
    """How many `f_rest_*` there are, once the properties are found to be those of a 3DGS."""
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise InputError(f"{path}: no vertex property {', '.join(missing)}; {_is(names, missing)}")
    n_rest = sum(name.startswith("f_rest_") for name in names)
    try:
        sh_degree_of(n_rest // 3 + 1 if n_rest % 3 == 0 else 0)
    except ValueError:
        raise InputError(
            f"{path}: {n_rest} properties f_rest_*; expected 0, 9, 24 or 45 (SH degree 0 to 3)"
        ) from None
    gaps = [name for name in _rest(n_rest) if name not in names]
    if gaps:
        raise InputError(
            f"{path}: no vertex property {gaps[0]}; expected f_rest_0 to f_rest_{n_rest - 1}"
        )
    return n_rest


def _is(names: tuple[str, ...], missing: list[str]) -> str:
    """What a `.ply` without some properties of a 3DGS may be."""
    if "packed_position" in names:
        return "this is a compressed .ply: `evogs convert` makes a plain one of it"
    if missing == ["scale_2"]:
        return "flat splats of 2DGS, which have two scales, are not read; expected a 3DGS .ply"
    if missing == list(REQUIRED[len(MEANS) :]):
        return "this is a point cloud or a mesh, without splats; expected a 3DGS .ply"
    return "expected a 3DGS .ply"


# ------------------------------------------------------------------------------------------ body


def _read_rows(path: PathLike, header: PlyHeader) -> npt.NDArray[np.void]:
    """(N,) structured, one field per property."""
    _n_rest(path, header.names)  # refuse other files before paying for their rows
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
        **{name: sh[:, 1 + i % (k - 1), i // (k - 1)] for i, name in enumerate(_rest(n_rest))},
    }
    with np.errstate(over="ignore"):  # a double beyond float32 is infinite: the caller counts it
        for start in range(0, n, BLOCK):
            block = np.asarray(rows[start : start + BLOCK])
            for name, target in targets.items():
                target[start : start + BLOCK] = block[name]
    return SplatParams(means, quats, log_scales, opacity_logits, sh)


def _rest(n_rest: int) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(n_rest))
