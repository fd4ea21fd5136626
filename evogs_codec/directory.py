"""Header and chunks: all a client needs to plan what to read (spec 5.1 to 5.8, 6.1 steps 1 to 3).

The packet table has no offsets and no step numbers: both follow from the order of its rows.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from evogs_codec import layout
from evogs_codec.errors import Fault, StreamError
from evogs_codec.limits import LIMITS
from evogs_codec.packets import MAX_NEW_PER_BYTE, Counts
from evogs_codec.refine import MAX_X, SYMMETRIC, AlphaTable, Quantiser
from evogs_codec.splats import I64, MAX_SH_DEGREE
from evogs_codec.tree import N_GROUPS

__all__ = ["Directory", "SceneInfo", "build_directory", "n_classes", "read_directory"]

HEADER_SIZE = layout.size_of(layout.FILE_HEADER)
CHUNK_HEADER_SIZE = layout.size_of(layout.CHUNK_HEADER)
CRITICAL = (b"STEP", b"ALFA", b"TILE", b"PACK")  # in this order (R-5.2-3)
ANCILLARY = (b"dGST", b"mETa")
MAX_ORIGIN = 1 << 52  # R-5.5-1
FLAG_ANTIALIASED = 1
UNKNOWN_ERROR = 0xFFFFFFFF
_KEY = re.compile(rb"[a-z0-9_.-]{1,255}\Z")


@dataclass(frozen=True)
class SceneInfo:
    """What a stream says of its scene; the numbers are those of `spec/registry.csv`."""

    coordinate_system: int = 0
    up_axis: int = 0
    unit: int = 0
    colour_space: int = 0
    antialiased: bool = False
    text: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Directory:
    """Header, tables and what follows from them.

    Attributes:
        sh_degree, n_levels, tier, grid_exponents: of the header.
        info: metadata.
        quantisers: [0] of adds, [1 + level] of psi; one per class each.
        alpha: tables by (level, group); `alpha_table` gives the default.
        tiles: rows of the tile table.
        packets: rows of the packet table.
        steps: (n_packets,) step of each packet.
        offsets: (n_packets,) file offset of each packet.
        digests: {(tile, component, step): SHA-256}.
        digests_offset: file offset of their chunk.
        copied_chunks: unknown chunks that are safe to copy, headers included.
        version_minor, unused_flags: of the header, without a meaning here.
        data_offset, size: where the packets begin, and bytes of the file.
    """

    tier: int
    sh_degree: int
    n_levels: int
    grid_exponents: tuple[int, ...]
    info: SceneInfo
    quantisers: tuple[tuple[Quantiser, ...], ...]
    alpha: Mapping[tuple[int, int], AlphaTable]
    tiles: npt.NDArray[np.void]
    packets: npt.NDArray[np.void]
    steps: I64
    offsets: I64
    digests: Mapping[tuple[int, int, int], bytes]
    digests_offset: int
    copied_chunks: bytes
    version_minor: int
    unused_flags: int
    data_offset: int
    size: int

    @property
    def n_components(self) -> int:
        return self.sh_degree + 1

    def alpha_table(self, level: int, group: int) -> AlphaTable:
        """The table of a level and group (spec 5.4)."""
        return self.alpha.get((level, group), SYMMETRIC)

    def counts(self, packet: int) -> Counts:
        """Record counts of a packet entry."""
        row = self.packets[packet]
        return Counts(
            int(row["n_adds"]), int(row["n_splits"]), int(row["n_refines"]), int(row["n_drops"])
        )

    def chain_lengths(self) -> I64:
        """(n_tiles, n_components) steps that are in the file."""
        key = self.packets["tile"].astype(np.int64) * self.n_components
        lengths = np.bincount(
            key + self.packets["component"], minlength=len(self.tiles) * self.n_components
        )
        return lengths.reshape(len(self.tiles), self.n_components).astype(np.int64)


def n_classes(sh_degree: int) -> int:
    """Quantiser classes (spec 3.2)."""
    return 5 + sh_degree


# --- reading -------------------------------------------------------------------------------------


def read_header(data: memoryview, limits: Mapping[str, int] | None = None) -> layout.Fields:
    """The header's fields (spec 6.1 step 1).

    Raises:
        StreamError: E_TRUNCATED if fewer than 64 bytes are there and they are a signature so far.
    """
    signature = bytes(data[: len(layout.SIGNATURE)])
    if signature != layout.SIGNATURE[: len(signature)]:
        raise StreamError(Fault.E_SIGNATURE, "this is not an EvoGS stream", 0)
    fields = layout.parse(layout.FILE_HEADER, data, 0)
    if fields["version_major"] != layout.VERSION[0]:
        raise StreamError(Fault.E_VERSION, f"major version {fields['version_major']}", 0)
    _check_crc(zlib.crc32(data[: HEADER_SIZE - 4]), fields["crc"], 0)
    if fields["flags"] >> 8 or any(fields["reserved"]):
        raise StreamError(Fault.E_RESERVED, "a reserved bit of the header is set", 0)
    exponents = fields["grid_exponents"]
    for name, valid in (
        ("tier", 1 <= fields["tier"] <= 3),
        ("sh_degree", fields["sh_degree"] <= MAX_SH_DEGREE),
        ("n_levels", fields["n_levels"] >= 1),
        ("grid_exponents", all(-16 <= exponent <= 40 for exponent in exponents)),
    ):
        if not valid:
            raise StreamError(Fault.E_HEADER, f"{name} {fields[name]}", 0)
    for name in ("n_levels", "n_tiles", "n_packets", "chunks_size"):
        check_limit(name, fields[name], fields["tier"], limits, 0)
    return fields


def check_limit(
    name: str, value: int, tier: int, limits: Mapping[str, int] | None, offset: int
) -> None:
    """E_TIER over the limit of the stream's tier, E_LIMIT over the decoder's own (spec 8)."""
    if value > LIMITS[name][tier - 1]:
        raise StreamError(Fault.E_TIER, f"{name} {value} exceeds tier {tier}", offset)
    if limits and value > limits.get(name, value):
        raise StreamError(Fault.E_LIMIT, f"{name} {value} exceeds {limits[name]}", offset)


def read_directory(data: memoryview, limits: Mapping[str, int] | None = None) -> Directory:
    """Header and chunks of a stream, all checked (spec 6.1 steps 1 to 3).

    Args:
        data: at least the header and the chunks.
        limits: the decoder's own limits by name (spec 8.3).

    Raises:
        StreamError: with any fault of these steps.
    """
    header = read_header(data, limits)
    end = HEADER_SIZE + header["chunks_size"]
    if len(data) < end:
        raise StreamError(
            Fault.E_TRUNCATED,
            f"{len(data) - HEADER_SIZE} bytes of {header['chunks_size']} of chunks are there",
            HEADER_SIZE,
        )
    chunks, copied = _read_chunks(data[HEADER_SIZE:end])
    sh_degree, n_levels, tier = header["sh_degree"], header["n_levels"], header["tier"]
    quantisers = _read_steps(*chunks[b"STEP"], n_levels, n_classes(sh_degree))
    alpha = _read_alpha(*chunks[b"ALFA"], n_levels) if b"ALFA" in chunks else {}
    tiles = _read_tiles(*chunks[b"TILE"], header["n_tiles"])
    packets, steps = _read_packets(*chunks[b"PACK"], header, limits)
    sizes = packets["size"].astype(np.int64)
    if int(sizes.sum()) != header["data_size"]:  # R-5.1-8
        raise StreamError(
            Fault.E_HEADER, f"data_size {header['data_size']}, packets sum to {sizes.sum()}", 0
        )
    digests = _read_digests(*chunks[b"dGST"], packets, steps) if b"dGST" in chunks else {}
    text = _read_meta(*chunks[b"mETa"]) if b"mETa" in chunks else {}
    return Directory(
        tier=tier,
        sh_degree=sh_degree,
        n_levels=n_levels,
        grid_exponents=tuple(header["grid_exponents"]),
        info=SceneInfo(
            coordinate_system=header["coordinate_system"],
            up_axis=header["up_axis"],
            unit=header["unit"],
            colour_space=header["colour_space"],
            antialiased=bool(header["flags"] & FLAG_ANTIALIASED),
            text=text,
        ),
        quantisers=quantisers,
        alpha=alpha,
        tiles=tiles,
        packets=packets,
        steps=steps,
        offsets=end + np.cumsum(sizes) - sizes,
        digests=digests,
        digests_offset=chunks[b"dGST"][1] if b"dGST" in chunks else 0,
        copied_chunks=copied,
        version_minor=header["version_minor"],
        unused_flags=header["flags"] & ~FLAG_ANTIALIASED,
        data_offset=end,
        size=end + header["data_size"],
    )


def _check_crc(computed: int, stored: int, offset: int) -> None:
    if computed != stored:
        raise StreamError(Fault.E_CRC, f"CRC-32 {computed:#010x}, stored {stored:#010x}", offset)


def _read_chunks(area: memoryview) -> tuple[dict[bytes, tuple[memoryview, int]], bytes]:
    """{type: (body, offset)} of the known chunks; the unknown ones to copy."""
    chunks: dict[bytes, tuple[memoryview, int]] = {}
    copied = bytearray()
    at = 0
    while at < len(area):
        offset = HEADER_SIZE + at
        if len(area) - at < CHUNK_HEADER_SIZE:  # R-5.2-1
            raise StreamError(Fault.E_CHUNK, "a chunk header is cut short", offset)
        fields = layout.parse(layout.CHUNK_HEADER, area[at:], offset)
        kind = fields["type"]
        begin = at + CHUNK_HEADER_SIZE
        if len(area) - begin < fields["size"]:
            raise StreamError(Fault.E_CHUNK, "a chunk reaches past the chunks", offset)
        end = begin + fields["size"]
        _check_crc(
            zlib.crc32(area[begin:end], zlib.crc32(area[at : at + 8])), fields["crc"], offset
        )
        name = kind.decode("latin-1")
        if not (kind.isalpha() and kind[2:3].isupper()):  # R-5.2-2
            raise StreamError(Fault.E_CHUNK, f"chunk type {name!r}", offset)
        if kind in chunks or (
            kind in CRITICAL and any(later in chunks for later in _after(kind))
        ):  # R-5.2-3, R-5.2-4
            raise StreamError(Fault.E_CHUNK, f"chunk {name} is repeated or out of order", offset)
        if kind in CRITICAL or kind in ANCILLARY:
            chunks[kind] = (area[begin:end], offset)
        elif kind[:1].isupper():  # R-8.1-1
            raise StreamError(Fault.E_UNSUPPORTED, f"critical chunk {name}", offset)
        elif kind[3:].islower():  # R-8.1-3
            copied += area[at:end]
        at = end
    for kind in (b"STEP", b"TILE", b"PACK"):
        if kind not in chunks:
            raise StreamError(Fault.E_CHUNK, f"chunk {kind.decode()} is missing", HEADER_SIZE)
    return chunks, bytes(copied)


def _after(kind: bytes) -> tuple[bytes, ...]:
    return CRITICAL[CRITICAL.index(kind) + 1 :]


def _rows(
    struct: layout.Struct, body: memoryview, offset: int, n: int | None
) -> npt.NDArray[np.void]:
    """The rows of a chunk; their number follows from the size if `n` is None (R-5.2-5)."""
    size = layout.size_of(struct)
    if len(body) % size if n is None else len(body) != n * size:
        raise StreamError(
            Fault.E_CHUNK, f"{len(body)} bytes do not make the rows of {size} bytes", offset
        )
    return layout.read_table(struct, body)


def _read_steps(
    body: memoryview, offset: int, n_levels: int, classes: int
) -> tuple[tuple[Quantiser, ...], ...]:
    rows = _rows(layout.STEP_ENTRY, body, offset, (1 + n_levels) * classes)
    if rows.size and (rows["mantissa"].min() < 1 or rows["shift"].max() > 24):
        raise StreamError(Fault.E_STEP, "a mantissa is 0 or a shift exceeds 24", offset)
    flat = [Quantiser(int(row["mantissa"]), int(row["shift"])) for row in rows]
    return tuple(tuple(flat[k : k + classes]) for k in range(0, len(flat), classes))


def _read_alpha(body: memoryview, offset: int, n_levels: int) -> dict[tuple[int, int], AlphaTable]:
    tables: dict[tuple[int, int], AlphaTable] = {}
    fixed = layout.size_of(layout.ALPHA_TABLE)
    at, last = 0, (-1, -1)
    while at < len(body):
        if len(body) - at < fixed:
            raise StreamError(Fault.E_CHUNK, "an alpha table is cut short", offset)
        fields = layout.parse(layout.ALPHA_TABLE, body[at:], offset)
        key = (fields["level"], fields["group"])
        if key[0] >= n_levels or key[1] >= N_GROUPS or fields["shift"] > 12 or key <= last:
            raise StreamError(Fault.E_ALPHA, f"alpha table of (level, group) {key}", offset)
        at += fixed
        size = 2 * (fields["last"] + 1)
        if len(body) - at < size:
            raise StreamError(Fault.E_CHUNK, "an alpha table is cut short", offset)
        entries = np.frombuffer(body[at : at + size], "<i2")
        tables[key] = AlphaTable(fields["shift"], tuple(int(a) for a in entries))
        at, last = at + size, key
    return tables


def _read_tiles(body: memoryview, offset: int, n_tiles: int) -> npt.NDArray[np.void]:
    tiles = _rows(layout.TILE_ENTRY, body, offset, n_tiles)
    low, high = tiles["box_min"], tiles["box_max"]
    bad = (tiles["origin"] < -MAX_ORIGIN) | (tiles["origin"] > MAX_ORIGIN)
    bad |= (low < -MAX_X) | (high > MAX_X) | (low > high)
    if bad.any():
        row = int(np.flatnonzero(bad.any(1))[0])
        raise StreamError(Fault.E_TILE, f"origin or box of tile {row}", offset)
    return tiles


def _read_packets(
    body: memoryview, offset: int, header: layout.Fields, limits: Mapping[str, int] | None
) -> tuple[npt.NDArray[np.void], I64]:
    """Rows of the packet table and their steps; the first faulty row decides (spec 6.1)."""
    rows = _rows(layout.PACKET_ENTRY, body, offset, header["n_packets"])
    table = _PacketTable(rows, header)
    worst: tuple[int, int, Fault, str] | None = None
    for order, (fault, bad, detail) in enumerate(table.checks(limits)):
        if bad.any():
            row = int(np.argmax(bad))
            if worst is None or (row, order) < worst[:2]:
                worst = (row, order, fault, detail)
    if worst is not None:
        raise StreamError(worst[2], f"packet {worst[0]}: {worst[3]}", offset)
    return rows, table.step


class _PacketTable:
    """Columns of the packet table and the checks of spec 5.6.

    A column that needs earlier rows is right up to and including the first faulty row, which is all
    that is asked of it.
    """

    def __init__(self, rows: npt.NDArray[np.void], header: layout.Fields) -> None:
        self.rows = rows
        self.header = header
        self.is_core = rows["component"] == 0
        self.tile = rows["tile"].astype(np.int64)
        chain = self.tile * 256 + rows["component"]
        self.step = _running(chain, np.ones(len(rows), np.int64))
        self.counts = {
            name: rows[name].astype(np.int64)
            for name in ("n_adds", "n_splits", "n_refines", "n_drops")
        }

    def checks(
        self, limits: Mapping[str, int] | None
    ) -> Iterator[tuple[Fault, npt.NDArray[np.bool_], str]]:
        """(fault, bad rows, detail), in the order of the ids within a row."""
        rows, header, core, tile = self.rows, self.header, self.is_core, self.tile
        adds, splits = self.counts["n_adds"], self.counts["n_splits"]
        size, level = rows["size"].astype(np.int64), rows["level"].astype(np.int64)
        n_records = splits + self.counts["n_refines"] + self.counts["n_drops"]
        some = (n_records + adds) > 0
        yield Fault.E_RESERVED, rows["reserved"] != 0, "a reserved byte is set"
        unknown = (tile >= header["n_tiles"]) | (rows["component"] > header["sh_degree"])
        yield Fault.E_CHAIN, unknown, "no such tile or component"
        early = ~core & (self.step >= _running(tile, core.astype(np.int64)))
        yield Fault.E_CHAIN, early, "the packet is before the core packet it requires"
        falls = core & ((level >= header["n_levels"]) | (level < _previous(tile, core, level)))
        yield Fault.E_CHAIN, falls, "the level is too large or falls"
        yield Fault.E_COUNT, ~core & (some | (level > 0)), "level or counts beside core"
        yield Fault.E_COUNT, core & (some != (size > 0)), "size and counts contradict each other"
        live = _running(tile, adds - self.counts["n_drops"] + splits)
        yield Fault.E_COUNT, n_records > live, "more records than live splats"
        many = adds + splits > MAX_NEW_PER_BYTE * size
        yield Fault.E_AMPLIFICATION, many, "too many new slots for its size"
        yield Fault.E_CRC, (size == 0) & (rows["crc"] != 0), "the CRC-32 of no bytes is 0"
        new = adds + splits
        columns = {
            "tile_steps": self.step + 1,
            "tile_slots": _running(tile, new) + new,
            "slots": np.cumsum(new),
        }
        for name, column in columns.items():
            limit = LIMITS[name][header["tier"] - 1]
            yield Fault.E_TIER, column > limit, f"{name} exceeds the limit of the tier"
            own = limit if limits is None else limits.get(name, limit)
            yield Fault.E_LIMIT, column > own, f"{name} exceeds the limit {own}"


def _running(key: I64, values: I64) -> I64:
    """Sum of `values` over the earlier rows with the same key."""
    order = np.argsort(key, kind="stable")
    sums = np.cumsum(values[order]) - values[order]
    sorted_key = key[order]
    first = np.ones(len(key), bool)
    first[1:] = sorted_key[1:] != sorted_key[:-1]
    base = sums[first][np.cumsum(first) - 1] if len(key) else sums
    out = np.empty_like(sums)
    out[order] = sums - base
    return out


def _previous(tile: I64, core: npt.NDArray[np.bool_], level: I64) -> I64:
    """Level of the core row before, in the same tile; 0 for the first."""
    rows = np.flatnonzero(core)
    order = rows[np.argsort(tile[rows], kind="stable")]
    out = np.zeros(len(tile), np.int64)
    same = tile[order][1:] == tile[order][:-1]
    out[order[1:][same]] = level[order[:-1][same]]
    return out


def _read_digests(
    body: memoryview, offset: int, packets: npt.NDArray[np.void], steps: I64
) -> dict[tuple[int, int, int], bytes]:
    rows = _rows(layout.DIGEST_ENTRY, body, offset, None)
    present = set(
        zip(packets["tile"].tolist(), packets["component"].tolist(), steps.tolist(), strict=True)
    )
    digests: dict[tuple[int, int, int], bytes] = {}
    last = (-1, -1, -1)
    for row in rows:
        key = (int(row["tile"]), int(row["component"]), int(row["step"]))
        if key <= last or key not in present:  # R-5.7-1, R-5.7-2
            raise StreamError(Fault.E_CHUNK, f"digest of (tile, component, step) {key}", offset)
        digests[key] = row["digest"].tobytes()
        last = key
    return digests


def _read_meta(body: memoryview, offset: int) -> dict[str, str]:
    text: dict[str, str] = {}
    fixed = layout.size_of(layout.META_ENTRY)
    at, last = 0, b""
    while at < len(body):
        if len(body) - at < fixed:
            raise StreamError(Fault.E_META, "an entry reaches past the chunk", offset)
        fields = layout.parse(layout.META_ENTRY, body[at:], offset)
        split = at + fixed + fields["key_size"]
        end = split + fields["value_size"]
        if end > len(body):
            raise StreamError(Fault.E_META, "an entry reaches past the chunk", offset)
        key = bytes(body[at + fixed : split])
        if not _KEY.match(key) or key <= last:
            raise StreamError(Fault.E_META, "a key is not valid or out of order", offset)
        try:
            text[key.decode("ascii")] = bytes(body[split:end]).decode("utf-8")
        except UnicodeDecodeError:
            raise StreamError(
                Fault.E_META, f"the value of {key.decode('ascii')} is not UTF-8", offset
            ) from None
        at, last = end, key
    return text


# --- writing -------------------------------------------------------------------------------------


def build_directory(
    *,
    sh_degree: int,
    n_levels: int,
    grid_exponents: tuple[int, ...],
    info: SceneInfo,
    quantisers: tuple[tuple[Quantiser, ...], ...],
    alpha: Mapping[tuple[int, int], AlphaTable],
    tiles: npt.NDArray[np.void],
    packets: npt.NDArray[np.void],
    digests: Mapping[tuple[int, int, int], bytes],
    copied_chunks: bytes = b"",
    version_minor: int = layout.VERSION[1],
    unused_flags: int = 0,
) -> bytes:
    """Header and chunks; the inverse of `read_directory`. The tier is the lowest that fits.

    Raises:
        ValueError: the scene exceeds the limits of tier 3, or a metadata key is not valid.
    """
    flat = [quantiser for row in quantisers for quantiser in row]
    bodies = {
        b"STEP": b"".join(
            layout.build(layout.STEP_ENTRY, mantissa=q.mantissa, shift=q.shift) for q in flat
        ),
        b"ALFA": b"".join(_alpha_bytes(*key, table) for key, table in sorted(alpha.items())),
        b"TILE": tiles.tobytes(),
        b"PACK": packets.tobytes(),
        b"dGST": b"".join(
            layout.build(
                layout.DIGEST_ENTRY, tile=tile, component=component, step=step, digest=digest
            )
            for (tile, component, step), digest in sorted(digests.items())
        ),
        b"mETa": _meta_bytes(info.text),
    }
    required = (b"STEP", b"TILE", b"PACK")
    chunks = b"".join(_chunk(k, body) for k, body in bodies.items() if body or k in required)
    chunks += copied_chunks
    fields = {
        "signature": layout.SIGNATURE,
        "version_major": layout.VERSION[0],
        "version_minor": version_minor,
        "tier": _tier(n_levels, tiles, packets, len(chunks)),
        "sh_degree": sh_degree,
        "n_levels": n_levels,
        "grid_exponents": list(grid_exponents),
        "flags": unused_flags | (FLAG_ANTIALIASED if info.antialiased else 0),
        "coordinate_system": info.coordinate_system,
        "up_axis": info.up_axis,
        "unit": info.unit,
        "colour_space": info.colour_space,
        "n_tiles": len(tiles),
        "n_packets": len(packets),
        "chunks_size": len(chunks),
        "data_size": int(packets["size"].astype(np.int64).sum()),
        "reserved": bytes(16),
    }
    head = layout.build(layout.FILE_HEADER, **fields, crc=0)[:-4]
    return head + zlib.crc32(head).to_bytes(4, "little") + chunks


def _chunk(kind: bytes, body: bytes) -> bytes:
    size = len(body).to_bytes(4, "little")
    crc = zlib.crc32(kind + size + body)
    return layout.build(layout.CHUNK_HEADER, type=kind, size=len(body), crc=crc) + body


def _alpha_bytes(level: int, group: int, table: AlphaTable) -> bytes:
    head = layout.build(
        layout.ALPHA_TABLE,
        level=level,
        group=group,
        shift=table.shift,
        last=len(table.entries) - 1,
    )
    return head + np.array(table.entries, "<i2").tobytes()


def _meta_bytes(text: Mapping[str, str]) -> bytes:
    out = b""
    for key, value in sorted(text.items()):
        encoded = value.encode("utf-8")
        if not _KEY.match(key.encode("utf-8")):
            raise ValueError(f"metadata key {key!r}: use 1 to 255 of a-z 0-9 _ . -")
        if len(encoded) > 0xFFFF:
            raise ValueError(f"metadata value of {key} has more than 65535 bytes")
        head = layout.build(layout.META_ENTRY, key_size=len(key), value_size=len(encoded))
        out += head + key.encode("ascii") + encoded
    return out


def _tier(
    n_levels: int, tiles: npt.NDArray[np.void], packets: npt.NDArray[np.void], chunks_size: int
) -> int:
    """The lowest tier whose limits the stream keeps (R-8.2-2)."""
    new = packets["n_adds"].astype(np.int64) + packets["n_splits"]
    core = packets["component"] == 0
    tile = packets["tile"].astype(np.int64)
    per_tile = np.bincount(tile, weights=new, minlength=1)
    steps = np.bincount(tile[core], minlength=1)
    counts = {
        "n_tiles": len(tiles),
        "n_packets": len(packets),
        "n_levels": n_levels,
        "chunks_size": chunks_size,
        "tile_steps": int(steps.max()),
        "tile_slots": int(per_tile.max()),
        "slots": int(new.sum()),
    }
    for tier in (1, 2, 3):
        if all(value <= LIMITS[name][tier - 1] for name, value in counts.items()):
            return tier
    over = [name for name, value in counts.items() if value > LIMITS[name][2]]
    raise ValueError(f"the scene exceeds the limit of tier 3 of {', '.join(over)}: use more tiles")
