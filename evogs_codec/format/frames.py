"""Zstandard frames (spec 5.10); the only module that imports zstandard.

A frame's own headers are checked here, outside the library: libraries differ, and change, in what
they accept.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from itertools import pairwise
from types import ModuleType

import numpy as np
import zstandard
from zstandard import COMPRESSOBJ_FLUSH_BLOCK as FLUSH_BLOCK

from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import literals
from evogs_codec.model.splats import I64, U8

__all__ = [
    "MAX_BLOCK",
    "MAX_CONTENT",
    "WEIGHING",
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
WEIGHING, LARGE = 16, 4096  # the first such level, and bytes of a plane
FOUND = 0.95  # of the bytes: where a quick search takes less, there is more to be found
NARROW = {"hash_log": 6, "chain_log": 6, "search_log": 1, "min_match": 7}
MAY_COMPILE = True  # False: literals are checked as without numba
_local = threading.local()


def compress(data: bytes, effort: int, ends: Sequence[int] = ()) -> bytes:
    """One frame of the subset.

    Args:
        data: its content.
        effort: the Zstandard level, 1..22.
        ends: where blocks may end, beside where libzstd lets them end (`blocks`).

    Raises:
        ValueError: more than `MAX_CONTENT` bytes.
    """
    frames = [store(data)]
    if effort < WEIGHING or len(data) < LARGE:
        frames.append(_frame(data, effort))
        if ends:
            frames.append(_frame(data, effort, ends=ends))
    else:
        frames += [_frame(data, effort, ends=ends, is_narrow=True), _frame(data, 1)]
        if len(frames[-1]) < FOUND * len(frames[-2]):
            frames.append(_frame(data, effort))
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
    if not _literals_are_exact(frame):
        detail = "a Huffman tree or stream that R-5.10-12 to R-5.10-14 refuse"
        raise StreamError(Fault.E_ZSTD, detail, offset)
    return bytes(data)


def _compiled() -> ModuleType | None:
    """The compiled check where numba is loaded: to load it takes longer than most streams do."""
    if not MAY_COMPILE or sys.modules.get("numba") is None:
        return None
    from evogs_codec.format import compiled_literals

    return compiled_literals


def _literals_are_exact(frame: memoryview) -> bool:
    """R-5.10-12 to R-5.10-14 for a frame that libzstd took."""
    compiled = _compiled()
    if compiled is not None:
        return bool(compiled.are_exact(np.frombuffer(frame, np.uint8)))
    return literals.are_exact(frame, _decompress_some)


def _decompress_some(frame: bytes, n: int) -> bytes:
    """The content of up to n bytes of a frame that does not state its size."""
    return bytes(_decompressor().decompress(frame, max_output_size=n))


def decompress_all(data: memoryview, places: I64) -> U8 | None:
    """The contents of checked frames, one after the other; None if one has a fault.

    One call of the library, which holds no lock, for the frames of up to a block, where it has such
    a call.

    Args:
        data: the file.
        places: (F, 3) offset, size and content size of each frame.
    """
    if not len(places):
        return np.empty(0, np.uint8)
    if "multi_decompress_to_buffer" not in zstandard.backend_features:
        try:
            contents = [decompress(data[a : a + n], size, 0) for a, n, size in places.tolist()]
        except StreamError:
            return None
        return np.frombuffer(b"".join(contents), np.uint8)
    ends = np.cumsum(places[:, 2])
    large = np.append(np.flatnonzero(places[:, 2] > MAX_BLOCK), len(places))
    if ends[-1] <= MAX_CONTENT and len(large) == 1:
        return _decompress_many(data, places)
    # In parts, so that what comes out is not there twice.
    joined = np.empty(int(ends[-1]), np.uint8)
    first = at = 0
    while first < len(places):
        next_large = int(large[np.searchsorted(large, first)])
        last = int(np.searchsorted(ends, at + MAX_CONTENT, side="right"))
        last = max(first + 1, min(last, next_large))
        found = _decompress_part(data, places[first:last])
        if found is None or len(found) != ends[last - 1] - at:
            return None
        joined[at : at + len(found)] = found
        first, at = last, int(ends[last - 1])
    return joined


def _decompress_part(data: memoryview, places: I64) -> U8 | None:
    """`decompress_all` for frames of up to a block, or for a larger one."""
    begin, n, size = places[0].tolist()
    if size <= MAX_BLOCK:
        return _decompress_many(data, places)
    try:
        return np.frombuffer(decompress(data[begin : begin + n], size, 0), np.uint8)
    except StreamError:
        return None


def _decompress_many(data: memoryview, places: I64) -> U8 | None:
    """`decompress_all` in one call of the library."""
    frames = zstandard.BufferWithSegments(data, places[:, :2].astype(np.uint64).tobytes())
    sizes = places[:, 2].astype(np.uint64).tobytes()
    try:
        found = _decompressor().multi_decompress_to_buffer(frames, decompressed_sizes=sizes)
    except zstandard.ZstdError:
        return None
    compiled = _compiled()
    if compiled is None:
        whole = all(_literals_are_exact(data[a : a + n]) for a, n, _ in places.tolist())
    else:
        whole = compiled.all_are_exact(np.frombuffer(data, np.uint8), places)
    if not whole:
        return None
    joined = b"".join(found)  # type: ignore[arg-type]  # segments are buffers, untold by the stubs
    return np.frombuffer(joined, np.uint8)


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
