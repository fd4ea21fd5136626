"""PNG files, written with zlib alone: 8 bits, R G B."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.io.files import write_atomic
from evogs_codec.io.makers import SOFTWARE
from evogs_codec.render.labels import text_line

__all__ = ["bytes_of_pixels", "contact_sheet", "png_bytes", "write_png"]

Real = npt.NDArray[np.floating[Any]]
MARGIN = 4  # pixels above and below a label


def write_png(path: Path, image: Real, *, made_by: str = "") -> None:
    """Write an (H, W, 3) picture of values 0..1; others are clamped.

    `made_by` is the command that it names as its maker, in ASCII.
    """
    write_atomic(path, png_bytes(image, made_by=made_by))


def png_bytes(image: Real, *, made_by: str = "") -> bytes:
    """What `write_png` writes."""
    pixels = bytes_of_pixels(image)
    height, width, _ = pixels.shape
    # Every line begins with its filter: 2, the difference to the line above.
    lines = np.zeros((height, 1 + 3 * width), np.uint8)
    lines[:, 0] = 2
    lines[:, 1:] = pixels.reshape(height, -1)
    lines[1:, 1:] -= lines[:-1, 1:].copy()
    mark = _chunk(SOFTWARE, b"Software\0" + made_by.encode("ascii")) if made_by else b""
    return (
        b"\x89PNG\r\n\x1a\n"
        + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        + mark
        + _chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
        + _chunk(b"IEND", b"")
    )


def bytes_of_pixels(image: Real) -> npt.NDArray[np.uint8]:
    """(H, W, 3) values 0..255 of a picture of values 0..1; others are clamped."""
    if image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"picture of shape {image.shape}, expected (H, W, 3)")
    return np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def contact_sheet(
    rows: Sequence[Sequence[Real]],
    *,
    labels: Sequence[str] = (),
    gap: int = 4,
    colour: float = 1.0,
) -> Real:
    """Rows of pictures as one picture.

    Args:
        rows: pictures (H, W, 3); pixels of small ones are repeated until all are as wide as the
            widest.
        labels: a line of text above each row, or none.
        gap: pixels between pictures.
        colour: brightness of the gaps and the room that pictures leave, 0..1.
    """
    width = max(image.shape[1] for row in rows for image in row)
    n_columns = max(len(row) for row in rows)
    whole_width = n_columns * (width + gap) - gap
    strips: list[Real] = []
    for number, row in enumerate(rows):
        if labels:
            strips.append(_label(labels[number], whole_width, colour))
        large = [np.repeat(np.repeat(i, f, 0), f, 1) for i in row for f in (width // i.shape[1],)]
        height = max(image.shape[0] for image in large)
        strip = np.full((height + gap, whole_width, 3), colour, np.float32)
        for column, image in enumerate(large):
            left = column * (width + gap)
            strip[: image.shape[0], left : left + image.shape[1]] = image
        strips.append(strip)
    sheet = np.concatenate(strips)
    return sheet[: len(sheet) - gap]


def _label(text: str, width: int, colour: float) -> Real:
    """A strip with the text at its left, twice as large where there is room; cut to the width."""
    line = text_line(text, scale=2, paper=colour)
    if line.shape[1] > width:
        line = text_line(text, paper=colour)
    line = line[:, :width]
    strip = np.full((line.shape[0] + 2 * MARGIN, width, 3), colour, np.float32)
    strip[MARGIN : MARGIN + line.shape[0], : line.shape[1]] = line
    return strip
