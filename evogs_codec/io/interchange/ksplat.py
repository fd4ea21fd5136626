"""`.ksplat` of GaussianSplats3D, version 0.1: sections of splats, SH degree 0 to 2.

Compression level 0 has floats; 1 has positions in buckets and half floats; 2 has SH in bytes.

Letters: N splats, B buckets.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import read_bytes
from evogs_codec.io.interchange.values import BYTE_COLOURS, BYTE_LOGITS, log_scales_of
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, SplatParams

__all__ = ["is_ksplat", "read"]

HEADER, SECTION = 4096, 1024
N_REST = (0, 3, 8, 15)  # coefficients above band 0, by SH degree
SH_BYTES = (4, 2, 1)  # of a coefficient, by compression level
RANGE = 1.5  # of SH in bytes, where the header says none


@dataclass(frozen=True)
class _Section:
    """Attributes of a section.

    Attributes:
        at: offset of its data in the file.
        n: splats there are.
        capacity: splats there is room for.
        bucket: splats of a full bucket.
        n_buckets: B.
        n_full: buckets that are full; they come first.
        n_partial: the others, whose lengths come before the centres.
        bucket_bytes: of the centre of a bucket.
        scale: units of a step of positions.
        middle: the step that is the centre of the bucket.
        degree: of SH.
    """

    at: int
    n: int
    capacity: int
    bucket: int
    n_buckets: int
    n_full: int
    n_partial: int
    bucket_bytes: int
    scale: float
    middle: int
    degree: int

    @property
    def centres(self) -> int:
        return self.at + 4 * self.n_partial

    @property
    def rows(self) -> int:
        return self.centres + self.bucket_bytes * self.n_buckets


def is_ksplat(path: Path, start: bytes) -> bool:
    """Whether a file seems to be a `.ksplat`, which has no magic: its version, sizes and zeros."""
    if len(start) < HEADER or start[0] != 0 or not 1 <= start[1] <= 9:
        return False
    n_max, n_sections, _, n, level = struct.unpack_from("<IIIIH", start, 4)
    named = path.suffix.lower() == ".ksplat"
    return named or (
        0 < n_sections <= n_max < 4096 and n > 0 and level < 3 and not any(start[44:HEADER])
    )


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of a `.ksplat`, whose frame is that of a `.ply`.

    Raises:
        InputError: the file is damaged, or of another version.
    """
    data = read_bytes(path)
    if len(data) < HEADER:
        raise InputError(f"{path}: cut short: a .ksplat has a header of {HEADER:,} bytes")
    if data[0] != 0 or data[1] < 1:
        raise InputError(f"{path}: .ksplat version {data[0]}.{data[1]}; version 0.1 is known")
    n_max, n_sections, _, n_splats, level = struct.unpack_from("<IIIIH", data, 4)
    if level > 2:
        raise InputError(f"{path}: compression level {level}; 0 to 2 are known")
    if HEADER + SECTION * n_max > len(data):
        raise InputError(f"{path}: cut short: {n_max:,} section headers do not fit in the file")
    sections = _sections(path, data, min(n_max, n_sections or n_max), n_max, level)
    if sum(section.n for section in sections) != n_splats:
        raise InputError(f"{path}: its sections have other than {n_splats:,} splats in all")
    low, high = (
        value or side
        for value, side in zip(struct.unpack_from("<ff", data, 36), (-RANGE, RANGE), strict=True)
    )
    degree = max((section.degree for section in sections), default=0)
    parts = [_splats(path, data, section, level, degree, (low, high)) for section in sections]
    return _joined(parts, degree), SceneInfo()


def _sections(path: Path, data: bytes, n: int, n_max: int, level: int) -> list[_Section]:
    found, at = [], HEADER + SECTION * n_max
    for i in range(n):
        head = HEADER + SECTION * i
        (
            count,
            capacity,
            bucket,
            n_buckets,
            block,
            bucket_bytes,
            middle,
            _,
            n_full,
            n_partial,
            degree,
        ) = struct.unpack_from("<IIIIfHxxIIIIH", data, head)
        if not count:
            continue
        if degree >= len(N_REST):
            raise InputError(f"{path}: section {i} has SH degree {degree}; expected 0 to 3")
        if n_full + n_partial > n_buckets or (level and not (bucket_bytes == 12 and n_buckets)):
            raise InputError(f"{path}: section {i} has buckets that do not fit together")
        middle = middle or (32767 if level else 1)
        scale = block / 2 / middle
        capacity = max(count, capacity)
        section = _Section(
            at,
            count,
            capacity,
            bucket,
            n_buckets,
            n_full,
            n_partial,
            bucket_bytes,
            scale,
            middle,
            degree,
        )
        end = section.rows + capacity * _row(level, degree).itemsize
        if section.rows + count * _row(level, degree).itemsize > len(data):
            raise InputError(f"{path}: cut short: section {i} ends after the end of the file")
        found.append(section)
        at = end
    return found


def _row(level: int, degree: int) -> np.dtype[np.void]:
    size, kind = (4, "<f4") if level == 0 else (2, "<f2")
    position = kind if level == 0 else "<u2"
    sh = ("<f4", "<f2", "u1")[level]
    fields = [("means", position, 3), ("scales", kind, 3), ("quats", kind, 4), ("colour", "u1", 4)]
    if degree:
        fields.append(("sh", sh, 3 * N_REST[degree]))
    row = np.dtype(fields)
    assert row.itemsize == 10 * size + 4 + 3 * N_REST[degree] * SH_BYTES[level]
    return row


def _splats(
    path: Path,
    data: bytes,
    section: _Section,
    level: int,
    degree: int,
    sh_range: tuple[float, float],
) -> SplatParams:
    rows = np.frombuffer(data, _row(level, section.degree), section.n, section.rows)
    means = rows["means"].astype(np.float32)
    if level:
        centres = np.frombuffer(data, "<f4", 3 * section.n_buckets, section.centres).reshape(-1, 3)
        means = (means - section.middle) * np.float32(section.scale)
        means += centres[_buckets(path, data, section)]
    sh = np.zeros((section.n, 1 + N_REST[degree], 3), np.float32)
    sh[:, 0] = BYTE_COLOURS[rows["colour"][:, :3]]
    if section.degree:
        stored = rows["sh"].astype(np.float32)
        if level == 2:
            low, high = sh_range
            stored = np.float32(low) + stored * np.float32((high - low) / 255)
        for band in range(1, section.degree + 1):  # of each band all of R, then of G, then of B
            part = slice(band**2, (band + 1) ** 2)
            of_band = stored[:, 3 * band**2 - 3 : 3 * (band + 1) ** 2 - 3]
            sh[:, part] = of_band.reshape(section.n, 3, 2 * band + 1).transpose(0, 2, 1)
    return SplatParams(
        means,
        rows["quats"].astype(np.float32),
        log_scales_of(rows["scales"]),
        BYTE_LOGITS[rows["colour"][:, 3]],
        sh,
    )


def _buckets(path: Path, data: bytes, section: _Section) -> npt.NDArray[np.int64]:
    """(N,) the bucket of each splat."""
    lengths = np.full(section.n_full + section.n_partial, section.bucket, np.int64)
    lengths[section.n_full :] = np.frombuffer(data, "<u4", section.n_partial, section.at)
    ends = np.cumsum(lengths)
    if not len(ends) or ends[-1] < section.n:
        raise InputError(f"{path}: the buckets of a section have fewer splats than the section")
    return np.searchsorted(ends, np.arange(section.n), side="right")


def _joined(parts: list[SplatParams], degree: int) -> SplatParams:
    if not parts:
        empty: F32 = np.empty((0, 4), np.float32)
        sh = np.empty((0, 1 + N_REST[degree], 3), np.float32)
        return SplatParams(empty[:, :3], empty, empty[:, :3], empty[:, 0], sh)
    return SplatParams.joined(parts)
