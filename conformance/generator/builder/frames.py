"""Frames (spec 5.10, RFC 8878), of raw and run-length blocks by hand, or by libzstd."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import groupby

import zstandard

__all__ = [
    "COMPRESSED",
    "RAW",
    "RESERVED",
    "RLE",
    "Block",
    "FrameStyle",
    "compressed",
    "frame",
    "raw",
    "runs",
]

RAW, RLE, COMPRESSED, RESERVED = range(4)
MAX_BLOCK = 128 << 10
Block = tuple[int, int, bytes]  # type, Block_Size, content
FrameStyle = Callable[[bytes], bytes]


def frame(
    size: int,
    blocks: Iterable[Block],
    *,
    width: int | None = None,
    magic: bytes = b"\x28\xb5\x2f\xfd",
    descriptor: int = 0x20,
) -> bytes:
    """A frame of exactly these blocks; `width` is the bytes of Frame_Content_Size.

    `descriptor` is the Frame_Header_Descriptor without its two highest bits.
    """
    if width is None:
        width = 1 if size < 256 else 2 if size < 65536 + 256 else 4
    stated = size - 256 if width == 2 else size
    out = magic + bytes([descriptor | {1: 0, 2: 1, 4: 2, 8: 3}[width] << 6])
    out += stated.to_bytes(width, "little")
    blocks = list(blocks)
    for k, (kind, block_size, content) in enumerate(blocks):
        last = k == len(blocks) - 1
        out += (last | kind << 1 | block_size << 3).to_bytes(3, "little") + content
    return out


def raw(content: bytes, block: int = MAX_BLOCK, width: int | None = None) -> bytes:
    """A frame of raw blocks of `block` bytes."""
    pieces = [content[at : at + block] for at in range(0, len(content), block)]
    return frame(len(content), [(RAW, len(p), p) for p in pieces], width=width)


def runs(content: bytes) -> bytes:
    """A frame with a run-length block for each run."""
    blocks: list[Block] = []
    for byte, same in groupby(content):
        left = len(list(same))
        while left:
            blocks.append((RLE, min(left, MAX_BLOCK), bytes([byte])))
            left -= blocks[-1][1]
    return frame(len(content), blocks)


def compressed(level: int) -> FrameStyle:
    """Frames by libzstd at a level."""
    compressor = zstandard.ZstdCompressor(
        level=level, write_content_size=True, write_checksum=False, write_dict_id=False
    )
    return lambda content: bytes(compressor.compress(content))
