"""What names a packet of a stream (spec 3.5)."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["PacketId"]


class PacketId(NamedTuple):
    """A packet: the step of a component of a tile, as digests name it (spec 5.7)."""

    tile: int
    component: int
    step: int
