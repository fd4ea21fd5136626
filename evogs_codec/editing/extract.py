"""Extraction: a smaller valid stream by moving packets, without decoding (spec 10)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.decoding.byte_ranges import packet_ranges
from evogs_codec.decoding.cut import Cut, tiles_meeting
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format.directory import (
    CHUNK_HEADER_SIZE,
    MAX_DIGESTED_PER_BYTE,
    Directory,
    read_directory,
)
from evogs_codec.format.layout import DIGEST_ENTRY, PACKET_ENTRY, size_of
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I64
from evogs_codec.stores.sources import Source, source_of

__all__ = ["choose_cut", "extract", "extract_tiles"]

Box = Sequence[float]
Kept = npt.NDArray[np.bool_]


def choose_cut(
    directory: Directory,
    *,
    level: int | None = None,
    sh_degree: int | None = None,
    box: Box | None = None,
    max_bytes: int | None = None,
) -> Cut:
    """The cut that the options of `evogs decode` and `evogs extract` name.

    Args:
        directory: of the stream.
        level: no steps above this level.
        sh_degree: no SH bands above this one; of a palette all, or nothing for 0.
        box: only tiles that meet x0 y0 z0 x1 y1 z1, scene units.
        max_bytes: of these packets the longest prefix whose extracted file is no larger.

    Raises:
        ValueError: no such level, or the header and the first packet are larger than `max_bytes`;
            the message says the least size.
    """
    cut = Cut.full(directory) if level is None else Cut.of_level(directory, level)
    if sh_degree is not None:
        if not 0 <= sh_degree <= directory.sh_degree:
            raise ValueError(f"SH degree {sh_degree} is not one of 0..{directory.sh_degree}")
        cut = cut.with_sh_degree(sh_degree)
    if box is not None:
        cut = cut.with_box(directory, box)
    if max_bytes is None:
        return cut
    selected = np.flatnonzero(cut.packets(directory))
    sizes = _extracted_sizes(directory, selected, box)
    n = int(np.searchsorted(sizes, max_bytes, side="right"))
    if n == 0 or (n == 1 and len(selected)):
        least = sizes[min(1, len(selected))]
        raise ValueError(f"{max_bytes} bytes are too few: the first packet needs {least}")
    return Cut.of_rows(directory, selected[: n - 1])


def extract(
    data: Source,
    cut: Cut,
    *,
    box: Box | None = None,
    directory: Directory | None = None,
    progress: Progress = no_progress,
) -> bytes:
    """The stream of a cut: its packets verbatim, a new packet table.

    Args:
        data: a whole stream, its path or its URL; only the packets of the cut must be there.
        cut: as `choose_cut` gives it.
        box: leave tiles that do not meet it out of the tile table too.
        directory: of the stream, if it was read before.
        progress: called with the stage "fetch" and the part of the packets of a URL that has come.

    Raises:
        StreamError: header or chunks are not legal, or a packet of the cut is cut short.
        OSError: the file cannot be read.
        TypeError: `data` is neither bytes nor a path.
        ValueError: the stream has no such cut, or it has packets of tiles outside the box.
    """
    source = source_of(data)
    directory = read_directory(source) if directory is None else directory
    view = source.having(packet_ranges(directory, cut), progress)
    return _stream_of(view, directory, cut, _kept_tiles(directory, box))


def extract_tiles(data: Source, kept: Kept, *, directory: Directory | None = None) -> bytes:
    """The stream of some tiles, with all their packets.

    Args:
        data: a whole stream, its path or its URL.
        kept: (n_tiles,) True for the tiles to keep.
        directory: of the stream, if it was read before.

    Raises:
        StreamError, OSError, TypeError: as `extract`.
    """
    source = source_of(data)
    directory = read_directory(source) if directory is None else directory
    whole = Cut.full(directory)
    cut = Cut(np.where(kept[:, None], whole.steps, 0), whole.palette if kept.any() else 0)
    view = source.having(packet_ranges(directory, cut), no_progress)
    return _stream_of(view, directory, cut, kept)


def _stream_of(view: memoryview, directory: Directory, cut: Cut, kept: Kept) -> bytes:
    """The packets of a cut with the rows of the tiles that are kept."""
    selected = cut.packets(directory)
    of_palette = np.zeros(len(selected), bool)
    of_palette[directory.palette_packets] = True
    selected &= ~of_palette | kept.any()
    keys = directory.packet_ids(np.flatnonzero(selected))
    rows, of_palette = directory.packets[selected].copy(), of_palette[selected]
    if not (kept[rows["tile"]] | of_palette).all():
        raise ValueError("the cut has packets of tiles outside the box")
    number = np.cumsum(kept) - 1
    rows["tile"] = np.where(of_palette, 0, number[rows["tile"]])
    names: list[PacketId] = [
        key._replace(tile=tile) for key, tile in zip(keys, rows["tile"].tolist(), strict=True)
    ]
    digests = {
        name: directory.digests[key]
        for key, name in zip(keys, names, strict=True)
        if key in directory.digests
    }
    head = rebuild_directory(directory, directory.tiles[kept], rows, digests)
    states = dict(zip(names, directory.state_sizes[selected].tolist(), strict=True))
    size = len(head) + int(rows["size"].sum(dtype=np.int64))
    if sum(states[name] for name in digests) > MAX_DIGESTED_PER_BYTE * size:  # R-5.7-5
        last = {name[:2]: name for name in names}  # these always keep the bound
        digests = {name: digests[name] for name in digests.keys() & set(last.values())}
        head = rebuild_directory(directory, directory.tiles[kept], rows, digests)
    bodies = []
    for packet in np.flatnonzero(selected).tolist():
        offset, size = int(directory.offsets[packet]), int(directory.packets["size"][packet])
        body = view[offset : offset + size]
        if len(body) < size:
            raise StreamError(Fault.E_TRUNCATED, "a packet of the cut is cut short", offset)
        bodies.append(body)
    return b"".join([head, *bodies])


def _kept_tiles(directory: Directory, box: Box | None) -> Kept:
    if box is None:
        return np.ones(len(directory.tiles), bool)
    return tiles_meeting(directory, box)


def _extracted_sizes(directory: Directory, selected: I64, box: Box | None) -> I64:
    """(len(selected) + 1,) bytes of the file with the first 0, 1, ... of these packets."""
    rows = directory.packets[selected]
    keys = directory.packet_ids(selected)
    has_digest = np.array([key in directory.digests for key in keys], bool)
    per_packet = rows["size"].astype(np.int64) + size_of(PACKET_ENTRY)
    per_packet += has_digest * size_of(DIGEST_ENTRY)
    per_packet[np.flatnonzero(has_digest)[:1]] += CHUNK_HEADER_SIZE
    tiles = directory.tiles[_kept_tiles(directory, box)]
    fixed = len(rebuild_directory(directory, tiles, directory.packets[:0], {}))
    return fixed + np.concatenate([[0], np.cumsum(per_packet)])
