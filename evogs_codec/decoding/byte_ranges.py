"""Which bytes of a file to fetch for a cut."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.format.directory import Directory
from evogs_codec.stores.ranges import Range

__all__ = ["byte_ranges", "packet_ranges"]


def byte_ranges(
    directory: Directory, cut: Cut, *, have: Cut | None = None, gap: int = 0
) -> list[tuple[int, int]]:
    """The packets of a cut as few ranges, in file order; `Decoder.feed` takes each.

    Args:
        directory: of the stream.
        cut: what is wanted.
        have: packets of this cut are there already, for instance `decoder.cut`.
        gap: ranges with at most this many bytes between them become one: bytes that are not
            wanted may be cheaper than another request.

    Returns:
        (offset, size) of each range, in bytes; none is empty, none touches the next.

    Raises:
        ValueError: a cut has steps that the file does not have, or `gap` is below 0.
    """
    if gap < 0:
        raise ValueError(f"a gap of {gap} bytes")
    wanted = cut.packets(directory)
    if have is not None:
        wanted &= ~have.packets(directory)
    sizes = directory.packets["size"].astype(np.int64)
    wanted &= sizes > 0
    begins = directory.offsets[wanted]
    ends = begins + sizes[wanted]
    if not len(begins):
        return []
    is_first = np.append(True, begins[1:] - ends[:-1] > gap)
    is_last = np.append(is_first[1:], True)
    first, size = begins[is_first], ends[is_last] - begins[is_first]
    return list(zip(first.tolist(), size.tolist(), strict=True))


def packet_ranges(directory: Directory, cut: Cut) -> Iterator[Range]:
    """`byte_ranges` as `ByteSource.having` takes them: nothing is done unless they are looked at.

    Raises:
        ValueError: the cut has steps that the file does not have.
    """
    for offset, size in byte_ranges(directory, cut):
        yield offset, offset + size
