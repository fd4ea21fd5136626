"""Merging: the streams of tiles become one, packet by packet, and no packet is encoded again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from evogs_codec.encoding.packet_order import TileGains, order_of_tiles
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.write_directory import build_directory
from evogs_codec.io.files import write_atomic
from evogs_codec.model.packet_id import PacketId

__all__ = ["merge"]

READ_AHEAD = 1 << 16  # bytes of a part that are read for its directory, at first


def merge(parts: Sequence[Path], out: Path) -> None:
    """Write the stream of tiles, each of which is a stream with the same header and tables.

    Args:
        parts: streams of one tile each, with gains beside them (`tile_job`).
        out: the file to make or replace.

    Raises:
        ValueError: the scene exceeds the limits of the format.
        OSError: the file cannot be written.
    """
    directories = [_directory(part) for part in parts]
    first = directories[0]
    components = first.components.of_tiles
    sizes, places, rows, digests = {}, {}, {}, {}
    for number, directory in enumerate(directories):
        for k, row in enumerate(directory.packets):
            packet = PacketId(number, int(row["component"]), int(directory.steps[k]))
            sizes[packet], rows[packet] = int(row["size"]), (number, k)
            places[packet] = int(directory.offsets[k])
        for (_, component, step), digest in directory.digests.items():
            digests[PacketId(number, component, step)] = digest
    order = order_of_tiles([_gains(part) for part in parts], components, sizes)
    packets = np.concatenate(
        [directories[number].packets[k : k + 1] for number, k in (rows[p] for p in order)]
    )
    packets["tile"] = [packet.tile for packet in order]
    head = build_directory(
        sh_degree=first.sh_degree,
        n_levels=first.n_levels,
        grid_exponents=first.grid_exponents,
        info=first.info,
        quantisers=first.quantisers,
        alpha=first.alpha,
        tiles=np.concatenate([directory.tiles for directory in directories]),
        packets=packets,
        digests=digests,
    )

    def fill(out: BinaryIO) -> None:
        out.write(head)
        for packet in order:  # a system lets a process have fewer open files than a scene has tiles
            with parts[packet.tile].open("rb") as part:
                part.seek(places[packet])
                out.write(part.read(sizes[packet]))

    write_atomic(out, fill)


def _directory(part: Path) -> Directory:
    return read_directory(np.memmap(part, np.uint8, "r").data)


def _gains(part: Path) -> TileGains:
    found = np.load(f"{part}.gains")
    return TileGains(int(found[0, 0]), found[1:])
