"""Every byte of a stream with its name and value (spec 5), whatever is wrong with it.

Nothing is refused: what does not fit is shown as it stands, with a remark. Zstandard content stays
closed; of a frame the headers are shown (spec 5.10).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace

from conformance.harness.reporting.packet_anatomy import packet_anatomy
from conformance.harness.reporting.pieces import Piece, Reader

__all__ = ["anatomy"]

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
    b"QUAN": (("mantissa", "H"), ("shift", "B")),
    b"TILE": (("origin", "3q"), ("box_min", "3i"), ("box_max", "3i")),
    b"PACK": (
        *(("tile", "I"), ("component", "B"), ("level", "B"), ("reserved", "H"), ("size", "I")),
        *(("n_adds", "I"), ("n_splits", "I"), ("n_refines", "I"), ("n_drops", "I")),
        *(("error", "I"), ("crc", "I")),
    ),
    b"dGST": (("tile", "I"), ("component", "B"), ("step", "I"), ("digest", "32s")),
}
PALETTE_COMPONENTS = {4: ": picks", 5: ": palette of level {level}"}
CLASSES = ("position", "rotation", "scale", "opacity", *(f"SH band {band}" for band in range(4)))


def anatomy(data: bytes) -> list[Piece]:
    """The pieces of a stream in order; they hold every byte once."""
    pieces = list(_Reader(data).read())
    if b"".join(piece.raw for piece in pieces) != data:
        raise AssertionError("the pieces do not cover the stream")
    return pieces


class _Reader(Reader):
    """Reads header and chunks, and remembers what the packets need."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.head: dict[str, tuple[int, ...]] = {}
        self.packets: list[dict[str, int]] = []

    def read(self) -> Iterator[Piece]:
        yield from self.header()
        end = min(64 + self.number("chunks_size"), len(self.data))
        while self.at < end:
            yield from self.chunk(end)
        counts: dict[tuple[int, int], int] = {}
        cores: dict[tuple[int, int], dict[str, int]] = {}  # rows by tile and step
        has_palette = self.number("flags") >> 8 & 1 == 1
        palette_degree = min(self.number("sh_degree"), 3) if has_palette else 0
        for number, row in enumerate(self.packets):
            key = row["tile"], row["component"]
            step = counts[key] = counts.get(key, -1) + 1
            if row["component"] == 0:
                cores[row["tile"], step] = row
            holds = PALETTE_COMPONENTS.get(key[1], "").format(**row) if palette_degree else ""
            name = f"packet {number} (tile {key[0]}, step {step}, component {key[1]}{holds})"
            core = cores.get((row["tile"], step), row)
            yield from packet_anatomy(self, name, row, core, palette_degree)
        if self.at < len(self.data):
            remark = "bytes follow the last packet (R-6.2-1)"
            yield self.take(len(self.data), "rest", "", remark, "what follows the packets")

    def number(self, name: str) -> int:
        """A field of the header; 0 if it is not there."""
        return self.head.get(name, (0,))[0]

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
            if kind == b"QUAN":
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


CHUNKS = {*ROWS, b"ALFA", b"mETa"}


def _unknown(kind: bytes) -> str:
    if not (kind.isalpha() and len(kind) == 4 and kind[2:3].isupper()):
        return "not a chunk type (R-5.2-2)"
    return "unknown, critical (R-8.1-1)" if kind[:1].isupper() else "unknown, ancillary (R-8.1-2)"


def _crc_remark(raw: bytes, covered: bytes) -> str:
    right = zlib.crc32(covered)
    return "" if int.from_bytes(raw, "little") == right else f"should be {right:#010x} (R-6.3-1)"
