"""Header and chunks: all a client needs to plan what to read (spec 5.1, 5.2, 6.1 steps 1 to 3).

The packet table has no offsets and no step numbers: both follow from the order of its rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evogs_codec._generated.limits import LIMITS
from evogs_codec.common.frozen_bytes import frozen
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import layout
from evogs_codec.format.chunks import (
    read_alpha_tables,
    read_digests,
    read_metadata,
    read_quantisers,
    read_tiles,
)
from evogs_codec.format.crc import crc32
from evogs_codec.format.packet_header import FLAG_PALETTE, Counts
from evogs_codec.format.packet_table import labels_of, read_packet_table, state_sizes
from evogs_codec.model.arithmetic import SYMMETRIC, AlphaTable, Quantiser
from evogs_codec.model.channels import MAX_SH_DEGREE, N_GROUPS, n_classes
from evogs_codec.model.components import PALETTE, PICKS, Components
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import I32, I64
from evogs_codec.stores.sources import Source, source_of

__all__ = ["Directory", "check_crc", "read_directory", "read_header", "read_tables"]

HEADER_SIZE = layout.size_of(layout.FILE_HEADER)
CHUNK_HEADER_SIZE = layout.size_of(layout.CHUNK_HEADER)
CRITICAL = (b"QUAN", b"ALFA", b"TILE", b"PACK")  # in this order (R-5.2-3)
ANCILLARY = (b"dGST", b"mETa")
FLAG_ANTIALIASED = 1
RESERVED_FLAGS = 0xFE00
MAX_DIGESTED_PER_BYTE = 4096  # bytes of state per byte of the file (R-5.7-5)
UNKNOWN_ERROR = 0xFFFFFFFF  # of a packet entry (spec 5.6)


@dataclass(frozen=True, eq=False)
class Directory:
    """Header, tables and what follows from them.

    Attributes:
        sh_degree, n_levels, tier, grid_exponents: of the header.
        components: which components the stream has (spec 3.5, 12).
        info: metadata.
        quantisers: [0] of adds, [1 + level] of psi; one per class each.
        alpha: tables by (level, group), as stored; `alpha_tables` has all.
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
    components: Components
    info: SceneInfo
    quantisers: tuple[tuple[Quantiser, ...], ...]
    alpha: Mapping[tuple[int, int], AlphaTable]
    tiles: npt.NDArray[np.void]
    packets: npt.NDArray[np.void]
    steps: I64
    offsets: I64
    digests: Mapping[PacketId, bytes]
    digests_offset: int
    copied_chunks: bytes
    version_minor: int
    unused_flags: int
    data_offset: int
    size: int

    def __repr__(self) -> str:
        return (
            f"Directory({self.size} bytes, {self.n_levels} levels, {len(self.tiles)} tiles,"
            f" {len(self.packets)} packets, SH degree {self.sh_degree})"
        )

    @property
    def has_palette(self) -> bool:
        """SH above band 0 are entries of a palette (spec 12)."""
        return self.components.has_palette

    @cached_property
    def columns(self) -> I64:
        """(n_packets,) column of the component of each packet; -1 of those of the palette."""
        columns: I64 = self.components.columns[self.packets["component"]]
        return columns

    def packet_ids(self, packets: I64 | slice = slice(None)) -> list[PacketId]:
        """What names each of these packets, rows of the table."""
        rows, steps = self.packets[packets], self.steps[packets]
        columns = rows["tile"].tolist(), rows["component"].tolist(), steps.tolist()
        return [PacketId(*numbers) for numbers in zip(*columns, strict=True)]

    @cached_property
    def chain_lengths(self) -> I64:
        """(n_tiles, columns) packets of each chain; not to be written to."""
        lengths = self.packets_per_chain(slice(None))
        lengths.setflags(write=False)
        return lengths

    @cached_property
    def palette_packets(self) -> I64:
        """Rows of the packets of the palette, which belong to no tile."""
        return np.flatnonzero(self.packets["component"] == PALETTE).astype(np.int64)

    @cached_property
    def state_sizes(self) -> I64:
        """(n_packets,) bytes of the state after each packet, as a digest takes it (spec 5.7)."""
        return state_sizes(self.packets, self.steps, self.components)

    @cached_property
    def tile_slots(self) -> I64:
        """(n_tiles,) slots of each tile after all of its steps."""
        rows = self.packets[self.columns >= 0]
        new = rows["n_adds"].astype(np.float64) + rows["n_splits"]
        return np.bincount(rows["tile"], new, len(self.tiles)).astype(np.int64)

    @cached_property
    def n_entries(self) -> int:
        """Entries of the whole palette."""
        return int(self.packets["n_adds"][self.palette_packets].sum(dtype=np.int64))

    @cached_property
    def labels(self) -> I64:
        """(n_packets,) label of the step of each packet; of the palette, level of the entries."""
        labels = labels_of(self.packets, self.steps)
        labels[self.palette_packets] = self.packets["level"][self.palette_packets]
        return labels

    @cached_property
    def palette_required(self) -> I64:
        """(n_packets,) packets of the palette that each packet of picks requires; 0 for others."""
        required = np.zeros(len(self.packets), np.int64)
        palette, picks = self.palette_packets, np.flatnonzero(self.packets["component"] == PICKS)
        of_levels = np.searchsorted(self.labels[palette], self.labels[picks], side="right")
        required[picks] = np.minimum(of_levels, np.searchsorted(palette, picks))
        return required

    @cached_property
    def entries_required(self) -> I64:
        """(n_packets,) entries of these: the largest pick that each packet may have."""
        n_entries = self.packets["n_adds"][self.palette_packets].astype(np.int64)
        return np.concatenate([[0], np.cumsum(n_entries)])[self.palette_required]

    @cached_property
    def quantiser_units(self) -> I64:
        """(1 + n_levels, classes) grid units of one q: of adds, of psi of each level."""
        units = [[quantiser.step for quantiser in row] for row in self.quantisers]
        return np.array(units, np.int64)

    @cached_property
    def alpha_tables(self) -> tuple[tuple[AlphaTable, ...], ...]:
        """The table of each group, for each level (spec 5.4): symmetric where none is stored."""
        return tuple(
            tuple(self.alpha.get((level, group), SYMMETRIC) for group in range(N_GROUPS))
            for level in range(self.n_levels)
        )

    @cached_property
    def alpha_entries(self) -> tuple[I32, I64]:
        """The entries of all alpha tables, one after the other, and where those of each are.

        (n_levels, groups, 4): first entry, number of entries, K, largest |entry|.
        """
        entries: list[int] = []
        places = np.empty((self.n_levels, N_GROUPS, 4), np.int64)
        for level, group in np.ndindex(self.n_levels, N_GROUPS):
            table = self.alpha_tables[level][group]
            largest = max(map(abs, table.entries))
            places[level, group] = len(entries), len(table.entries), table.shift, largest
            entries += table.entries
        return np.array(entries, np.int32), places

    def counts(self, packet: int) -> Counts:
        """Record counts of a packet entry."""
        row = self.packets[packet]
        return Counts(
            int(row["n_adds"]), int(row["n_splits"]), int(row["n_refines"]), int(row["n_drops"])
        )

    def packets_per_chain(self, packets: slice | I64) -> I64:
        """(n_tiles, columns) how many of these packets each chain has.

        The chain of the palette is not among them: it belongs to no tile.
        """
        tiles, columns = self.packets["tile"][packets].astype(np.int64), self.columns[packets]
        shape = (len(self.tiles), len(self.components.of_tiles))
        chain = (tiles * shape[1] + columns)[columns >= 0]
        return np.bincount(chain, minlength=shape[0] * shape[1]).reshape(shape).astype(np.int64)


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
    check_crc(fields["crc"], 0, data[: HEADER_SIZE - 4])
    if fields["flags"] & RESERVED_FLAGS or any(fields["reserved"]):
        raise StreamError(Fault.E_RESERVED, "a reserved bit of the header is set", 0)
    exponents = fields["grid_exponents"]
    for name, valid in (
        ("tier", 1 <= fields["tier"] <= 3),
        ("sh_degree", fields["sh_degree"] <= MAX_SH_DEGREE),
        ("n_levels", fields["n_levels"] >= 1),
        ("grid_exponents", all(-16 <= exponent <= 40 for exponent in exponents)),
        ("flags", not fields["flags"] & FLAG_PALETTE or fields["sh_degree"] > 0),  # R-5.1-9
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


def read_directory(data: Source, limits: Mapping[str, int] | None = None) -> Directory:
    """Header and chunks of a stream, all checked (spec 6.1 steps 1 to 3).

    Args:
        data: at least the header and the chunks; or the path or URL of a file that has them, of
            which a URL is read no further.
        limits: the decoder's own limits by name (spec 8.3).

    Raises:
        StreamError: with any fault of these steps.
        OSError: the file cannot be read.
        TypeError: `data` is neither bytes nor a path.
    """
    source = source_of(data)
    head = frozen(source.having([(0, HEADER_SIZE)])[:HEADER_SIZE])
    header = read_header(head, limits)
    view = source.having([(0, HEADER_SIZE + header["chunks_size"])])
    return read_tables(header, view, limits)


def read_tables(
    header: layout.Fields, data: memoryview, limits: Mapping[str, int] | None = None
) -> Directory:
    """What `read_directory` reads after `header`, which is at the begin of `data`."""
    end = HEADER_SIZE + header["chunks_size"]
    if len(data) < end:
        raise StreamError(
            Fault.E_TRUNCATED,
            f"{len(data) - HEADER_SIZE} bytes of {header['chunks_size']} of chunks are there",
            HEADER_SIZE,
        )
    chunks, copied = _read_chunks(frozen(data[HEADER_SIZE:end]))
    sh_degree, n_levels, tier = header["sh_degree"], header["n_levels"], header["tier"]
    components = Components(sh_degree, bool(header["flags"] & FLAG_PALETTE))
    quantisers = read_quantisers(*chunks[b"QUAN"], n_levels, n_classes(sh_degree))
    alpha = read_alpha_tables(*chunks[b"ALFA"], n_levels) if b"ALFA" in chunks else {}
    tiles = read_tiles(*chunks[b"TILE"], header["n_tiles"])
    packets, steps = read_packet_table(*chunks[b"PACK"], header, components, limits)
    sizes = packets["size"].astype(np.int64)
    if int(sizes.sum()) != header["data_size"]:  # R-5.1-8
        raise StreamError(
            Fault.E_HEADER, f"data_size {header['data_size']}, packets sum to {sizes.sum()}", 0
        )
    digests = {}
    if b"dGST" in chunks:
        states = state_sizes(packets, steps, components)
        most = MAX_DIGESTED_PER_BYTE * (end + header["data_size"])
        digests = read_digests(*chunks[b"dGST"], packets, steps, states, most)
    text = read_metadata(*chunks[b"mETa"]) if b"mETa" in chunks else {}
    return Directory(
        tier=tier,
        sh_degree=sh_degree,
        n_levels=n_levels,
        grid_exponents=tuple(header["grid_exponents"]),
        components=components,
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
        unused_flags=header["flags"] & ~(FLAG_ANTIALIASED | FLAG_PALETTE),
        data_offset=end,
        size=end + header["data_size"],
    )


def check_crc(stored: int, offset: int, *covered: bytes | memoryview) -> None:
    """Raise E_CRC unless `stored` is the CRC-32 of what it covers (R-6.3-1)."""
    computed = 0
    for part in covered:
        computed = crc32(part, computed)
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
        check_crc(fields["crc"], offset, area[at : at + 8], area[begin:end])
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
    for kind in (b"QUAN", b"TILE", b"PACK"):
        if kind not in chunks:
            raise StreamError(Fault.E_CHUNK, f"chunk {kind.decode()} is missing", HEADER_SIZE)
    return chunks, bytes(copied)


def _after(kind: bytes) -> tuple[bytes, ...]:
    return CRITICAL[CRITICAL.index(kind) + 1 :]
