"""PNG files of 8 or 16 bits, R G B or R G B A, not interlaced: a strict reader and a writer.

A picture is an array (H, W, 3 or 4) of uint8 or uint16. The reader holds no more than the pixels
that its caller expects; what is not such a file is a `PngError`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Pixels", "PngError", "decode_png", "encode_png"]

Pixels = npt.NDArray[np.unsignedinteger[Any]]
U8 = npt.NDArray[np.uint8]
Guess = Callable[[int, int, int], int]

SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {2: 3, 6: 4}  # colour type: channels
HEADER = ">IIBBBBB"


class PngError(ValueError):
    """The bytes are not a PNG file of the kinds that are read here."""


def encode_png(pixels: Pixels) -> bytes:
    """The file; each line has the filter that leaves the smallest sum of magnitudes."""
    height, width, channels = pixels.shape
    depth = 8 * pixels.dtype.itemsize
    kind = {3: 2, 4: 6}[channels]
    lines = pixels.astype(pixels.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    return (
        SIGNATURE
        + _chunk(b"IHDR", struct.pack(HEADER, width, height, depth, kind, 0, 0, 0))
        + _chunk(b"IDAT", zlib.compress(_filtered(lines, channels * depth // 8), 9))
        + _chunk(b"IEND", b"")
    )


def decode_png(data: bytes, *, width: int, height: int) -> Pixels:
    """The pixels of a file that must have this size.

    Raises:
        PngError: it has not, is damaged, or is of a kind that is not read here.
    """
    chunks = _chunks(data)
    name, header = next(chunks, (b"", b""))
    if name != b"IHDR" or len(header) != 13:
        raise PngError("it does not begin with IHDR")
    found_width, found_height, depth, kind, *rest = struct.unpack(HEADER, header)
    if (found_width, found_height) != (width, height):
        raise PngError(f"it has {found_width} x {found_height} pixels, not {width} x {height}")
    if depth not in (8, 16) or kind not in CHANNELS or any(rest):
        raise PngError(
            f"bit depth {depth}, colour type {kind}, methods {rest}:"
            " expected 8 or 16 bits, R G B or R G B A, not interlaced"
        )
    packed, is_over = [], False
    for name, body in chunks:
        if name == b"IDAT":
            packed.append(body)
        elif name == b"IEND":
            is_over = True
        elif not name[0] & 0x20:
            raise PngError(f"critical chunk {name!r} is not known here")
    if not is_over:
        raise PngError("it has no IEND")
    size = CHANNELS[kind] * depth // 8
    lines = _unfiltered(_inflated(b"".join(packed), height * (1 + width * size)), height, size)
    pixels = lines.reshape(height, width, -1).view(f">u{depth // 8}")
    return np.asarray(pixels, np.uint8 if depth == 8 else np.uint16)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """(name, body) of every chunk to the end of the file."""
    if data[:8] != SIGNATURE:
        raise PngError("it has not the signature of PNG")
    at = 8
    while at < len(data):
        if at + 12 > len(data):
            raise PngError("it ends within a chunk")
        n = int.from_bytes(data[at : at + 4], "big")
        name, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + n]
        crc = data[at + 8 + n : at + 12 + n]
        if len(crc) < 4 or zlib.crc32(name + body) != int.from_bytes(crc, "big"):
            raise PngError(f"chunk {name!r} is cut short or its CRC is wrong")
        yield name, body
        at += 12 + n


def _inflated(packed: bytes, size: int) -> U8:
    """Exactly `size` bytes."""
    unpacker = zlib.decompressobj()
    try:
        raw = unpacker.decompress(packed, size + 1)
    except zlib.error as error:
        raise PngError(f"its pixels do not unpack: {error}") from None
    if len(raw) != size or not unpacker.eof:
        raise PngError(f"its pixels do not unpack to {size} bytes")
    return np.frombuffer(raw, np.uint8)


def _filtered(lines: U8, size: int) -> bytes:
    """Each line after the number of its filter: none, left or above, which unpack fast."""
    padded = np.zeros((len(lines) + 1, lines.shape[1] + size), np.uint8)
    padded[1:, size:] = lines
    rests = np.stack([lines, lines - padded[1:, :-size], lines - padded[:-1, size:]])
    best = np.abs(rests.view(np.int8).astype(np.int64)).sum(2).argmin(0)
    chosen = rests[best, np.arange(len(lines))]
    return np.column_stack([best.astype(np.uint8), chosen]).tobytes()


def _unfiltered(raw: U8, height: int, size: int) -> U8:
    """The lines without their filters; `size` bytes to a pixel."""
    filters, coded = np.split(raw.reshape(height, -1), [1], 1)
    out = np.zeros((height + 1, coded.shape[1]), np.uint8)
    for y, kind in enumerate(filters[:, 0]):
        line, above = coded[y], out[y]
        if kind == 0:
            out[y + 1] = line
        elif kind == 1:
            out[y + 1] = np.cumsum(line.reshape(-1, size), axis=0, dtype=np.uint8).ravel()
        elif kind == 2:
            out[y + 1] = line + above
        elif kind in GUESSES:
            out[y + 1] = _chained(line.tolist(), above.tolist(), size, GUESSES[kind])
        else:
            raise PngError(f"filter {kind} of a line is not one of 0..4")
    return out[1:]


def _chained(line: list[int], above: list[int], size: int, guess: Guess) -> list[int]:
    """A line whose every byte was guessed from those to the left, above, and above left."""
    out = [0] * size
    for left_of, byte in enumerate(line):
        corner = above[left_of - size] if left_of >= size else 0
        out.append(byte + guess(out[left_of], above[left_of], corner) & 255)
    return out[size:]


def _average(left: int, above: int, _corner: int) -> int:
    return (left + above) // 2


def _paeth(left: int, above: int, corner: int) -> int:
    """Whichever of the three is closest to left + above - corner; the first named of equals."""
    guess = left + above - corner
    return min((left, above, corner), key=lambda other: abs(guess - other))


GUESSES = {3: _average, 4: _paeth}


def _chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
