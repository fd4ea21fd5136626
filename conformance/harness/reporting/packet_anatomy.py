"""The bytes of packets and frames with their names and values (spec 5.9, 5.10)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

from conformance.harness.judging.dumps import channel_name
from conformance.harness.reporting.pieces import Piece, Reader

__all__ = ["packet_anatomy"]

MAGIC = b"\x28\xb5\x2f\xfd"
BLOCKS = ("raw", "RLE", "compressed", "reserved")
GROUPS = ("position", "rotation", "scale", "opacity", "SH")
PICKS, PALETTE = 4, 5  # components of a stream with a palette
DELTA = 64  # bit of a coding byte
Lists = list[tuple[str, list[str]]]  # title and names, in the order of their coding bytes
SIDES = ("gaps", "kinds", *(f"alpha {group}" for group in GROUPS))


def packet_anatomy(
    reader: Reader, name: str, row: dict[str, int], core: dict[str, int], palette_degree: int = 0
) -> Iterator[Piece]:
    """The pieces of a packet, as its row of the packet table has it.

    Args:
        reader: stands where the packet begins.
        name: of the packet.
        row: fields of its row.
        core: fields of the row of the core packet of its step.
        palette_degree: of SH, in a stream with a palette; 0 in any other.
    """
    begin, end = reader.at, min(reader.at + row["size"], len(reader.data))
    if begin == end:
        return
    raw = reader.data[begin:end]
    remark = "cut short (R-6.2-2)" if len(raw) < row["size"] else ""
    if not remark and zlib.crc32(raw) != row["crc"]:
        remark = f"CRC-32 {zlib.crc32(raw):#010x}, stored {row['crc']:#010x} (R-6.3-1)"
    lists = _lists(row["component"], palette_degree)
    only_refines = core["n_splits"] == core["n_drops"] == 0
    with_delta = ("psi", "adds", "entries") if only_refines else ("adds", "entries")
    for piece in _pieces(reader, name.partition(" (")[0], lists, with_delta, end):
        if piece.at == begin:
            both = "; ".join(filter(None, (remark, piece.remark)))
            yield replace(piece, remark=both, starts=name)
        else:
            yield piece


def _pieces(
    reader: Reader, name: str, lists: Lists, with_delta: Sequence[str], end: int
) -> Iterator[Piece]:
    flags = reader.data[reader.at]
    n_flags = 3 if lists[0][0] == "picks" else 2
    remark = "reserved bits are set (R-4.4-1)" if flags >> n_flags else ""
    yield reader.take(reader.at + 1, f"{name}: flags", str(flags), remark)
    if reader.at == end:
        return
    n_frames = reader.data[reader.at]
    yield reader.take(reader.at + 1, f"{name}: n_frames", str(n_frames))
    for title, names in lists:
        stop = min(reader.at + len(names), end)
        if reader.at < stop:
            codings = reader.data[reader.at : stop]
            has_delta = title not in with_delta and any(c & DELTA for c in codings)
            remark = "delta where it may not be (R-5.9-3)" if has_delta else ""
            value = _codings(names, codings, "s" if title == "psi" else "d")
            yield reader.take(stop, f"coding bytes of {title}", value, remark)
    sizes = []
    for number in range(n_frames):
        if end - reader.at >= 5:
            n_planes, size = struct.unpack_from("<BI", reader.data, reader.at)
            sizes.append(size)
            title = f"frame {number}: n_planes, size"
            yield reader.take(reader.at + 5, title, f"{n_planes}, {size}")
    for number, size in enumerate(sizes):
        if reader.at < end:
            yield from _frame(reader, f"frame {number}", min(reader.at + size, end))
    if reader.at < end:
        yield reader.take(end, "rest of the packet", "", "belongs to no frame (R-5.9-8)")


def _frame(reader: Reader, name: str, end: int) -> Iterator[Piece]:
    if reader.data[reader.at : reader.at + 4] != MAGIC or end - reader.at < 6:
        remark = "not a frame, or too short for its header (R-5.10-1, R-5.10-2)"
        if reader.at < end:
            yield reader.take(end, name, "", remark)
        return
    yield reader.take(reader.at + 4, f"{name}: Magic_Number")
    descriptor = reader.data[reader.at]
    remark = "" if descriptor & 0x3F == 0x20 else "outside the subset (R-5.10-2)"
    yield reader.take(reader.at + 1, f"{name}: descriptor", f"{descriptor:#04x}", remark)
    stop = min(reader.at + (1, 2, 4, 8)[descriptor >> 6], end)
    content = int.from_bytes(reader.data[reader.at : stop], "little")
    content += 256 if descriptor >> 6 == 1 else 0
    yield reader.take(stop, f"{name}: Frame_Content_Size", str(content))
    is_last = False
    while end - reader.at >= 3 and not is_last:
        word = int.from_bytes(reader.data[reader.at : reader.at + 3], "little")
        is_last, kind, size = bool(word & 1), BLOCKS[word >> 1 & 3], word >> 3
        value = f"{kind}, size {size}" + (", last" if is_last else "")
        yield reader.take(reader.at + 3, f"{name}: block header", value)
        stop = min(reader.at + (1 if kind == "RLE" else size), end)
        if reader.at < stop:
            yield reader.take(stop, f"{name}: block")
    if reader.at < end:
        remark = "behind the last block" if is_last else "the last block is missing"
        yield reader.take(end, f"{name}: rest", "", f"{remark} (R-5.10-5)")


def _lists(component: int, palette_degree: int) -> Lists:
    """The lists of a packet by name, in the order of spec 5.9."""
    if palette_degree and component == PICKS:
        return [("picks", ["picks"])]
    if palette_degree and component == PALETTE:
        return [("entries", _channels(14, palette_degree))]
    channels = _channels(11 + 3 * component**2 if component else 0, component)
    sides = [("gaps, kinds, alpha", list(SIDES))] if component == 0 else []
    return [*sides, ("psi", channels), ("adds", channels)]


def _channels(first: int, band: int) -> list[str]:
    """Names of the channels from `first` to the last of an SH band."""
    return [channel_name(channel) for channel in range(first, 11 + 3 * (band + 1) ** 2)]


def _codings(lists: list[str], codings: bytes, delta: str) -> str:
    """`name low+8*high` of each list that is not all zeros.

    `delta` stands for that bit, ! for the reserved one.
    """
    texts = [
        f"{name} {c & 15}+{8 * (c >> 4 & 3)}{delta if c & DELTA else ''}{'!' if c & 128 else ''}"
        for name, c in zip(lists, codings, strict=False)
        if c
    ]
    return ", ".join(texts) or "all zeros"
