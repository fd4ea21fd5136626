"""What the reference decoder makes of a costly stream: it must end soon, in bounded memory."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from typing import Protocol, TypeVar

from conformance.fuzzing import memory
from evogs_codec import Decoded, Decoder, StreamError, decode, read_directory
from evogs_codec.common.buffers import CHUNK
from evogs_codec.editing.byte_stats import bytes_by_group, levels
from evogs_codec.editing.omissions import omissions
from evogs_codec.model.channels import n_channels

__all__ = ["tried"]

PIECE = 4096  # bytes that are fed at a time
ARRAYS = 8  # of 4 bytes per slot, that the float view and the dump may take beside what they return
# Bytes: huge pages around arrays, blocks of splats; and the scratch of each thread, of which no
# page is made before it is used, but which counts.
ALWAYS = (16 << 20) + CHUNK * (os.cpu_count() or 1)

T = TypeVar("T")


class Clock(Protocol):
    """Calls a function, and raises if it takes too long."""

    def __call__(self, call: Callable[[], T], /) -> T:
        """What the function returns."""


def tried(data: bytes, within: Clock) -> tuple[str, str]:
    """(verdict, what is wrong, or "").

    Args:
        data: the stream.
        within: calls each part of it.
    """
    whole, says = _whole(data, within)
    if says:
        return "", says
    fed = within(lambda: _fed(data))
    if fed != whole:
        return whole, f"fed in pieces: {fed}; whole: {whole}"
    within(lambda: _info(data))
    return whole, ""


def _whole(data: bytes, within: Clock) -> tuple[str, str]:
    """The verdict of the whole file, and what of its memory is wrong."""
    allowed = memory.bound(data) + ALWAYS
    try:
        decoded = within(lambda: decode(data))
    except StreamError as error:
        peak = memory.peak(lambda: _refused(data), allowed)
        says = "" if peak <= allowed else f"{peak:,} bytes of memory to refuse it"
        return f"{error.fault.name} at {error.offset}", says
    slots = sum(tile.n_slots for tile in decoded.tiles)
    extra = ARRAYS * 4 * slots + ALWAYS
    view = 4 * n_channels(decoded.sh_degree) * decoded.n_leaves
    dump = sum(memoryview(part).nbytes for part in decoded.dump_parts())
    within(decoded.leaves)
    for name, call, most in (
        ("decoding", lambda: decode(data), allowed),
        ("the float view", decoded.leaves, view + extra),
        ("a dump", decoded.dump, dump + dump // 8 + extra),
        ("writing a dump", lambda: _digest(decoded), extra),
    ):
        peak = memory.peak(call, most)
        if peak > most:
            return "", f"{peak:,} bytes of memory for {name}, more than {most:,}"
    return _digest(decoded), ""


def _fed(data: bytes) -> str:
    """The verdict of the file in pieces."""
    decoder = Decoder()
    try:
        for at in range(0, len(data), PIECE):
            decoder.feed(data[at : at + PIECE])
        decoder.close()
    except StreamError as error:
        return f"{error.fault.name} at {error.offset}"
    return _digest(decoder.decoded)


def _info(data: bytes) -> None:
    """All that `evogs info` works out."""
    view = memoryview(data)
    try:
        directory = read_directory(view)
        levels(directory)
        if len(data) >= directory.size:
            bytes_by_group(directory, view)
            omissions(directory, view)
    except StreamError:
        return


def _refused(data: bytes) -> None:
    try:
        decode(data)
    except StreamError:
        return


def _digest(decoded: Decoded) -> str:
    """Of the dump, part by part."""
    digest = hashlib.sha256()
    for part in decoded.dump_parts():
        digest.update(part)
    return digest.hexdigest()
