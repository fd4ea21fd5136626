"""Zstandard frames (spec 5.10); the only module that imports zstandard.

A frame's own headers are checked here, outside the library: libraries differ, and change, in what
they accept.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import zstandard
from zstandard import COMPRESSOBJ_FLUSH_BLOCK as FLUSH_BLOCK

from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import literals
from evogs_codec.model.splats import I64, U8

__all__ = [
    "FIRST_WEIGHING_LEVEL",
    "MAX_BLOCK",
    "MAX_CONTENT",
    "compress",
    "decompress",
    "decompress_all",
    "store",
]

MAGIC = b"\x28\xb5\x2f\xfd"
MAX_CONTENT = 16 << 20  # R-5.10-4
MAX_BLOCK = 128 << 10  # R-5.10-5
# Planes are noise that a Huffman code serves best: matches that are found in it cost more than they
# save, and most of the time. So levels that weigh matches look for few of them in larger planes.
FIRST_WEIGHING_LEVEL, LARGE_PLANE = 16, 4096  # the first such level, and bytes of a plane
MATCHES_FOUND = 0.95  # of the bytes: where a quick search takes less, there is more to be found
NARROW = {"hash_log": 6, "chain_log": 6, "search_log": 1, "min_match": 7}
MAY_COMPILE = True  # False: frames are read as without numba
_local = threading.local()


def compress(data: bytes, zstd_level: int, ends: Sequence[int] = ()) -> bytes:
    """One frame of the subset.

    Args:
        data: its content.
        zstd_level: the Zstandard level, 1..22.
        ends: where blocks may end, beside where libzstd lets them end (`blocks`).

    Raises:
        ValueError: more than `MAX_CONTENT` bytes.
    """
    frames = [store(data)]
    if zstd_level < FIRST_WEIGHING_LEVEL or len(data) < LARGE_PLANE:
        frames.append(_frame(data, zstd_level))
        if ends:
            frames.append(_frame(data, zstd_level, ends=ends))
    else:
        frames += [_frame(data, zstd_level, ends=ends, is_narrow=True), _frame(data, 1)]
        if len(frames[-1]) < MATCHES_FOUND * len(frames[-2]):
            frames.append(_frame(data, zstd_level))
    return min(frames, key=len)


def _frame(data: bytes, level: int, *, ends: Sequence[int] = (), is_narrow: bool = False) -> bytes:
    """That of libzstd at a level."""
    window_log = max(10, (len(data) - 1).bit_length())  # as large as the content: single-segment
    key = f"compressor {level} {window_log} {is_narrow}"
    compressor = getattr(_local, key, None)
    if compressor is None:
        parameters = zstandard.ZstdCompressionParameters.from_level(
            level,
            window_log=window_log,
            write_content_size=True,
            write_checksum=False,
            write_dict_id=False,
            **(NARROW if is_narrow else {}),
        )
        compressor = zstandard.ZstdCompressor(compression_params=parameters)
        setattr(_local, key, compressor)
    if not ends:
        return bytes(compressor.compress(data))
    blocks, stream = [], compressor.compressobj(size=len(data))
    for begin, end in pairwise((0, *ends)):
        blocks += [stream.compress(data[begin:end]), stream.flush(FLUSH_BLOCK)]
    return b"".join([*blocks, stream.compress(data[ends[-1] :]), stream.flush()])


def store(data: bytes) -> bytes:
    """One frame of raw blocks: used where compression must not shrink a packet (R-5.6-7).

    Raises:
        ValueError: more than `MAX_CONTENT` bytes.
    """
    size = len(data)
    if size > MAX_CONTENT:
        raise ValueError(f"{size} bytes are too many for a frame")
    if size < 256:
        head = bytes([0x20, size])
    elif size < 65536 + 256:
        head = bytes([0x60]) + (size - 256).to_bytes(2, "little")
    else:
        head = bytes([0xA0]) + size.to_bytes(4, "little")
    blocks = []
    for at in range(0, max(size, 1), MAX_BLOCK):
        block = data[at : at + MAX_BLOCK]
        last = int(at + MAX_BLOCK >= size)
        blocks.append((last | len(block) << 3).to_bytes(3, "little") + block)
    return MAGIC + head + b"".join(blocks)


def decompress(frame: memoryview, size: int, offset: int) -> bytes:
    """The `size` bytes of a frame.

    Raises:
        StreamError: E_FRAME or E_ZSTD at `offset`.
    """
    content = _by_compiled(frame, np.array([[0, len(frame), size]]))
    return content.tobytes() if content is not None else _by_library(frame, size, offset)


def _by_library(frame: memoryview, size: int, offset: int) -> bytes:
    """`decompress` by libzstd, which says what is wrong."""
    check_frame(frame, size, offset)
    try:
        if size > MAX_BLOCK:
            # In one call libzstd takes blocks that give more than MAX_BLOCK (R-5.10-6).
            data = _decompressor().decompressobj(write_size=MAX_BLOCK).decompress(frame)
        else:
            data = _decompressor().decompress(frame, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise StreamError(Fault.E_ZSTD, str(error), offset) from None
    if len(data) != size:
        raise StreamError(Fault.E_ZSTD, f"{len(data)} bytes came out, not {size}", offset)
    if not literals.are_exact(frame, _decompress_some):
        detail = "a Huffman tree or stream that R-5.10-12 to R-5.10-14 refuse"
        raise StreamError(Fault.E_ZSTD, detail, offset)
    return bytes(data)


def _by_compiled(data: memoryview, places: I64) -> U8 | None:
    """The contents of frames, one after the other; None if one is not plainly legal.

    Where numba is loaded, that is: to load it takes longer than most streams do.
    """
    if not MAY_COMPILE or sys.modules.get("numba") is None or places[:, 2].max() > MAX_CONTENT:
        return None
    from evogs_codec.format import compiled_frames

    out = np.empty(int(places[:, 2].sum()), np.uint8)
    is_good = compiled_frames.read_frames(np.frombuffer(data, np.uint8), places, out)
    return out if is_good else None


def _decompress_some(frame: bytes, n: int) -> bytes:
    """The content of up to n bytes of a frame that does not state its size."""
    return bytes(_decompressor().decompress(frame, max_output_size=n))


def decompress_all(data: memoryview, places: I64, offset: int = 0) -> U8:
    """The contents of frames, one after the other.

    Args:
        data: the file, or a packet.
        places: (F, 3) offset, size and content size of each frame.
        offset: of the packet, for faults.

    Raises:
        StreamError: as `decompress`, of the first frame with a fault.
    """
    out = _by_compiled(data, places) if len(places) else None
    if out is None and len(places) == 1:
        begin, n, size = places[0].tolist()
        out = np.frombuffer(_by_library(data[begin : begin + n], size, offset), np.uint8)
    elif out is None:
        # Filled frame by frame, so that it is not there twice.
        out, at = np.empty(int(places[:, 2].sum()), np.uint8), 0
        for begin, n, size in places.tolist():
            content = _by_library(data[begin : begin + n], size, offset)
            out[at : at + size] = np.frombuffer(content, np.uint8)
            at += size
    out.flags.writeable = False  # loops are compiled for one kind
    return out


def _decompressor() -> zstandard.ZstdDecompressor:
    """That of the thread."""
    found: zstandard.ZstdDecompressor | None = getattr(_local, "decompressor", None)
    if found is None:
        found = _local.decompressor = zstandard.ZstdDecompressor()
    return found


def check_frame(frame: memoryview, size: int, offset: int) -> None:
    """Raise E_FRAME unless `frame` keeps R-5.10-1 to R-5.10-5 for `size` bytes of content."""

    def refuse(detail: str) -> StreamError:
        return StreamError(Fault.E_FRAME, detail, offset)

    if frame[:4] != MAGIC or len(frame) < 5:  # R-5.10-1
        raise refuse("no Zstandard frame")
    descriptor = frame[4]
    if descriptor & 0b00111111 != 0b00100000:  # R-5.10-2
        raise refuse(f"frame header descriptor {descriptor:#04x}")
    size_bytes = (1, 2, 4, 8)[descriptor >> 6]
    at = 5 + size_bytes
    content = int.from_bytes(frame[5:at], "little") + (256 if size_bytes == 2 else 0)
    if len(frame) < at or content != size:  # R-5.10-3
        raise refuse(f"frame content size is not {size}")
    if content > MAX_CONTENT:  # R-5.10-4
        raise refuse(f"a frame of {content} bytes")
    last = False
    while not last:  # R-5.10-5
        if len(frame) < at + 3:
            raise refuse("a block header is cut short")
        header = int.from_bytes(frame[at : at + 3], "little")
        last, kind, block = bool(header & 1), header >> 1 & 3, header >> 3
        if kind == 3 or block > min(content, MAX_BLOCK):
            raise refuse("a block is reserved or too large")
        if block == 0 and not (kind == 0 and last):
            raise refuse("an empty block")
        at += 3 + (1 if kind == 1 else block)
    if at != len(frame):
        raise refuse(f"the last block ends at {at} of {len(frame)} bytes")
