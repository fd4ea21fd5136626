"""Damage that knows the structure of a stream.

A field is changed, and every size and checksum around it is made right again, so that only the
check of that field can notice.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random

import zstandard

from conformance.generator.builder import (
    CHUNK_HEADER_SIZE,
    DELTA,
    HEADER_SIZE,
    PALETTE,
    PICKS,
    ROW_CRC_AT,
    ROW_SIZE,
    ROW_SIZE_AT,
    compressed,
    places,
    raw,
    runs,
)

__all__ = ["Parts", "edited_content", "tampered"]

Body = bytearray
NUMBERS = (0, 1, 2, 3, 7, 8, 9, 15, 16, 24, 25, 40, 63, 64, 65, 127, 128, 239, 254, 255)
EDGES = tuple(1 << n for n in range(8, 64, 2))
# Offset and bytes of the fields.
HEADER_FIELDS = (
    *((0, 8), (8, 1), (9, 1), (10, 1), (11, 1), (12, 1), (13, 1), (14, 1), (17, 1), (18, 2)),
    *((20, 1), (21, 1), (22, 1), (23, 1), (24, 4), (28, 4), (36, 8), (44, 1), (59, 1)),
)
ROW_FIELDS = ((0, 4), (4, 1), (5, 1), (6, 2), (8, 4), *((at, 4) for at in range(12, 32, 4)))
TILE_SIZE, TILE_FIELDS = (
    48,
    (*((at, 8) for at in (0, 8, 16)), *((at, 4) for at in range(24, 48, 4))),
)
QUANTISER_FIELDS, DIGEST_FIELDS = ((0, 2), (2, 1)), ((0, 4), (4, 1), (5, 4), (9, 1), (40, 1))
FRAMES_AT = {0: 37, 1: 20, 2: 32, 3: 44}  # flags, n_frames and coding bytes, by component


@dataclass
class Parts:
    """A stream in pieces that can be changed and put together again."""

    header: Body
    chunks: list[tuple[bytes, Body]]
    packets: list[Body]
    tail: bytes = b""

    @staticmethod
    def of(data: bytes) -> Parts:
        """The pieces of a stream whose structure can be made out."""
        found = places(data)
        end = HEADER_SIZE + int.from_bytes(data[32:36], "little")
        chunks, at = list[tuple[bytes, Body]](), HEADER_SIZE
        while at + CHUNK_HEADER_SIZE <= end:
            size = int.from_bytes(data[at + 4 : at + 8], "little")
            begin = at + CHUNK_HEADER_SIZE
            chunks.append((data[at : at + 4], Body(data[begin : begin + size])))
            at = begin + size
        packets = [Body(data[a:b]) for a, b in found.packets]
        last = found.packets[-1][1] if packets else end
        return Parts(Body(data[:HEADER_SIZE]), chunks, packets, data[last:])

    def table(self) -> Body:
        """The body of PACK."""
        return next((body for kind, body in self.chunks if kind == b"PACK"), Body())

    def component(self, packet: int) -> int:
        """The component of a packet by its row."""
        rows = self.table()
        at = packet * ROW_SIZE + 4
        return rows[at] if at < len(rows) else 0

    def frames_at(self, packet: int) -> int:
        """Where the frame entries of a packet begin, if its row is right."""
        component = self.component(packet)
        if component in (PICKS, PALETTE):
            return 3 if component == PICKS else 3 * (min(self.header[11], 3) + 1) ** 2 - 1
        return FRAMES_AT.get(component, 37)

    def fit(self) -> None:
        """Make the sizes that follow from the packets right."""
        rows = self.table()
        for k, packet in enumerate(self.packets[: len(rows) // ROW_SIZE]):
            struct.pack_into("<I", rows, k * ROW_SIZE + ROW_SIZE_AT, len(packet))
        struct.pack_into("<Q", self.header, 36, sum(map(len, self.packets)))

    def join(self) -> bytes:
        """The bytes, every checksum right."""
        rows = self.table()
        data, start = b"".join(map(bytes, self.packets)), 0
        for at in range(0, len(rows) - ROW_SIZE + 1, ROW_SIZE):
            (size,) = struct.unpack_from("<I", rows, at + ROW_SIZE_AT)
            struct.pack_into("<I", rows, at + ROW_CRC_AT, zlib.crc32(data[start : start + size]))
            start += size
        area = b""
        for kind, body in self.chunks:
            head = kind + struct.pack("<I", len(body))
            area += head + struct.pack("<I", zlib.crc32(head + body)) + bytes(body)
        struct.pack_into("<I", self.header, 32, len(area))
        struct.pack_into("<I", self.header, 60, zlib.crc32(self.header[:60]))
        return bytes(self.header) + area + data + self.tail


def tampered(rng: Random, data: bytes) -> bytes:
    """The stream with one to three kinds of damage; rarely, checksums are left as they are."""
    if rng.random() < 0.1:
        return _rough(rng, data)
    parts = Parts.of(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        rng.choice(DAMAGE)(rng, parts)
    out = parts.join()
    return _rough(rng, out) if rng.random() < 0.03 else out


def _rough(rng: Random, data: bytes) -> bytes:
    """Damage without repair."""
    kind, out = rng.choice(("flip", "flip", "cut", "more", "drop")), Body(data)
    at = rng.randrange(len(data))
    if kind == "flip":
        out[at] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del out[at:]
    elif kind == "more":
        out += rng.randbytes(rng.choice((1, 3, 64)))
    else:
        del out[at : at + rng.choice((1, 2, 12, 36))]
    return bytes(out)


def _set(rng: Random, body: Body, at: int, size: int) -> None:
    """Another value of a field: near the old one, at an edge, or any."""
    if at + size > len(body):
        return
    old, top = int.from_bytes(body[at : at + size], "little"), 1 << 8 * size
    value = rng.choice(
        (
            old + rng.choice((-2, -1, 1, 2)),
            old ^ 1 << rng.randrange(8 * size),
            rng.choice(NUMBERS),
            rng.choice(EDGES) + rng.choice((-1, 0, 1)),
            -rng.choice(EDGES) + rng.choice((-1, 0, 1)),
            -rng.choice(NUMBERS),
            rng.randrange(top),
        )
    )
    body[at : at + size] = (value % top).to_bytes(size, "little")


def _header(rng: Random, parts: Parts) -> None:
    _set(rng, parts.header, *rng.choice(HEADER_FIELDS))


def _table(rng: Random, parts: Parts) -> None:
    """A field of a row of a chunk."""
    kind, body = rng.choice(parts.chunks)
    if not body:
        return
    size, fields = {
        b"QUAN": (3, QUANTISER_FIELDS),
        b"TILE": (TILE_SIZE, TILE_FIELDS),
        b"PACK": (ROW_SIZE, ROW_FIELDS),
        b"dGST": (41, DIGEST_FIELDS),
    }.get(kind, (1, ((0, 1),)))
    at, width = rng.choice(fields)
    _set(rng, body, rng.randrange(max(1, len(body) // size)) * size + at, width)


def _rows(rng: Random, parts: Parts) -> None:
    """Rows of PACK, with their packets or without them: swapped, repeated, lost."""
    rows = parts.table()
    n = min(len(rows) // ROW_SIZE, len(parts.packets))
    if n == 0:
        return
    a, b, with_packets = rng.randrange(n), rng.randrange(n), rng.random() < 0.8
    cut = [bytes(rows[k : k + ROW_SIZE]) for k in range(0, len(rows), ROW_SIZE)]
    changes: tuple[Callable[[list[Body]], None], ...] = (
        lambda items: items.insert(b, items.pop(a)),
        lambda items: items.insert(b, items[a][:]),
        lambda items: items.__delitem__(a),
    )
    change = rng.choice(changes)
    lists: list[list[Body]] = [[Body(row) for row in cut]]
    lists += [parts.packets] if with_packets else []
    for items in lists:
        change(items)
    rows[:] = b"".join(lists[0])
    if rng.random() < 0.9:
        struct.pack_into("<I", parts.header, 28, len(rows) // ROW_SIZE)
    if with_packets:
        parts.fit()


def _chunk(rng: Random, parts: Parts) -> None:
    """A chunk moved, repeated, lost, renamed, shorter or longer."""
    at = rng.randrange(len(parts.chunks))
    kind, body = parts.chunks[at]
    action = rng.randrange(6)
    if action == 0:
        parts.chunks.insert(rng.randrange(len(parts.chunks)), parts.chunks.pop(at))
    elif action == 1:
        parts.chunks.insert(rng.randrange(len(parts.chunks)), (kind, Body(body)))
    elif action == 2 and len(parts.chunks) > 1:
        del parts.chunks[at]
    elif action == 3:
        letter = rng.randrange(4)
        renamed = Body(kind)
        renamed[letter] ^= rng.choice((32, 32, 1, 128))
        parts.chunks[at] = (bytes(renamed), body)
    elif action == 4:
        del body[len(body) - rng.choice((1, 2, 3, 4, 36, 41)) :]
    else:
        body += rng.randbytes(rng.choice((1, 2, 3, 4, 41)))


def _packet(rng: Random, parts: Parts) -> None:
    """The header, coding bytes or frame entries of a packet; or it is shorter or longer."""
    full = [k for k, packet in enumerate(parts.packets) if packet]
    if not full:
        return
    k = rng.choice(full)
    packet, frames_at = parts.packets[k], parts.frames_at(k)
    place = rng.randrange(6)
    if place == 0:
        _set(rng, packet, rng.choice((0, 1)), 1)
    elif place < 4:
        at = rng.randrange(2, frames_at)
        coding = rng.choice((0, 1, 2, 4, 8, 9, 0x10, 0x14, 0x18, 0x28, 0x30, 0x40, 0x68, 0x80))
        used = [k for k in range(2, min(frames_at, len(packet))) if packet[k]]
        if used and rng.random() < 0.3:  # the list means something else, or may not have delta
            at = rng.choice(used)
            coding = packet[at] ^ DELTA
        packet[at : at + 1] = bytes([coding])
    elif place == 4 and len(packet) > 1 and packet[1]:
        entry = frames_at + 5 * rng.randrange(packet[1])
        _set(rng, packet, *rng.choice(((entry, 1), (entry + 1, 4))))
    else:
        packet += rng.randbytes(rng.choice((1, 4)))
        del packet[rng.choice((len(packet), len(packet) - 6, frames_at, 1)) :]
    parts.fit()


def _frame(rng: Random, parts: Parts) -> None:
    """A frame of any packet."""
    if full := [k for k, packet in enumerate(parts.packets) if len(packet) > 2 and packet[1]]:
        _frame_of(rng, parts, rng.choice(full))


def _frame_of(rng: Random, parts: Parts, k: int) -> None:
    """A frame of a packet that has some: its headers, its blocks, or its content packed anew."""
    packet, frames_at = parts.packets[k], parts.frames_at(k)
    entries = frames_at + 5 * packet[1]
    if entries > len(packet):
        return
    table = list(struct.iter_unpack("<BI", packet[frames_at:entries]))
    which = rng.randrange(len(table))
    begin = entries + sum(size for _, size in table[:which])
    frame = bytes(packet[begin : begin + table[which][1]])
    changed = rng.choice((_frame_bytes, _frame_bytes, _content, _content, _repacked))(rng, frame)
    packet[begin : begin + len(frame)] = changed
    size = table[which][1] + len(changed) - len(frame)
    struct.pack_into("<I", packet, frames_at + 5 * which + 1, size % (1 << 32))
    parts.fit()


def edited_content(rng: Random, parts: Parts, k: int, edit: Callable[[bytearray], None]) -> None:
    """The content of the last frame of packet k changed, if it has frames that can be made out."""
    packet, frames_at = parts.packets[k], parts.frames_at(k)
    entries = frames_at + 5 * packet[1]
    if entries > len(packet) or not packet[1]:
        return
    (size,) = struct.unpack_from("<I", packet, entries - 4)
    content = Body(_decompressed(bytes(packet[len(packet) - size :])))
    edit(content)
    frame = _packed(rng, content)
    packet[len(packet) - size :] = frame
    struct.pack_into("<I", packet, entries - 4, len(frame))
    parts.fit()


def _of_palette(rng: Random, parts: Parts) -> None:
    """Damage to what a palette adds; where there is none, mostly to rows."""
    if parts.header[19] & 1 or rng.random() < 0.4:
        _palette(rng, parts)
    else:
        _rows(rng, parts)


def _palette(rng: Random, parts: Parts) -> None:
    """The flag, or a row of the palette or of picks, or its packet."""
    rows = parts.table()
    n = min(len(rows) // ROW_SIZE, len(parts.packets))
    own = [k for k in range(n) if parts.component(k) in (PICKS, PALETTE)]
    action = rng.randrange(9) if parts.header[19] & 1 and own else 0
    if action == 0:
        parts.header[19] ^= 1
        return
    k = rng.choice(own)
    packet, row = parts.packets[k], k * ROW_SIZE
    if action == 1:
        at, width = rng.choice(ROW_FIELDS)
        _set(rng, rows, row + at, width)
    elif action == 2:
        struct.pack_into("<I", rows, row + 12, rng.choice((0, 1, 2)))  # the number of entries
    elif action == 3:  # mostly entries behind picks, or picks before core
        _move(parts, k, rng.randrange(n))
    elif action == 4 and len(packet) > 2 and packet[1]:
        _frame_of(rng, parts, k)
    elif action < 7:  # a level of entries: other picks require them, or it falls
        entries = [at for at in own if parts.component(at) == PALETTE] or own
        rows[rng.choice(entries) * ROW_SIZE + 5] = rng.randrange(parts.header[12] + 1)
    elif action == 7:
        rows[row + 4] = rng.choice((PICKS, PALETTE, 0, 3))
    else:
        struct.pack_into("<I", rows, row, rng.randrange(3))  # the tile


def _move(parts: Parts, a: int, b: int) -> None:
    """Row and packet a stand at b."""
    rows = parts.table()
    cut = [Body(rows[at : at + ROW_SIZE]) for at in range(0, len(rows), ROW_SIZE)]
    for items in (cut, parts.packets):
        items.insert(b, items.pop(a))
    rows[:] = b"".join(cut)


def _frame_bytes(rng: Random, frame: bytes) -> bytes:
    """One byte of a frame, mostly of its headers; or a tail, or a cut."""
    out = Body(frame)
    kind = rng.randrange(8)
    if kind == 0:
        out += rng.choice((b"\0", frame, b"\x50\x2a\x4d\x18\0\0\0\0"))
    elif kind == 1:
        del out[rng.randrange(len(out) + 1) :]
    elif out:
        _set(rng, out, rng.choice((0, 4, 4, 5, 6, 7, 8, rng.randrange(len(out)))), 1)
    return bytes(out)


def _content(rng: Random, frame: bytes) -> bytes:
    """The frame with a byte of its content changed."""
    content = Body(_decompressed(frame))
    if content:
        last = len(content) if rng.random() < 0.5 else min(len(content), 6)
        _set(rng, content, rng.randrange(last), 1)  # gaps, kinds and alpha indices come first
    return _packed(rng, content)


def _repacked(rng: Random, frame: bytes) -> bytes:
    """The content in another frame, now and then shorter or longer."""
    content = _decompressed(frame)
    return _packed(rng, rng.choice((content, content, content[:-1], content + b"\0")))


def _decompressed(frame: bytes) -> bytes:
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 20).stream_reader(frame) as reader:
            return bytes(reader.read(1 << 16))
    except zstandard.ZstdError:
        return b""


def _packed(rng: Random, content: bytes | Body) -> bytes:
    """A frame of any kind; a checksum or an unknown size makes it illegal."""
    content = bytes(content)
    if not content or rng.random() < 0.05:
        odd = zstandard.ZstdCompressor(write_checksum=True, write_content_size=rng.random() < 0.5)
        return bytes(odd.compress(content))
    return rng.choice((raw, runs, compressed(1), compressed(19)))(content)


DAMAGE: Sequence[Callable[[Random, Parts], None]] = (
    *(_header, _chunk, _table, _table, _table, _rows, _rows),
    *(_packet, _packet, _packet, _frame, _frame, _frame, _frame, _of_palette, _of_palette),
)
