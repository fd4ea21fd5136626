"""Streams as one, packet by packet, where they share their grids and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from evogs_codec.editing.level_psnr import KEY as PSNR
from evogs_codec.format.directory import MAX_DIGESTED_PER_BYTE, Directory, read_directory
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.stores.sources import Source, bytes_of

__all__ = ["NotJoinableError", "joined"]

# What the streams must agree in: names of attributes of `Directory`, with words for people.
SHARED = {
    "sh_degree": "the SH degree",
    "n_levels": "the number of levels",
    "grid_exponents": "grids",
    "quantisers": "quantisers",
    "alpha": "tables of alpha",
    "version_minor": "the version",
    "unused_flags": "flags",
    "copied_chunks": "private chunks",
}


class NotJoinableError(ValueError):
    """Streams that are no stream together; the message says why."""


def joined(streams: Sequence[Source], info: SceneInfo | None = None) -> bytes:
    """The stream of all tiles of several streams; no packet is encoded again.

    Packets of each stream keep their order. Between streams they are in the order of the part of
    its own stream that lies before each, so that a prefix has about the same part of all.

    Args:
        streams: whole streams, at least one.
        info: of the whole; by default that of the first, without the PSNR of its levels.

    Raises:
        StreamError: header or chunks of a stream are not legal.
        NotJoinableError: streams differ in what a stream has once, or have palettes, or are too
            much for one stream.
    """
    views = [bytes_of(stream) for stream in streams]
    directories = [read_directory(view) for view in views]
    _check(directories)
    first = directories[0]
    tiles = np.concatenate([directory.tiles for directory in directories])
    begins = np.cumsum([0, *(len(directory.tiles) for directory in directories)]).tolist()
    rows, bodies, places = [], [], []
    digests = {}
    for begin, directory, view in zip(begins, directories, views, strict=False):
        own = directory.packets.copy()
        own["tile"] += begin
        rows.append(own)
        ends = directory.offsets + own["size"]
        bodies += [
            view[a:b] for a, b in zip(directory.offsets.tolist(), ends.tolist(), strict=True)
        ]
        places.append(
            (ends - directory.data_offset) / max(directory.size - directory.data_offset, 1)
        )
        for (tile, component, step), digest in directory.digests.items():
            digests[PacketId(tile + begin, component, step)] = digest
    order = np.argsort(np.concatenate(places), kind="stable")
    text = {key: value for key, value in first.info.text.items() if key != PSNR}
    whole = replace(first, info=replace(first.info, text=text) if info is None else info)
    try:
        packets = np.concatenate(rows)[order]
        head = rebuild_directory(whole, tiles, packets, digests)
        n_states = sum(sum(one.state_sizes[_digested(one)].tolist()) for one in directories)
        if n_states > MAX_DIGESTED_PER_BYTE * (len(head) + sum(map(len, bodies))):  # R-5.7-5
            head = rebuild_directory(whole, tiles, packets, {})
    except ValueError as error:
        raise NotJoinableError(str(error)) from error
    return b"".join([head, *(bodies[k] for k in order.tolist())])


def _digested(directory: Directory) -> list[int]:
    """The packets whose states have digests."""
    ids = directory.packet_ids()
    return [k for k, packet in enumerate(ids) if packet in directory.digests]


def _check(directories: Sequence[Directory]) -> None:
    first = directories[0]
    if len(directories) > 1 and any(directory.has_palette for directory in directories):
        raise NotJoinableError("a stream has a palette")
    for directory in directories[1:]:
        for name, said in SHARED.items():
            if getattr(directory, name) != getattr(first, name):
                raise NotJoinableError(f"the streams differ in {said}")
        if directory.info.antialiased != first.info.antialiased:
            raise NotJoinableError("one stream is antialiased, another is not")
