"""Changes of the list of chunks of a stream."""

from __future__ import annotations

from collections.abc import Callable

from conformance.generator.builder import Chunk

__all__ = ["Edit", "behind", "changed", "picked", "with_body"]

Edit = Callable[[list[Chunk]], list[Chunk]]


def behind(*extra: Chunk) -> Edit:
    """More chunks behind the others."""
    return lambda chunks: [*chunks, *extra]


def changed(at: int, change: Callable[[Chunk], Chunk]) -> Edit:
    """Another chunk in the place of one."""
    return lambda chunks: [change(c) if k == at else c for k, c in enumerate(chunks)]


def with_body(at: int, body: bytes) -> Edit:
    """Another body of a chunk."""
    return changed(at, lambda chunk: Chunk(chunk.kind, body))


def picked(*order: int) -> Edit:
    """The chunks of these places, in this order."""
    return lambda chunks: [chunks[at] for at in order]
