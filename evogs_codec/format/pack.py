"""Packing: the bytes of a packet from its records; the inverse of `unpack` (spec 5.9, 7.1).

Letters: C channels of the component, R records that name a slot, P of them with psi, S splits,
A adds.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.format import frames, layout
from evogs_codec.format.blocks import block_ends
from evogs_codec.format.grouping import grouped
from evogs_codec.format.packet_header import (
    FLAG_ADDS_YCOCG,
    FLAG_OF_CHANGED,
    FLAG_PSI_YCOCG,
    MAX_RECORDS_PER_BYTE,
    Counts,
)
from evogs_codec.format.planes import (
    ABSENT,
    MAX_STORED,
    Coding,
    choose_coding,
    delta,
    entropy,
    split_planes,
    ycocg,
    zigzag,
)
from evogs_codec.model.components import sh_channels
from evogs_codec.model.splats import I32, U8
from evogs_codec.model.tree import Kind

__all__ = ["decorrelate", "pack", "pack_entries", "pack_picks"]

_FRAME_ENTRY = layout.dtype_of(layout.FRAME_ENTRY)

Coded: TypeAlias = tuple[Coding, npt.NDArray[np.integer]]


def pack(
    component: int,
    slots: I32,
    kinds: U8,
    alpha: Sequence[U8 | None],
    psi: I32,
    adds: I32,
    *,
    siblings: Collection[int] = (),
    zstd_level: int,
) -> bytes:
    """The bytes of a packet; the inverse of `unpack`.

    Args:
        component: 0 core, b the SH band b.
        slots: (R,) increasing.
        kinds: (R,).
        alpha: (S,) indices per group, None where all are 0; used by core only.
        psi: (C, P) integers.
        adds: (C, A) integers.
        siblings: channels whose psi are sibling differences; of refines alone.
        zstd_level: Zstandard level.

    Raises:
        ValueError: an integer needs more than 24 bits.
    """
    n_splits = int(np.count_nonzero(kinds == Kind.SPLIT))
    n_refines = int(np.count_nonzero(kinds == Kind.REFINE))
    counts = Counts(adds.shape[1], n_splits, n_refines, len(slots) - n_splits - n_refines)
    if component == 0 and counts.n_records + counts.n_adds == 0:
        return b""
    sides: list[tuple[Coding, npt.NDArray[np.integer]]] = []
    if component == 0:
        gaps = delta(slots + 1) - 1
        sides.append((choose_coding(gaps)[0], gaps))
        sides.append((choose_coding(kinds)[0] if counts.has_kinds else ABSENT, kinds))
        for indices in alpha:
            stored = np.zeros(n_splits, np.uint8) if indices is None else indices
            sides.append((choose_coding(stored)[0], stored))
    flags = 0
    sh = sh_channels(component)
    for values, flag in ((psi, FLAG_PSI_YCOCG), (adds, FLAG_ADDS_YCOCG)):
        rows, is_ycocg = decorrelate(values, sh)
        flags |= flag if is_ycocg else 0
        if flag == FLAG_ADDS_YCOCG:
            sides += [_code_channel(row, may_delta=True) for row in rows]
        else:
            for channel, row in enumerate(rows):
                coded = _code_channel(row, may_delta=False)
                if channel in siblings:
                    is_turned = is_ycocg and sh.start <= channel < sh.stop
                    coded = _of_siblings(coded, is_turned=is_turned)
                sides.append(coded)
    if component and all(coding == ABSENT for coding, _ in sides):
        return b""
    body = _join(flags, sides, zstd_level)
    if component == 0 and counts.n_adds + counts.n_records > MAX_RECORDS_PER_BYTE * len(body):
        body = _pad(flags, sides, counts)
    return body


def pack_picks(picks: I32, changed: I32, *, zstd_level: int) -> bytes:
    """The bytes of a packet of picks (spec 12.4).

    Args:
        picks: (n_new,) of the new slots, or (0,): C2s take those of their parents, adds none.
        changed: (P,) of the slots that are refined or split, or (0,): they keep theirs.
        zstd_level: the Zstandard level, 1..22.
    """
    stored = np.concatenate([changed, picks])
    if not len(stored):
        return b""
    coding = choose_coding(stored)[0]
    return _join(FLAG_OF_CHANGED if len(changed) else 0, [(coding, stored)], zstd_level)


def pack_entries(entries: I32, *, zstd_level: int) -> bytes:
    """The bytes of a packet of the palette, (C, n) integers.

    Raises:
        ValueError: an integer needs more than 24 bits.
    """
    n = entries.shape[1]
    if not n:
        return b""
    rows, is_ycocg = decorrelate(entries, slice(None))
    flags = FLAG_ADDS_YCOCG if is_ycocg else 0
    lists = [_code_channel(row, may_delta=True) for row in rows]
    body = _join(flags, lists, zstd_level)
    if n > MAX_RECORDS_PER_BYTE * len(body):
        body = _pad(flags, lists, Counts(n, 0, 0, 0))
    return body


def decorrelate(values: I32, sh: slice) -> tuple[I32, bool]:
    """YCoCg-R on the SH triples, if that lowers the entropy."""
    rows = values[sh]
    if rows.size == 0 or not rows.any() or int(np.abs(rows).max()) >= MAX_STORED // 8:
        return values, False
    turned = ycocg(rows)
    stride = max(1, rows.shape[1] // 20000)
    before = sum(entropy(zigzag(row[::stride])) for row in rows)
    after = sum(entropy(zigzag(row[::stride])) for row in turned)
    if after >= before:
        return values, False
    out = values.copy()
    out[sh] = turned
    return out, True


def _code_channel(q: I32, *, may_delta: bool) -> Coded:
    """Coding and stored integers of a channel; adds as differences if that is cheaper."""
    if not q.any():
        return ABSENT, q
    options = []
    for is_delta in (False, True) if may_delta and len(q) > 1 else (False,):
        z = zigzag(delta(q)) if is_delta else zigzag(q)
        if int(z.max()) < MAX_STORED:
            coding, cost = choose_coding(z, is_delta=is_delta)
            options.append((cost, is_delta, coding, z))
    if not options:
        raise ValueError("an integer needs more than 24 bits: take larger steps")
    _, _, coding, z = min(options, key=lambda option: option[:2])
    return coding, z


def _of_siblings(coded: Coded, *, is_turned: bool) -> Coded:
    """The same integers, said to be sibling differences; of zeros there is nothing to say.

    A list of zeros that is turned is stored, since its coding byte speaks for a channel of others.
    """
    coding, z = coded
    if coding == ABSENT:
        return (Coding(1, 0, delta=True), z) if is_turned and len(z) else coded
    return replace(coding, delta=True), z


def _join(flags: int, parts: Sequence[Coded], zstd_level: int) -> bytes:
    """A packet from its values; planes that are alike share a frame."""
    planes = [plane for coding, values in parts for plane in split_planes(values, coding)]
    codings = bytes(coding.byte() for coding, _ in parts)
    joined = []
    for begin, end in grouped(planes):
        content = b"".join(planes[begin:end])
        ends = block_ends(content) if zstd_level >= frames.FIRST_WEIGHING_LEVEL else []
        joined.append((end - begin, frames.compress(content, zstd_level, ends)))
    return _assemble(flags, codings, joined)


def _pad(flags: int, parts: Sequence[Coded], counts: Counts) -> bytes:
    """A packet that R-5.6-7 allows: planes stored raw, a byte per record at least."""
    whole_bytes = list(parts)
    for place, n in ((0, counts.n_records), (len(parts) - 1, counts.n_adds)):
        coding, values = whole_bytes[place]
        if n and not coding.high:  # the gaps, and the last channel of the adds
            whole_bytes[place] = Coding(0, 1, coding.delta), values
    planes = [plane for coding, values in whole_bytes for plane in split_planes(values, coding)]
    codings = bytes(coding.byte() for coding, _ in whole_bytes)
    return _assemble(flags, codings, [(1, frames.store(plane)) for plane in planes])


def _assemble(flags: int, codings: bytes, parts: Sequence[tuple[int, bytes]]) -> bytes:
    head = layout.build(layout.PACKET_HEADER, flags=flags, n_frames=len(parts))
    entries = np.zeros(len(parts), _FRAME_ENTRY)
    entries["n_planes"] = [n for n, _ in parts]
    entries["size"] = [len(frame) for _, frame in parts]
    return head + codings + entries.tobytes() + b"".join(frame for _, frame in parts)
