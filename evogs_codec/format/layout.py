"""Structures of the stream, declared once (spec 5); the only module that imports construct.

The spec's tables are generated from these declarations, and the builders are these declarations.
What reads follows from them: formats of `struct`, and numpy dtypes for tables, because construct
takes 2 us for a field.
"""

from __future__ import annotations

from functools import cache
from itertools import islice
from struct import Struct as Unpacker
from typing import Any, TypeAlias

import construct as cs
import numpy as np
import numpy.typing as npt

from evogs_codec.errors import Fault, StreamError

__all__ = ["STRUCTURES", "build", "describe", "dtype_of", "parse", "read_table", "size_of"]

Struct: TypeAlias = Any  # a construct.Struct; construct has no types
Fields: TypeAlias = dict[str, Any]

SIGNATURE = b"\x89EVG\r\n\x1a\n"
VERSION = (1, 0)

FILE_HEADER: Struct = cs.Struct(
    "signature" / cs.Bytes(8) * "`89 45 56 47 0D 0A 1A 0A`",
    "version_major" / cs.Int8ul * "1",
    "version_minor" / cs.Int8ul * "0; a larger one is read like 0",
    "tier" / cs.Int8ul * "1, 2 or 3: the column of limits (8.2) that the stream keeps",
    "sh_degree" / cs.Int8ul * "0..3",
    "n_levels" / cs.Int8ul * "at least 1",
    "grid_exponents" / cs.Array(5, cs.Int8sl) * "G of each group, -16..40",
    "flags"
    / cs.Int16ul
    * "bit 0: the scene was made for an antialiased renderer; bits 1..7 unused;"
    " bit 8: the stream has a palette; bits 9..15 reserved",
    "coordinate_system" / cs.Int8ul * "registry, section 8.4; an unknown value reads as 0",
    "up_axis" / cs.Int8ul * "registry; an unknown value reads as 0",
    "unit" / cs.Int8ul * "registry; an unknown value reads as 0",
    "colour_space" / cs.Int8ul * "registry; an unknown value reads as 0",
    "n_tiles" / cs.Int32ul * "rows of the tile table",
    "n_packets" / cs.Int32ul * "rows of the packet table",
    "chunks_size" / cs.Int32ul * "bytes of all chunks together",
    "data_size" / cs.Int64ul * "bytes of all packets together",
    "reserved" / cs.Bytes(16) * "zero",
    "crc" / cs.Int32ul * "CRC-32 of the 60 bytes before it",
)

CHUNK_HEADER: Struct = cs.Struct(
    "type" / cs.Bytes(4) * "four ASCII letters, section 8.1",
    "size" / cs.Int32ul * "bytes of the body",
    "crc" / cs.Int32ul * "CRC-32 of type, size and body",
)

QUANTISER_ENTRY: Struct = cs.Struct(
    "mantissa" / cs.Int16ul * "M, 1..65535",
    "shift" / cs.Int8ul * "E, 0..24",
)

ALPHA_TABLE: Struct = cs.Struct(
    "level" / cs.Int8ul * "level whose splits use the table",
    "group" / cs.Int8ul * "0 position, 1 rotation, 2 scale, 3 opacity, 4 SH",
    "shift" / cs.Int8ul * "K, 0..12",
    "last" / cs.Int8ul * "number of entries less 1",
)
ALPHA_ENTRY: Struct = cs.Struct("a" / cs.Int16sl * "alpha is a / 2^K")

TILE_ENTRY: Struct = cs.Struct(
    "origin" / cs.Array(3, cs.Int64sl) * "O, absolute value at most 2^52",
    "box_min" / cs.Array(3, cs.Int32sl) * "least X of each position channel",
    "box_max" / cs.Array(3, cs.Int32sl) * "largest X of each position channel",
)

PACKET_ENTRY: Struct = cs.Struct(
    "tile" / cs.Int32ul * "row of the tile table",
    "component" / cs.Int8ul * "0 core, 1 to 3 the SH band of that number, 4 picks, 5 palette",
    "level" / cs.Int8ul * "label of the step (core), level of the entries (palette), 0 otherwise",
    "reserved" / cs.Int16ul * "zero",
    "size" / cs.Int32ul * "bytes of the packet",
    "n_adds" / cs.Int32ul * "adds of the step (core), entries (palette), 0 otherwise",
    "n_splits" / cs.Int32ul * "splits of the step (core), 0 otherwise",
    "n_refines" / cs.Int32ul * "refines of the step (core), 0 otherwise",
    "n_drops" / cs.Int32ul * "drops of the step (core), 0 otherwise",
    "error" / cs.Int32ul * "what stays to be refined after the packet: see below; a hint",
    "crc" / cs.Int32ul * "CRC-32 of the packet",
)

DIGEST_ENTRY: Struct = cs.Struct(
    "tile" / cs.Int32ul * "tile",
    "component" / cs.Int8ul * "component",
    "step" / cs.Int32ul * "number of the step",
    "digest" / cs.Bytes(32) * "SHA-256 of the state of the component after that step, section 7.7",
)

META_ENTRY: Struct = cs.Struct(
    "key_size" / cs.Int8ul * "bytes of the key, 1..255",
    "value_size" / cs.Int16ul * "bytes of the value; key and value follow",
)

PACKET_HEADER: Struct = cs.Struct(
    "flags"
    / cs.Int8ul
    * "bit 0: psi of SH is YCoCg-R; bit 1: adds of SH, or entries, are; bit 2, of picks: refined"
    " and split slots have new ones too; bit 2 of other packets and bits 3..7 reserved",
    "n_frames" / cs.Int8ul * "number of frames; the coding bytes follow, then the frame entries,"
    " then the frames",
)

FRAME_ENTRY: Struct = cs.Struct(
    "n_planes" / cs.Int8ul * "consecutive planes in the frame, 1..255",
    "size" / cs.Int32ul * "bytes of the frame",
)

DUMP_HEADER: Struct = cs.Struct(
    "magic" / cs.Bytes(4) * "`45 56 47 44`, EVGD",
    "version" / cs.Int8ul * "1",
    "sh_degree" / cs.Int8ul * "as in the file header",
    "grid_exponents" / cs.Array(5, cs.Int8sl) * "as in the file header",
    "reserved" / cs.Int8ul * "zero",
    "n_tiles" / cs.Int32ul * "tiles that follow",
)
DUMP_TILE: Struct = cs.Struct(
    "origin" / cs.Array(3, cs.Int64sl) * "as in the tile table",
    "n_slots" / cs.Int32ul * "slots; the live bytes and the channels follow",
)

STRUCTURES: dict[str, Struct] = {
    "file header": FILE_HEADER,
    "chunk header": CHUNK_HEADER,
    "quantiser entry": QUANTISER_ENTRY,
    "alpha table": ALPHA_TABLE,
    "alpha entry": ALPHA_ENTRY,
    "tile entry": TILE_ENTRY,
    "packet entry": PACKET_ENTRY,
    "digest entry": DIGEST_ENTRY,
    "metadata entry": META_ENTRY,
    "packet header": PACKET_HEADER,
    "frame entry": FRAME_ENTRY,
    "dump header": DUMP_HEADER,
    "dump tile": DUMP_TILE,
}

_TYPES = {
    "B": "u8",
    "b": "s8",
    "H": "u16",
    "h": "s16",
    "L": "u32",
    "l": "s32",
    "Q": "u64",
    "q": "s64",
}
_CODES = {name: code for code, name in _TYPES.items()}
_DTYPES = {"u8": "u1", "s8": "i1", "u16": "<u2", "s16": "<i2", "u32": "<u4", "s32": "<i4"}
_DTYPES |= {"u64": "<u8", "s64": "<i8"}


@cache
def size_of(struct: Struct) -> int:
    """Bytes of a structure."""
    return int(struct.sizeof())


def parse(struct: Struct, data: memoryview, offset: int) -> Fields:
    """The fields of a structure at the start of `data`, by name.

    Raises:
        StreamError: E_TRUNCATED at `offset`, the place of `data` in the file.
    """
    unpacker, counts = _unpacker(struct)
    if len(data) < unpacker.size:
        detail = f"{len(data)} bytes of {unpacker.size} are there"
        raise StreamError(Fault.E_TRUNCATED, detail, offset)
    values = iter(unpacker.unpack_from(data))
    return {name: list(islice(values, n)) if n else next(values) for name, n in counts}


def build(struct: Struct, **fields: Any) -> bytes:  # noqa: ANN401 - as many types as fields
    """Bytes of a structure with these fields."""
    return bytes(struct.build(fields))


def read_table(struct: Struct, body: memoryview) -> npt.NDArray[np.void]:
    """Rows of a table as a structured array that views `body`, whose size must fit."""
    return np.frombuffer(body, dtype_of(struct))


@cache
def dtype_of(struct: Struct) -> np.dtype[np.void]:
    """The packed numpy dtype of a structure."""
    fields: list[Any] = []
    for _, name, kind, _ in describe(struct):
        base, _, count = kind.partition("[")
        n = int(count[:-1]) if count else 0
        if base == "bytes":
            fields.append((name, f"V{n}"))
        else:
            fields.append((name, _DTYPES[base], (n,)) if n else (name, _DTYPES[base]))
    return np.dtype(fields)


@cache
def _unpacker(struct: Struct) -> tuple[Unpacker, tuple[tuple[str, int], ...]]:
    """What reads all fields, and (name, 0 or the length of its array) of each."""
    codes, counts = "<", []
    for _, name, kind, _ in describe(struct):
        base, _, count = kind.partition("[")
        n = int(count[:-1]) if count else 0
        codes += f"{n or 1}{'s' if base == 'bytes' else _CODES[base]}"
        counts.append((name, 0 if base == "bytes" else n))
    return Unpacker(codes), tuple(counts)


def describe(struct: Struct) -> list[tuple[int, str, str, str]]:
    """(offset, field, type, meaning) of each field, in order."""
    out = []
    offset = 0
    for field in struct.subcons:
        out.append((offset, str(field.name), _type_name(field.subcon), str(field.docs)))
        offset += field.sizeof()
    return out


def _type_name(field: Struct) -> str:
    while isinstance(field, cs.Renamed):
        field = field.subcon
    if isinstance(field, cs.Array):
        return f"{_type_name(field.subcon)}[{field.count}]"
    if isinstance(field, cs.Bytes):
        return f"bytes[{field.length}]"
    return _TYPES[field.fmtstr[-1]]
