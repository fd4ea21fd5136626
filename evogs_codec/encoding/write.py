"""Writing: the integers of a `CodedTree` to the bytes of a stream, and nothing else.

CodedTree -> packets -> their order -> rows of the packet table -> directory with digests
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from evogs_codec.common.parallel import parallel_map
from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import replay
from evogs_codec.encoding.packet_order import packet_order
from evogs_codec.encoding.palette_parts import in_parts, palette_packets
from evogs_codec.format import layout
from evogs_codec.format.directory import UNKNOWN_ERROR, Directory, read_directory
from evogs_codec.format.pack import pack, pack_entries, pack_picks
from evogs_codec.format.write_directory import build_directory
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.coded_tree import CodedStep, CodedTree
from evogs_codec.model.components import PALETTE, PICKS, component_slice
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.tree import Kind

__all__ = ["packed_palette", "palette_rows", "write"]


def write(
    tree: CodedTree,
    *,
    zstd_level: int = 19,
    digests: bool = True,
    order: Sequence[PacketId] | None = None,
    progress: Progress | None = None,
) -> bytes:
    """The stream of a coded tree; `decode` gives back exactly its integers.

    Args:
        tree: integers.
        zstd_level: level of Zstandard.
        digests: store a digest of the last state of each tile and component.
        order: of all packets; None: that of `packet_order`.
        progress: called while packets are compressed and verified.

    Raises:
        ValueError: an integer needs more than 24 bits, a limit of the format is exceeded, or the
            packets of `order` are others.
    """
    report = progress or no_progress
    bodies = _bodies(tree, zstd_level, report)
    if tree.entries is not None:
        tree, of_palette = packed_palette(tree, _sizes(bodies), zstd_level)
        bodies |= of_palette
    if order is None:
        order = packet_order(tree, _sizes(bodies))
    elif sorted(order) != sorted(bodies):
        raise ValueError(f"an order of {len(order)} packets is none of the {len(bodies)} there are")
    rows = _rows(tree, order, bodies)
    data = b"".join(bodies[packet] for packet in order)
    head = _directory(tree, rows, {})
    if not digests:
        return head + data
    report("verify", 0.0)
    # What is digested is what a decoder decodes from these bytes, so every encode is checked.
    found = final_digests(read_directory(head), head + data)
    return _directory(tree, rows, found) + data


def packed_palette(
    tree: CodedTree, sizes: Mapping[PacketId, int], zstd_level: int
) -> tuple[CodedTree, dict[PacketId, bytes]]:
    """The tree with its palette in parts, and the bytes of these.

    Args:
        tree: with entries.
        sizes: bytes of each packet of its tiles.
        zstd_level: level of Zstandard.
    """

    def packed(tree: CodedTree) -> dict[PacketId, bytes]:
        packets = palette_packets(tree)
        bodies = parallel_map(lambda packet: _body(tree, packet, zstd_level), packets)
        return dict(zip(packets, bodies, strict=True))

    whole = packed(tree)
    divided = in_parts(tree, {**sizes, **_sizes(whole)})
    return divided, whole if divided is tree else packed(divided)


def palette_rows(tree: CodedTree, bodies: Mapping[PacketId, bytes]) -> npt.NDArray[np.void]:
    """The rows of the packets of the palette, in the order of their numbers."""
    return _rows(tree, palette_packets(tree), bodies)


def final_digests(directory: Directory, stream: bytes) -> dict[PacketId, bytes]:
    """Digests of the last state of each tile and component, and of the palette (spec 5.7)."""
    decoded = replay(directory, memoryview(stream), Cut.full(directory))
    digests = {
        PacketId(tile, component, n - 1): decoded.tiles[tile].digest(component)
        for tile, row in enumerate(decoded.cut.steps.tolist())
        for component, n in zip(directory.components.of_tiles, row, strict=True)
        if n
    }
    palette = decoded.tiles[0].palette if directory.n_entries else None
    if palette is not None:
        digests[PacketId(0, PALETTE, palette.n_applied - 1)] = palette.digest()
    return digests


def _bodies(tree: CodedTree, zstd_level: int, report: Progress) -> dict[PacketId, bytes]:
    """The bytes of every packet."""
    packets = [
        PacketId(tile, component, step)
        for tile, own in enumerate(tree.tiles)
        for step in range(len(own.steps))
        for component in tree.components.of_tiles
    ]
    bodies: dict[PacketId, bytes] = {}
    packed = parallel_map(lambda packet: _body(tree, packet, zstd_level), packets)
    for number, (packet, body) in enumerate(zip(packets, packed, strict=True)):
        report("pack", number / len(packets))
        bodies[packet] = body
    return bodies


def _sizes(bodies: Mapping[PacketId, bytes]) -> dict[PacketId, int]:
    return {packet: len(body) for packet, body in bodies.items()}


def _body(tree: CodedTree, packet: PacketId, zstd_level: int) -> bytes:
    """The bytes of a packet (spec 5.9)."""
    tile, component, number = packet
    if component == PALETTE and tree.entries is not None:
        return pack_entries(tree.entries[:, tree.palette_rows[number]], zstd_level=zstd_level)
    step = tree.tiles[tile].steps[number]
    if component == PICKS:
        return pack_picks(step.picks, step.changed_picks, zstd_level=zstd_level)
    part = component_slice(component)
    alpha = [
        step.alpha[group] if len(tree.alpha_table(step.level, group).entries) > 1 else None
        for group in range(N_GROUPS)
    ]
    psi, adds = step.psi[part], step.adds[part]
    siblings = [c - part.start for c in step.siblings if part.start <= c < part.stop]
    return pack(
        component,
        step.slots,
        step.kinds,
        alpha,
        psi,
        adds,
        siblings=siblings,
        zstd_level=zstd_level,
    )


def _rows(
    tree: CodedTree, order: Sequence[PacketId], bodies: Mapping[PacketId, bytes]
) -> npt.NDArray[np.void]:
    """The packet table (spec 5.6), in this order."""
    rows = np.zeros(len(order), layout.dtype_of(layout.PACKET_ENTRY))
    for row, packet in zip(rows, order, strict=True):
        body = bodies[packet]
        if packet.component == PALETTE:
            fields = _palette_fields(tree, packet.step)
        else:
            column = int(tree.components.columns[packet.component])
            fields = _step_fields(tree.tiles[packet.tile].steps[packet.step], column)
        for name, value in fields.items():
            row[name] = value
        row["tile"], row["component"] = packet.tile, packet.component
        row["size"], row["crc"] = len(body), zlib.crc32(body)
    return rows


def _palette_fields(tree: CodedTree, number: int) -> dict[str, int]:
    """The fields of the row of a packet of the palette."""
    rows, level = tree.palette_rows[number], tree.palette_levels[number]
    return {"level": level, "n_adds": rows.stop - rows.start, "error": UNKNOWN_ERROR}


def _step_fields(step: CodedStep, column: int) -> dict[str, int]:
    """The fields of a row that follow from its step."""
    error = step.error[column] if step.error else UNKNOWN_ERROR
    if column:
        return {"error": error}
    n_splits = int(np.count_nonzero(step.kinds == Kind.SPLIT))
    n_refines = int(np.count_nonzero(step.kinds == Kind.REFINE))
    return {
        "level": step.level,
        "n_adds": step.adds.shape[1],
        "n_splits": n_splits,
        "n_refines": n_refines,
        "n_drops": len(step.slots) - n_splits - n_refines,
        "error": error,
    }


def _directory(
    tree: CodedTree, rows: npt.NDArray[np.void], digests: Mapping[PacketId, bytes]
) -> bytes:
    """Header and chunks (spec 5)."""
    tiles = np.zeros(len(tree.tiles), layout.dtype_of(layout.TILE_ENTRY))
    for row, own in zip(tiles, tree.tiles, strict=True):
        row["origin"], row["box_min"], row["box_max"] = own.origin, own.box_min, own.box_max
    return build_directory(
        sh_degree=tree.sh_degree,
        n_levels=tree.n_levels,
        grid_exponents=tree.grid_exponents,
        info=tree.info,
        quantisers=tree.quantisers,
        alpha=tree.alpha,
        tiles=tiles,
        packets=rows,
        digests=digests,
        has_palette=tree.components.has_palette,
    )
