"""Every byte of a stream with its name and value (spec 5), whatever is wrong with it.

Nothing is refused: what does not fit is shown as it stands, with a remark. Zstandard content stays
closed; of a frame the headers are shown (spec 5.10).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

__all__ = ["Piece", "anatomy"]

HEADER = (
    *(("signature", "8s"), ("version_major", "B"), ("version_minor", "B"), ("tier", "B")),
    *(("sh_degree", "B"), ("n_levels", "B"), ("grid_exponents", "5b"), ("flags", "H")),
    *(("coordinate_system", "B"), ("up_axis", "B"), ("unit", "B"), ("colour_space", "B")),
    *(("n_tiles", "I"), ("n_packets", "I"), ("chunks_size", "I"), ("data_size", "Q")),
    *(("reserved", "16s"), ("crc", "I")),
)
CHUNK_HEADER = (("type", "4s"), ("size", "I"), ("crc", "I"))
ALPHA_TABLE = (("level", "B"), ("group", "B"), ("shift", "B"), ("last", "B"))
META_ENTRY = (("key_size", "B"), ("value_size", "H"))
ROWS = {
    b"STEP": (("mantissa", "H"), ("shift", "B")),
    b"TILE": (("origin", "3q"), ("box_min", "3i"), ("box_max", "3i")),
    b"PACK": (
        *(("tile", "I"), ("component", "B"), ("level", "B"), ("reserved", "H"), ("size", "I")),
        *(("n_adds", "I"), ("n_splits", "I"), ("n_refines", "I"), ("n_drops", "I")),
        *(("error", "I"), ("crc", "I")),
    ),
    b"dGST": (("tile", "I"), ("component", "B"), ("step", "I"), ("digest", "32s")),
}
GROUPS = ("position", "rotation", "scale", "opacity", "SH")
CLASSES = ("position", "rotation", "scale", "opacity", *(f"SH band {band}" for band in range(4)))
CORE_CHANNELS = (
    *(f"position {axis}" for axis in "xyz"),
    *(f"rotation {axis}" for axis in "wxyz"),
    *(f"scale {axis}" for axis in "xyz"),
    "opacity",
    *(f"SH 0 {colour}" for colour in "RGB"),
)
Fields = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Piece:
    """Bytes with a meaning.

    Attributes:
        at: offset in the file.
        raw: the bytes.
        name: the field, by the words of the spec.
        value: what it says.
        remark: what is wrong with it, or is not obvious.
        starts: the structure that begins here, by which faults are placed; "" in its middle.
    """

    at: int
    raw: bytes
    name: str
    value: str = ""
    remark: str = ""
    starts: str = ""


def anatomy(data: bytes) -> list[Piece]:
    """The pieces of a stream in order; they hold every byte once."""
    pieces = list(_Reader(data).read())
    if b"".join(piece.raw for piece in pieces) != data:
        raise AssertionError("the pieces do not cover the stream")
    return pieces


class _Reader:
    """Reads on as long as there are bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0
        self.head: dict[str, tuple[int, ...]] = {}
        self.packets: list[dict[str, int]] = []

    def read(self) -> Iterator[Piece]:
        yield from self.header()
        end = min(64 + self.number("chunks_size"), len(self.data))
        while self.at < end:
            yield from self.chunk(end)
        counts: dict[tuple[int, int], int] = {}
        core: dict[tuple[int, int], dict[str, int]] = {}
        for number, row in enumerate(self.packets):
            key = row["tile"], row["component"]
            step = counts[key] = counts.get(key, -1) + 1
            if row["component"] == 0:
                core[row["tile"], step] = row
            of_core = core.get((row["tile"], step), row)
            name = f"packet {number} (tile {key[0]}, step {step}, component {key[1]})"
            yield from self.packet(name, row, of_core)
        if self.at < len(self.data):
            remark = "bytes follow the last packet (R-6.2-1)"
            yield self.take(len(self.data), "rest", "", remark, "what follows the packets")

    def number(self, name: str) -> int:
        """A field of the header; 0 if it is not there."""
        return self.head.get(name, (0,))[0]

    def take(
        self, end: int, name: str, value: str = "", remark: str = "", starts: str = ""
    ) -> Piece:
        """The bytes up to `end`, as far as there are any."""
        end = min(end, len(self.data))
        piece = Piece(self.at, self.data[self.at : end], name, value, remark, starts)
        self.at = end
        return piece

    def fields(
        self, fields: Fields, prefix: str, end: int, found: dict[str, tuple[int, ...]]
    ) -> Iterator[Piece]:
        """The fields of a structure, one piece each, as far as they are there; kept in `found`."""
        for name, form in fields:
            stop = self.at + struct.calcsize(f"<{form}")
            if stop > min(end, len(self.data)):
                if self.at < min(end, len(self.data)):
                    yield self.take(end, prefix + name, "", "cut short")
                return
            values = struct.unpack_from(f"<{form}", self.data, self.at)
            found[name] = values
            yield self.take(stop, prefix + name, _show(values))

    def header(self) -> Iterator[Piece]:
        pieces = list(self.fields(HEADER, "", 64, self.head))
        for number, piece in enumerate(pieces):
            remark = piece.remark
            if piece.name == "signature" and piece.raw != b"\x89EVG\r\n\x1a\n":
                remark = "not the signature (R-5.1-1)"
            if piece.name == "crc" and len(piece.raw) == 4:
                remark = _crc_remark(piece.raw, self.data[:60])
            starts = "header" if number == 0 else ""
            yield replace(piece, remark=remark, starts=starts)

    def chunk(self, end: int) -> Iterator[Piece]:
        begin, found = self.at, dict[str, tuple[int, ...]]()
        pieces = list(self.fields(CHUNK_HEADER, "", end, found))
        kind = bytes(self.data[begin : begin + 4])
        size = found.get("size", (0,))[0]
        stop = min(self.at + size, end)
        covered = self.data[begin : begin + 8] + self.data[begin + 12 : begin + 12 + size]
        for number, piece in enumerate(pieces):
            remark = piece.remark
            if piece.name == "crc" and len(piece.raw) == 4:
                remark = _crc_remark(piece.raw, covered)
            if piece.name == "size" and begin + 12 + size > end:
                remark = "reaches past the chunks (R-5.2-1)"
            if piece.name == "type":
                remark = "" if kind in CHUNKS else _unknown(kind)
            starts = f"chunk {kind.decode('latin-1')!r}" if number == 0 else ""
            yield replace(piece, remark=remark, starts=starts)
        if len(pieces) == len(CHUNK_HEADER):
            yield from self.body(kind, stop)

    def body(self, kind: bytes, end: int) -> Iterator[Piece]:
        number = 0
        while self.at < end:
            if kind == b"STEP":
                yield from self.step_entry(number, end)
            elif kind in ROWS:
                found: dict[str, tuple[int, ...]] = {}
                prefix = f"{kind.decode()} {number}: "
                yield from self.fields(ROWS[kind], prefix, end, found)
                if kind == b"PACK" and len(found) == len(ROWS[kind]):
                    self.packets.append({name: values[0] for name, values in found.items()})
            elif kind == b"ALFA":
                yield from self.alpha_table(end)
            elif kind == b"mETa":
                yield from self.metadata(end)
            else:
                yield self.take(end, "body", f"{end - self.at} bytes")
            number += 1

    def step_entry(self, number: int, end: int) -> Iterator[Piece]:
        n_classes = 5 + min(self.number("sh_degree"), 3)
        row, kind = divmod(number, n_classes)
        of = "adds" if row == 0 else f"psi of level {row - 1}"
        if end - self.at < 3:
            yield self.take(end, f"{of}, {CLASSES[kind]}", "", "cut short")
            return
        mantissa, shift = struct.unpack_from("<HB", self.data, self.at)
        remark = "" if mantissa and shift <= 24 else "outside its domain (R-5.3-1, R-5.3-2)"
        yield self.take(
            self.at + 3,
            f"{of}, {CLASSES[kind]}: mantissa, shift",
            f"{mantissa}, {shift}",
            remark,
        )

    def alpha_table(self, end: int) -> Iterator[Piece]:
        found: dict[str, tuple[int, ...]] = {}
        yield from self.fields(ALPHA_TABLE, "alpha table: ", end, found)
        if "last" in found and self.at < end:
            stop = min(self.at + 2 * (found["last"][0] + 1), end)
            raw = self.data[self.at : stop - (stop - self.at) % 2]
            values = struct.unpack(f"<{len(raw) // 2}h", raw)
            shift = found["shift"][0]
            yield self.take(stop, "a", ", ".join(f"{a} / 2^{shift}" for a in values))

    def metadata(self, end: int) -> Iterator[Piece]:
        found: dict[str, tuple[int, ...]] = {}
        yield from self.fields(META_ENTRY, "", end, found)
        for name in ("key", "value"):
            size = found.get(f"{name}_size", (0,))[0]
            if size and self.at < end:
                text = self.data[self.at : min(self.at + size, end)].decode("utf-8", "replace")
                yield self.take(min(self.at + size, end), name, ascii(text))

    def packet(self, name: str, row: dict[str, int], core: dict[str, int]) -> Iterator[Piece]:
        begin, end = self.at, self.at + row["size"]
        if self.at >= len(self.data) or row["size"] == 0:
            return
        raw = self.data[begin:end]
        pieces = list(self.packet_pieces(name, row["component"], core, min(end, len(self.data))))
        remark = "cut short (R-6.2-2)" if len(raw) < row["size"] else ""
        if not remark and zlib.crc32(raw) != row["crc"]:
            remark = f"CRC-32 {zlib.crc32(raw):#010x}, stored {row['crc']:#010x} (R-6.3-1)"
        for number, piece in enumerate(pieces):
            both = "; ".join(filter(None, (remark, piece.remark)))
            yield replace(piece, remark=both, starts=name) if number == 0 else piece

    def packet_pieces(
        self, name: str, component: int, core: dict[str, int], end: int
    ) -> Iterator[Piece]:
        short = name.partition(" (")[0]
        flags = self.data[self.at]
        remark = "reserved bits are set (R-4.4-1)" if flags >> 2 else ""
        yield self.take(self.at + 1, f"{short}: flags", str(flags), remark)
        if self.at == end:
            return
        n_frames = self.data[self.at]
        yield self.take(self.at + 1, f"{short}: n_frames", str(n_frames))
        for title, n_lists in _coding_rows(component):
            if self.at < end:
                codings = self.data[self.at : min(self.at + n_lists, end)]
                yield self.take(min(self.at + n_lists, end), title, _codings(codings))
        sizes = []
        for number in range(n_frames):
            if end - self.at < 5:
                break
            n_planes, size = struct.unpack_from("<BI", self.data, self.at)
            sizes.append(size)
            yield self.take(self.at + 5, f"frame {number}: n_planes, size", f"{n_planes}, {size}")
        for number, size in enumerate(sizes):
            if self.at < end:
                yield from self.frame(number, min(self.at + size, end))
        if self.at < end:
            yield self.take(end, "rest of the packet", "", "belongs to no frame (R-5.9-8)")

    def frame(self, number: int, end: int) -> Iterator[Piece]:
        name = f"frame {number}"
        remark = "" if self.data[self.at : self.at + 4] == MAGIC else "not the magic (R-5.10-1)"
        if end - self.at < 6 or remark:
            yield self.take(end, name, "", remark or "too short for a frame header")
            return
        yield self.take(self.at + 4, f"{name}: Magic_Number")
        descriptor = self.data[self.at]
        remark = "" if descriptor & 0x3F == 0x20 else "outside the subset (R-5.10-2)"
        yield self.take(self.at + 1, f"{name}: descriptor", f"{descriptor:#04x}", remark)
        width = (1, 2, 4, 8)[descriptor >> 6]
        content = int.from_bytes(self.data[self.at : self.at + width], "little")
        content += 256 if width == 2 else 0
        yield self.take(min(self.at + width, end), f"{name}: Frame_Content_Size", str(content))
        while end - self.at >= 3:
            word = int.from_bytes(self.data[self.at : self.at + 3], "little")
            kind, size = ("raw", "RLE", "compressed", "reserved")[word >> 1 & 3], word >> 3
            last = ", last" if word & 1 else ""
            yield self.take(self.at + 3, f"{name}: block header", f"{kind}, size {size}{last}")
            stop = min(self.at + (1 if kind == "RLE" else size), end)
            if self.at < stop:
                yield self.take(stop, f"{name}: block")
            if word & 1:
                break
        if self.at < end:
            yield self.take(end, f"{name}: rest", "", "behind the last block (R-5.10-5)")


MAGIC = b"\x28\xb5\x2f\xfd"
CHUNKS = {*ROWS, b"ALFA", b"mETa"}


def _coding_rows(component: int) -> list[tuple[str, int]]:
    """What the coding bytes of a packet are of, and how many (spec 5.9)."""
    n = 14 if component == 0 else 3 * (2 * component + 1)
    sides = [("coding bytes of gaps, kinds, alpha", 7)] if component == 0 else []
    return [*sides, ("coding bytes of psi", n), ("coding bytes of adds", n)]


def _codings(codings: bytes) -> str:
    """Coding bytes as low+8*high, d for delta; . for a list of zeros."""
    texts = []
    for c in codings:
        bits = f"{c & 15}+{8 * (c >> 4 & 3)}" + ("d" if c & 64 else "") + ("!" if c & 128 else "")
        texts.append(bits if c else ".")
    return " ".join(texts)


def _unknown(kind: bytes) -> str:
    if not (kind.isalpha() and len(kind) == 4 and kind[2:3].isupper()):
        return "not a chunk type (R-5.2-2)"
    return "unknown, critical (R-8.1-1)" if kind[:1].isupper() else "unknown, ancillary (R-8.1-2)"


def _crc_remark(raw: bytes, covered: bytes) -> str:
    right = zlib.crc32(covered)
    return "" if int.from_bytes(raw, "little") == right else f"should be {right:#010x} (R-6.3-1)"


def _show(values: tuple[object, ...]) -> str:
    if isinstance(values[0], bytes):
        text = values[0]
        return repr(text.decode("latin-1")) if len(text) == 4 else ""
    return ", ".join(map(str, values))
