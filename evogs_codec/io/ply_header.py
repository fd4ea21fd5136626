"""The header of a 3DGS `.ply`: what it declares, and which properties a splat has (spec annex B).

`plyfile` parses it, once lines that may hold any bytes are left out.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from plyfile import PlyData, PlyListProperty, PlyParseError

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.foreign import hint_for_no_ply
from evogs_codec.model.splats import sh_degree_of

__all__ = [
    "LOG_SCALES",
    "MEANS",
    "OPACITY",
    "QUATS",
    "REQUIRED",
    "SH_DC",
    "PathLike",
    "PlyHeader",
    "expect_splats",
    "read_header",
    "read_ply_header",
    "rest_names",
]

PathLike: TypeAlias = "str | os.PathLike[str]"

MAX_HEADER = 1 << 20  # bytes; real headers have 2 kB, comments of an hour's work a little more

MEANS = ("x", "y", "z")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
LOG_SCALES = ("scale_0", "scale_1", "scale_2")
OPACITY = "opacity"
SH_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
REQUIRED = (*MEANS, *SH_DC, OPACITY, *LOG_SCALES, *QUATS)


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


def read_ply_header(path: PathLike) -> PlyHeader:
    """What a `.ply` says before its numbers.

    Raises:
        InputError: the file cannot be read or is no `.ply` with vertices.
    """
    try:
        return read_header(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_header(path: PathLike) -> PlyHeader:
    """`read_ply_header`, whose OSError goes on as it is."""
    if not Path(path).is_file() and Path(path).exists():
        raise InputError(f"{path}: is not a file; expected a 3DGS .ply, or another scene")
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


def expect_splats(path: PathLike, names: tuple[str, ...]) -> int:
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
    gaps = [name for name in rest_names(n_rest) if name not in names]
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


def rest_names(n_rest: int) -> tuple[str, ...]:
    """Of the properties of SH above band 0."""
    return tuple(f"f_rest_{i}" for i in range(n_rest))
