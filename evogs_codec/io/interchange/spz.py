"""`.spz`, versions 1 to 4: fixed-point positions, bytes for all else.

Versions 1 to 3 are one gzip stream, version 4 has a Zstandard frame for each attribute. The frame
of axes is RUB, unless an extension record names another.

Letters: N splats.
"""

from __future__ import annotations

import struct
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import check_splats, gunzip, read_bytes, unzstd, zstd
from evogs_codec.io.interchange.frames import PLY_FRAME, info_of_frame, transformed, turn
from evogs_codec.io.interchange.values import (
    BYTE_LOGITS,
    as_bytes,
    largest_and_rest,
    quats_of,
    sigmoid,
    unit,
)
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, U8, SplatParams

__all__ = ["FRAME", "GZIP", "MAGIC", "is_spz", "read", "write"]

MAGIC, GZIP = b"NGSP", b"\x1f\x8b"
FRAME = "RUB"
FRAMES = (  # of the record SPZ_ADOBE_coordinate_system: 0 is unspecified, which is RUB
    *("RUB", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
COORDINATES = 0xADBE0003
ANTIALIASED, EXTENDED = 1, 2
N_REST = (0, 3, 8, 15, 24)  # coefficients above band 0, by SH degree
HALF = 2**0.5 / 2
QUAT_STEPS = 511
COLOUR = 0.15  # a byte of 255 is this many times an SH coefficient of band 0, less a half
MAX_DEGREE = 3  # ours
EFFORT = 12  # of Zstandard, as the reference has it
MAX_POSITION = (1 << 23) - 1
FRACTION, MIN_BITS = 12, 16  # bits below one unit; bits over the extent of a scene, at least


@dataclass(frozen=True)
class _Header:
    version: int
    n: int
    degree: int
    fraction: int
    flags: int

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of positions, opacities, colours, scales, rotations and SH."""
        position = 6 if self.version == 1 else 9
        rotation = 4 if self.version >= 3 else 3
        each = (position, 1, 3, 3, rotation, 3 * N_REST[self.degree])
        return tuple(self.n * size for size in each)


def is_spz(start: bytes) -> bool:
    """Whether a file that begins so is an `.spz`."""
    if not start.startswith(GZIP):
        return start.startswith(MAGIC)
    try:
        return gunzip(Path(), start, 4) == MAGIC
    except InputError:
        return False


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of an `.spz`, turned to the frame of a `.ply`.

    Raises:
        InputError: the file is damaged, or of a version that is not known.
    """
    data = read_bytes(path)
    header, parts, records = _read_4(path, data) if data[:4] == MAGIC else _read_gzip(path, data)
    frame = _frame(path, records)
    info = info_of_frame(SceneInfo(antialiased=bool(header.flags & ANTIALIASED)), frame)
    return transformed(_splats(header, parts), turn(frame, PLY_FRAME)), info


def _read_4(path: Path, data: bytes) -> tuple[_Header, list[bytes], bytes]:
    header = _header(path, data, len(data))
    if header.version != 4 or len(data) < 32:
        raise InputError(f"{path}: .spz version {header.version} without gzip; expected 4")
    n_streams, table = data[15], struct.unpack_from("<I", data, 16)[0]
    if table < 32 or n_streams < 5 or table + 16 * n_streams > len(data):
        raise InputError(f"{path}: its table of contents is not in the file; is it cut short?")
    if n_streams == 5 and header.degree:
        raise InputError(f"{path}: it has no SH, but says SH degree {header.degree}")
    at, parts = table + 16 * n_streams, []
    for i, size in enumerate(header.sizes[:n_streams]):
        n_packed, n_raw = struct.unpack_from("<QQ", data, table + 16 * i)
        if n_raw != size:
            raise InputError(f"{path}: part {i} has {n_raw:,} bytes, expected {size:,}")
        if at + n_packed > len(data):
            raise InputError(f"{path}: cut short: part {i} ends after the end of the file")
        packed = memoryview(data)[at : at + n_packed]
        parts.append(unzstd(path, packed, size) if size or n_packed else b"")
        at += n_packed
    parts += [b""] * (6 - len(parts))
    return header, parts, data[32:table] if header.flags & EXTENDED else b""


def _read_gzip(path: Path, data: bytes) -> tuple[_Header, list[bytes], bytes]:
    header = _header(path, gunzip(path, data, 16), len(data))
    n_bytes = 16 + sum(header.sizes)
    raw = gunzip(path, data, n_bytes + 4096)  # records are at the end, and small
    if len(raw) < n_bytes:
        raise InputError(f"{path}: cut short: it has {len(raw):,} of {n_bytes:,} bytes")
    at, parts = 16, []
    for size in header.sizes:
        parts.append(raw[at : at + size])
        at += size
    return header, parts, raw[n_bytes:] if header.flags & EXTENDED else b""


def _header(path: Path, start: bytes, n_file: int) -> _Header:
    if len(start) < 16:
        raise InputError(f"{path}: cut short: an .spz has a header of at least 16 bytes")
    magic, version, n, degree, fraction, flags = struct.unpack_from("<4sIIBBB", start)
    if magic != MAGIC:
        raise InputError(f"{path}: is compressed with gzip, and no .spz: unpack it first")
    if not 1 <= version <= 4:
        raise InputError(f"{path}: .spz version {version}; versions 1 to 4 are known")
    if degree >= len(N_REST):
        raise InputError(f"{path}: SH degree {degree}; an .spz has 0 to 4")
    if fraction > 31:
        raise InputError(f"{path}: positions have {fraction} bits below one unit; at most 31 fit")
    if degree > MAX_DEGREE:
        warnings.warn(f"{path}: SH of band 4 are left out", stacklevel=2)
    header = _Header(version, n, degree, fraction, flags)
    check_splats(path, n, 1 + N_REST[degree], n_file)
    return header


def _frame(path: Path, records: bytes) -> str:
    at = 0
    while at + 8 <= len(records):
        kind, size = struct.unpack_from("<II", records, at)
        if kind == COORDINATES and size >= 4 and at + 12 <= len(records):
            number = struct.unpack_from("<I", records, at + 8)[0]
            if number >= len(FRAMES):
                raise InputError(f"{path}: its coordinate system {number} is not known")
            return FRAMES[number]
        at += 8 + size
    return FRAME


def _splats(header: _Header, parts: list[bytes]) -> SplatParams:
    n = header.n
    positions, alphas, colours, scales, rotations, rest = (
        np.frombuffer(p, np.uint8) for p in parts
    )
    if header.version == 1:
        means = positions.view("<f2").reshape(n, 3).astype(np.float32)
    else:
        words = np.zeros((3 * n, 4), np.uint8)  # the three bytes on top, so that >> has their sign
        words[:, 1:] = positions.reshape(-1, 3)
        fixed = words.view("<i4")[:, 0] >> 8
        means = (fixed * np.float32(2.0**-header.fraction)).reshape(n, 3)
    kept = N_REST[min(header.degree, MAX_DEGREE)]
    sh = np.empty((n, 1 + kept, 3), np.float32)
    bytes_ = np.arange(256)
    sh[:, 0] = ((bytes_ / 255 - 0.5) / COLOUR).astype(np.float32)[colours].reshape(n, 3)
    coefficients = rest.reshape(n, 3 * N_REST[header.degree])[:, : 3 * kept]
    above = sh.reshape(n, 3 + 3 * kept)[:, 3:]
    np.subtract(coefficients, np.float32(128), out=above)
    above /= 128
    return SplatParams(
        means,
        _smallest_three(rotations) if header.version >= 3 else _first_three(rotations),
        (bytes_ / 16 - 10).astype(np.float32)[scales].reshape(n, 3),
        BYTE_LOGITS[alphas],
        sh,
    )


def _smallest_three(rotations: U8) -> F32:
    """Rotations of a word: which of x y z w is left out, the others in a sign and nine bits."""
    words = rotations.view("<u4")
    fields = words[:, None] >> np.array([20, 10, 0], np.uint32)
    rest = (fields & QUAT_STEPS).astype(np.float32) * np.float32(HALF / QUAT_STEPS)
    np.negative(rest, out=rest, where=(fields & 512) != 0)
    return np.roll(quats_of(words >> 30, rest), 1, axis=1)


def _first_three(rotations: U8) -> F32:
    """Rotations of a byte for each of x, y and z; w is not negative."""
    xyz = rotations.reshape(-1, 3).astype(np.float32) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - np.einsum("ij,ij->i", xyz, xyz)))
    return np.concatenate([w[:, None], xyz], axis=1)


# --- writing --------------------------------------------------------------------------------------


def write(splats: SplatParams, info: SceneInfo, _command: str) -> bytes:
    """An `.spz` of version 4; the splats are in its frame.

    Raises:
        InputError: positions are too large for 24 bits.
    """
    n, fraction = len(splats), _fraction(splats.means)
    fixed = np.rint(splats.means.astype(np.float64) * 2.0**fraction).astype("<i4")
    largest, rest = largest_and_rest(np.roll(unit(splats.quats), -1, axis=1))
    words = largest.astype(np.uint32) << 30
    steps = np.rint(np.abs(rest) * (QUAT_STEPS / HALF)).astype(np.uint32)
    fields = np.minimum(steps, QUAT_STEPS) | (rest < 0).astype(np.uint32) << 9
    words |= fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]
    parts = [
        fixed.view(np.uint8).reshape(-1, 4)[:, :3],
        as_bytes(255 * sigmoid(splats.opacity_logits)),
        as_bytes((splats.sh[:, 0] * COLOUR + 0.5) * 255),
        as_bytes((splats.log_scales + 10) * 16),
        words.astype("<u4").view(np.uint8),
    ]
    if splats.sh_degree:
        parts.append(_sh_bytes(splats.sh[:, 1:]))
    _warn_of_clipped(splats)
    _warn_of_moved(splats, fraction)
    frames = [zstd(part.tobytes(), EFFORT) for part in parts]
    flags = ANTIALIASED * info.antialiased
    head = struct.pack("<4sIIBBBB", MAGIC, 4, n, splats.sh_degree, fraction, flags, len(parts))
    table = b"".join(
        struct.pack("<QQ", len(frame), part.size) for frame, part in zip(frames, parts, strict=True)
    )
    return b"".join([head, struct.pack("<I12x", 32), table, *frames])


def _fraction(means: F32) -> int:
    """Bits of positions below one unit: 12, more for small scenes, less where they do not fit."""
    if not len(means):
        return FRACTION
    reach = float(np.abs(means).max())
    extent = float((means.max(0) - means.min(0)).max())
    wanted = FRACTION if extent <= 0 else max(FRACTION, MIN_BITS - int(np.floor(np.log2(extent))))
    fits = 24 if reach == 0 else int(np.floor(np.log2(MAX_POSITION / reach)))
    if fits < 0:
        raise InputError(f"positions reach {reach:g}; an .spz holds up to {MAX_POSITION:,}")
    return min(wanted, fits, 24)


def _sh_bytes(rest: F32) -> U8:
    """Five bits for band 1, four above, as the reference has it; the others are zero."""
    steps = np.full((rest.shape[1], 1), 16)
    steps[:3] = 8
    middle = np.rint(rest * 128) + 128
    return as_bytes((middle + steps // 2) // steps * steps)


def _warn_of_moved(splats: SplatParams, fraction: int) -> None:
    """Say how many splats move by over a tenth of their mean size, where positions are far."""
    if fraction >= FRACTION:
        return
    n_moved = splats.n_moved(0.5 * 2.0**-fraction)
    if n_moved:
        text = f"positions are far from zero: an .spz moves up to {n_moved:,} splats by more than"
        warnings.warn(f"{text} a tenth of their size; move the scene nearer first", stacklevel=2)


def _warn_of_clipped(splats: SplatParams) -> None:
    beyond = (np.abs(splats.sh[:, 0]) > 0.5 / COLOUR).any(1)
    beyond |= (splats.sh[:, 1:] < -1).any((1, 2)) | (splats.sh[:, 1:] > 1).any((1, 2))
    beyond |= ((splats.log_scales < -10) | (splats.log_scales > 255 / 16 - 10)).any(1)
    n_beyond = int(np.count_nonzero(beyond))
    if n_beyond:
        text = f"{n_beyond:,} of {len(splats):,} splats have colours or scales beyond what an .spz"
        warnings.warn(f"{text} holds: the nearest that it holds are taken", stacklevel=2)
