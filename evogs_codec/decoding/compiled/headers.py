"""Packet headers, compiled: which lists and frames the packets of a tile hold.

It knows no faults: where a packet is not plainly legal it gives up, and the code of
`packet_header`, which follows the spec check by check, finds out what is wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.format.packet_header import FLAG_OF_CHANGED
from evogs_codec.model.components import PICKS
from evogs_codec.model.splats import I64, U8

__all__ = [
    "EMPTY",
    "MAX_LISTS",
    "N_CORE",
    "N_SIDES",
    "Headers",
    "bits_are_plain",
    "read_headers",
]

_jit = jit()
N_SIDES = 7  # lists of core before psi: gaps, kinds, alpha of each group
N_CORE = 14  # channels of core
MAX_LISTS = 42  # of band 3; core has 35
EMPTY = 256  # in place of the flags of a packet of size 0


class Headers(NamedTuple):
    """The packets to apply, in order: rows of the packet table and what `read_headers` found.

    Attributes:
        components, steps: (K,) of each packet.
        levels: (K,) label of its step.
        counts: (K, 4) adds, splits, refines, drops of its step.
        codes, starts, flags: (K, MAX_LISTS), (K, MAX_LISTS), (K,); flags of no bytes are `EMPTY`.
        planes: all planes.
        n_entries: (K,) of the palette, which picks may name.
    """

    components: I64
    steps: I64
    levels: I64
    counts: I64
    codes: U8
    starts: I64
    flags: I64
    planes: U8
    n_entries: I64


@_jit
def read_headers(
    data: U8,
    offsets: I64,
    sizes: I64,
    components: I64,
    counts: I64,
    codes: U8,
    starts: I64,
    flags: I64,
    frames: I64,
) -> bool:
    """Read the headers of packets that are there whole (spec 5.9), not those of their frames.

    Args:
        data: the file.
        offsets: (P,) of each packet.
        sizes: (P,) bytes of each.
        components: (P,) of each.
        counts: (P, 4) adds, splits, refines, drops of the core packet of its step.
        codes: (P, MAX_LISTS) coding bytes, out.
        starts: (P, MAX_LISTS) where the planes of each list begin in all planes, out.
        flags: (P,) of the packet header, out; `EMPTY` of a packet of size 0.
        frames: (F, 3) offset, size and content size of each frame, out.

    Returns:
        False if a packet is not plainly legal.
    """
    n_read, at_plane = 0, 0
    plane_sizes = np.empty(3 * MAX_LISTS, np.int64)
    for p in range(len(offsets)):
        codes[p] = 0
        starts[p] = 0
        flags[p] = 0
        if sizes[p] == 0:
            flags[p] = EMPTY
            continue
        if components[p] < 0 or components[p] > PICKS:
            return False
        end, at = offsets[p] + sizes[p], offsets[p] + 2
        if at > end:
            return False
        flags[p], n_frames = data[offsets[p]], np.int64(data[offsets[p] + 1])
        lengths, n_lists = _lengths(components[p], counts[p], flags[p])
        if at + n_lists > end:
            return False
        if flags[p] >> (3 if components[p] == PICKS else 2):
            return False
        n_planes = 0
        first_delta = n_lists
        if components[p] != PICKS:
            first_delta -= 14 if components[p] == 0 else 3 * (2 * components[p] + 1)
            if counts[p, 1] == 0 and counts[p, 3] == 0:  # psi of refines alone
                first_delta -= n_lists - first_delta
        for k in range(n_lists):
            code = np.int64(data[at + k])
            low, high, n = code & 15, (code >> 4) & 3, lengths[k]
            if code & 128 or low > 8 or high > 2 or code == 64 or (code and n == 0):
                return False
            if code & 64 and k < first_delta:
                return False
            codes[p, k], starts[p, k] = code, at_plane
            if low:
                packed = low == 1 or low == 2 or low == 4
                plane_sizes[n_planes] = (n * low + 7) // 8 if packed else n
                at_plane += plane_sizes[n_planes]
                n_planes += 1
            for _ in range(high):
                plane_sizes[n_planes] = n
                at_plane += n
                n_planes += 1
        at += n_lists
        body = at + 5 * n_frames
        plane = 0
        for _ in range(n_frames):
            if at + 5 > end or n_read == len(frames):
                return False
            n_of_frame, size = np.int64(data[at]), _u32(data, at + 1)
            if n_of_frame == 0 or plane + n_of_frame > n_planes or body + size > end:
                return False
            content = plane_sizes[plane : plane + n_of_frame].sum()
            frames[n_read, 0], frames[n_read, 1], frames[n_read, 2] = body, size, content
            n_read += 1
            plane += n_of_frame
            body += size
            at += 5
        if plane != n_planes or body != end:
            return False
    return True


@_jit
def _lengths(component: int, counts: I64, flags: int) -> tuple[I64, int]:
    """(integers of each list, number of lists), spec 5.9."""
    out = np.zeros(MAX_LISTS, np.int64)
    n_adds, n_splits, n_refines, n_drops = counts
    if component == PICKS:
        out[0] = n_splits + n_adds
        if flags & FLAG_OF_CHANGED:
            out[0] += n_splits + n_refines
        return out, 1
    n_channels, at = 3 * (2 * component + 1), 0
    if component == 0:
        n_channels, at = 14, N_SIDES
        out[0] = n_splits + n_refines + n_drops
        if (n_splits > 0) + (n_refines > 0) + (n_drops > 0) > 1:
            out[1] = out[0]
        out[2:N_SIDES] = n_splits
    out[at : at + n_channels] = n_splits + n_refines
    out[at + n_channels : at + 2 * n_channels] = n_adds
    return out, at + 2 * n_channels


@_jit
def _u32(data: U8, at: int) -> int:
    return (
        np.int64(data[at])
        | np.int64(data[at + 1]) << 8
        | np.int64(data[at + 2]) << 16
        | np.int64(data[at + 3]) << 24
    )


@_jit
def bits_are_plain(headers: Headers, k: int) -> bool:
    """R-5.9-9 for the lists of a packet."""
    for j in range(headers.codes.shape[1]):
        low = np.int64(headers.codes[k, j]) & 15
        if low == 0 or low == 8:
            continue
        n, start = _list_length(headers, k, j), headers.starts[k, j]
        if low == 1 or low == 2 or low == 4:
            used = n * low % 8
            if used and headers.planes[start + n * low // 8] >> used:
                return False
        else:
            largest = np.uint8(0)
            for value in headers.planes[start : start + n]:
                largest = max(largest, value)
            if largest >> low:
                return False
    return True


@_jit
def _list_length(headers: Headers, k: int, j: int) -> int:
    """Integers of a list that is stored (spec 5.9)."""
    n_adds, n_splits, n_refines, n_drops = headers.counts[k]
    component = headers.components[k]
    if component == PICKS:
        return (
            n_splits + n_adds + (n_splits + n_refines if headers.flags[k] & FLAG_OF_CHANGED else 0)
        )
    n_channels, first = 3 * (2 * component + 1), 0
    if component == 0:
        n_channels, first = N_CORE, N_SIDES
        if j < 2:
            return n_splits + n_refines + n_drops
        if j < N_SIDES:
            return n_splits
    return n_splits + n_refines if j < first + n_channels else n_adds
