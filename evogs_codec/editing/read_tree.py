"""Reading a stream back as its records: the inverse of `encode.write`.

`read_coded_tree(write(tree))` is `tree`, integer by integer. Decoders do not come here: they apply
packets and forget them; this is for those who edit, inspect or re-encode a stream.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.decoding.palette_state import unpack_entries, unpack_picks
from evogs_codec.decoding.replay import packet_body
from evogs_codec.format.directory import UNKNOWN_ERROR, Directory
from evogs_codec.format.unpack import Packet, unpack
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.components import PICKS, component_slice
from evogs_codec.model.splats import I32

__all__ = ["read_coded_tree"]


def read_coded_tree(data: bytes | memoryview) -> CodedTree:
    """The coded tree of a whole stream.

    Raises:
        StreamError: the stream is not legal.
        ValueError: a tile has fewer steps of SH than of core, which no tree can say.
    """
    view = memoryview(data)
    directory = decode(view).directory  # what follows may trust every packet
    lengths = Cut.full(directory).steps
    if (lengths != lengths[:, :1]).any():
        raise ValueError("the stream has SH bands or picks with fewer steps than core")
    places = {
        (int(row["tile"]), int(step), int(row["component"])): packet
        for packet, (row, step) in enumerate(
            zip(directory.packets, directory.steps.tolist(), strict=True)
        )
    }
    tiles = []
    for tile, row in enumerate(directory.tiles):
        steps = [
            _step(directory, view, [places[tile, k, c] for c in directory.components.of_tiles])
            for k in range(int(lengths[tile, 0]))
        ]
        tiles.append(
            CodedTile(
                _triple(row["origin"]),
                _triple(row["box_min"]),
                _triple(row["box_max"]),
                tuple(steps),
            )
        )
    tree = CodedTree(
        sh_degree=directory.sh_degree,
        n_levels=directory.n_levels,
        grid_exponents=directory.grid_exponents,
        quantisers=directory.quantisers,
        alpha=directory.alpha,
        tiles=tuple(tiles),
        info=directory.info,
    )
    if not directory.has_palette:
        return tree
    of_palette = directory.packets[directory.palette_packets]
    levels = np.repeat(of_palette["level"].astype(np.int32), of_palette["n_adds"])
    return replace(tree, entries=_entries(directory, view), entry_levels=levels)


def _entries(directory: Directory, data: memoryview) -> I32:
    """(C, n) q of the palette."""
    n_above = directory.components.n_above
    parts = [np.empty((n_above, 0), np.int32)]
    for packet in directory.palette_packets.tolist():
        offset, n = int(directory.offsets[packet]), int(directory.packets["n_adds"][packet])
        body = packet_body(directory, data, packet)
        if len(body):
            parts.append(unpack_entries(body, n, n_above, offset).all())
    return np.concatenate(parts, axis=1)


def _step(directory: Directory, data: memoryview, packets: list[int]) -> CodedStep:
    """The step whose packets, core first, are `packets`."""
    counts = directory.counts(packets[0])
    rows = directory.packets[packets]
    d = directory.components.n_stored
    psi = np.zeros((d, counts.n_psi), np.int32)
    adds = np.zeros((d, counts.n_adds), np.int32)
    picks = changed_picks = np.empty(0, np.int32)
    parts: list[Packet] = []
    siblings: list[int] = []
    for component, packet in zip(directory.components.of_tiles, packets, strict=True):
        offset = int(directory.offsets[packet])
        body = packet_body(directory, data, packet)
        if component == PICKS:
            n_entries = int(directory.entries_required[packet])
            changed, new = unpack_picks(body, counts, n_entries, offset)
            if new is not None:
                picks = new.astype(np.int32)
            if changed is not None:
                changed_picks = changed.astype(np.int32)
            continue
        part = unpack(body, component, counts, offset)
        channels = component_slice(component)
        psi[channels] = part.psi.all()
        siblings += (channels.start + np.flatnonzero(part.psi.of_siblings)).tolist()
        adds[channels] = part.adds.all()
        parts.append(part)
    core = parts[0]
    alpha = np.zeros((N_GROUPS, counts.n_splits), np.uint8)
    for group, indices in enumerate(core.alpha):
        if indices is not None:
            alpha[group] = indices
    errors = tuple(rows["error"].tolist())
    return CodedStep(
        level=int(rows["level"][0]),
        slots=core.slots.astype(np.int32),
        kinds=core.kinds.astype(np.uint8),
        alpha=alpha,
        psi=psi,
        adds=adds,
        error=() if set(errors) == {UNKNOWN_ERROR} else errors,
        picks=picks,
        changed_picks=changed_picks,
        siblings=tuple(siblings),
    )


def _triple(values: np.ndarray) -> tuple[int, int, int]:
    x, y, z = values.tolist()
    return x, y, z
