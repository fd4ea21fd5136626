"""Packets with sibling differences (spec 7.1)."""

from __future__ import annotations

from collections.abc import Iterator

from conformance.decoders import oracle

N_SIDES = 7  # coding bytes of core before those of psi
DELTA = 64


def with_siblings(
    data: bytes, scene: oracle.Scene
) -> Iterator[tuple[oracle.Packet, list[int], list[int]]]:
    """(packet, its coding bytes of psi, slots of its records born from another of the step).

    Only of packets where a coding byte of psi has `delta`.
    """
    for p in scene.packets:
        if p.size == 0 or (scene.header.has_palette and p.component > 0):
            continue
        begin = p.start + 2 + (N_SIDES if p.component == 0 else 0)
        codings = list(data[begin : begin + len(oracle.channels_of(p.component))])
        if any(c & DELTA for c in codings):
            tile = scene.tiles[p.tile]
            slots = tile.steps[p.step].slots
            yield p, codings, [slot for slot in slots if tile.born_from[slot] in slots]
