"""Merging: the streams of tiles become one, packet by packet, and no packet is encoded again.

Only the entries of a palette are packed here: they are of all tiles.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from evogs_codec.decoding.palette_state import PaletteState
from evogs_codec.encoding.packet_order import TileGains, order_of_tiles, order_with_palette
from evogs_codec.encoding.palette_parts import palette_packets
from evogs_codec.encoding.write import packed_palette, palette_rows
from evogs_codec.format import layout
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.write_directory import build_directory
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.picks import Entries, numbered_of, rows_of_picks
from evogs_codec.jobs.scratch_files import arrays_of, of_scratch
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.components import CORE, PALETTE, PICKS
from evogs_codec.model.packet_id import PacketId

__all__ = ["merge"]


def merge(parts: Sequence[Path], out: Path, entries: Entries | None = None) -> None:
    """Write the stream of tiles, each of which is a stream with the same header and tables.

    Args:
        parts: streams of one tile each, with gains beside them (`tile_job`); where there are
            entries, of core alone, with picks beside them (`number_picks`).
        out: the file to make or replace.
        entries: of a palette.

    Raises:
        ValueError: the scene exceeds the limits of the format.
        OSError: the file cannot be written.
    """
    directories = [_directory(part) for part in parts]
    first = directories[0]
    gains = [
        _gains(part, own, has_picks=entries is not None)
        for part, own in zip(parts, directories, strict=True)
    ]
    packets = _Packets()
    for number, (part, directory) in enumerate(zip(parts, directories, strict=True)):
        packets.take(number, part, directory)
        if entries is not None:
            packets.take_picks(number, numbered_of(part))
    palette, sh_degree, quantisers = None, first.sh_degree, first.quantisers
    if entries is None:
        order = order_of_tiles(gains, first.components.of_tiles, packets.sizes)
    else:
        palette, bodies = packed_palette(entries.tree, packets.sizes, entries.zstd_level)
        packets.take_palette(palette, bodies)
        order = order_with_palette(gains, palette, packets.sizes, _showing(gains, palette))
        sh_degree, quantisers = palette.sh_degree, palette.quantisers
    rows = np.concatenate([packets.rows[packet] for packet in order])
    rows["tile"] = [packet.tile for packet in order]

    def head() -> bytes:
        return build_directory(
            sh_degree=sh_degree,
            n_levels=first.n_levels,
            grid_exponents=first.grid_exponents,
            info=first.info,
            quantisers=quantisers,
            alpha=first.alpha,
            tiles=np.concatenate([directory.tiles for directory in directories]),
            packets=rows,
            digests=packets.digests,
            has_palette=palette is not None,
        )

    if palette is not None:
        packets.digest_palette(read_directory(head()))
    begin = head()

    def fill(out: BinaryIO) -> None:
        out.write(begin)
        for packet in order:
            out.write(packets.body(packet))

    write_atomic(out, fill)


@dataclass
class _Packets:
    """The packets of a stream: rows of the packet table, where their bytes are, and digests."""

    rows: dict[PacketId, npt.NDArray[np.void]] = field(default_factory=dict)
    sizes: dict[PacketId, int] = field(default_factory=dict)
    places: dict[PacketId, tuple[Path, int]] = field(default_factory=dict)
    bodies: dict[PacketId, bytes] = field(default_factory=dict)  # of the palette
    digests: dict[PacketId, bytes] = field(default_factory=dict)

    def take(self, number: int, part: Path, directory: Directory) -> None:
        """Those of the stream of a tile."""
        for k in range(len(directory.packets)):
            row = directory.packets[k : k + 1]
            packet = PacketId(number, int(row["component"][0]), int(directory.steps[k]))
            self._add(packet, row)
            self.places[packet] = part, int(directory.offsets[k])
        for (_, component, step), digest in directory.digests.items():
            self.digests[PacketId(number, component, step)] = digest

    def take_picks(self, number: int, path: Path) -> None:
        """Those of the picks of a tile."""
        with arrays_of(rows_of_picks(path)) as found:
            sizes, errors, crcs = found["sizes"], found["errors"], found["crcs"]
            digest = found["digest"].tobytes()
        offsets = np.cumsum(sizes) - sizes
        rows = np.zeros(len(sizes), layout.dtype_of(layout.PACKET_ENTRY))
        rows["component"], rows["size"], rows["error"], rows["crc"] = PICKS, sizes, errors, crcs
        for k, offset in enumerate(offsets.tolist()):
            packet = PacketId(number, PICKS, k)
            self._add(packet, rows[k : k + 1])
            self.places[packet] = path, offset
        self.digests[PacketId(number, PICKS, len(sizes) - 1)] = digest

    def take_palette(self, tree: CodedTree, bodies: dict[PacketId, bytes]) -> None:
        """Those of the palette."""
        self.bodies = bodies
        rows = palette_rows(tree, bodies)
        for k, packet in enumerate(palette_packets(tree)):
            self._add(packet, rows[k : k + 1])

    def digest_palette(self, directory: Directory) -> None:
        """Add the digest of the palette as a decoder has it."""
        state = PaletteState(directory, directory.n_entries)
        for packet in directory.palette_packets.tolist():
            number = PacketId(0, PALETTE, int(directory.steps[packet]))
            state.apply(packet, memoryview(self.bodies[number]))
        if state.n_applied:
            self.digests[PacketId(0, PALETTE, state.n_applied - 1)] = state.digest()

    def body(self, packet: PacketId) -> bytes:
        """The bytes of a packet."""
        if packet.component == PALETTE:
            return self.bodies[packet]
        path, offset = self.places[packet]
        with path.open("rb") as part:  # a process may have fewer open files than a scene has tiles
            part.seek(offset)
            data = part.read(self.sizes[packet])
        with of_scratch(path):
            if zlib.crc32(data) != int(self.rows[packet]["crc"][0]):
                raise ValueError("another CRC")
        return data

    def _add(self, packet: PacketId, row: npt.NDArray[np.void]) -> None:
        self.rows[packet], self.sizes[packet] = row, int(row["size"][0])


def _directory(part: Path) -> Directory:
    with of_scratch(part):
        return read_directory(np.memmap(part, np.uint8, "r").data)


def _gains(part: Path, directory: Directory, *, has_picks: bool) -> TileGains:
    with arrays_of(Path(f"{part}.gains")) as array:
        found = array
    of_core = directory.packets["component"] == CORE
    order = np.argsort(directory.steps[of_core], kind="stable")
    levels = directory.packets["level"][of_core][order]
    n_entries = None
    if has_picks:
        with arrays_of(rows_of_picks(numbered_of(part))) as rows:
            n_entries = rows["highest"]
    return TileGains(int(found[0, 0]), found[1:], levels.tolist(), n_entries)


def _showing(gains: Sequence[TileGains], palette: CodedTree) -> set[PacketId] | None:
    """Packets of tiles that gain something, where the palette is in parts."""
    if not palette.palette_ends:
        return None
    components = palette.components.of_tiles
    return {
        PacketId(number, components[column], k)
        for number, tile in enumerate(gains)
        for k, column in np.argwhere(tile.steps > 0).tolist()
    }
