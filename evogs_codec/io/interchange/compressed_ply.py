"""Compressed `.ply` of PlayCanvas: words of 32 bits in chunks of 256 splats, SH in bytes.

The frame is that of a `.ply`.

Letters: N splats, C chunks, K SH coefficients.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evogs_codec.common.morton import morton_order
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.ply_comments import comments_of, info_of
from evogs_codec.io.interchange.values import (
    BYTE_LOGITS,
    C0,
    as_bytes,
    largest_and_rest,
    quats_of,
    sigmoid,
    unit,
)
from evogs_codec.io.makers import comment_of
from evogs_codec.io.ply_header import PlyHeader, read_ply_header
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, I64, SplatParams, sh_degree_of

__all__ = ["is_compressed", "order_of", "read", "write"]

CHUNK = 256
WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
BOUNDS = tuple(
    f"{side}_{name}"
    for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for side in ("min", "max")
    for name in names
)
N_WITHOUT_COLOUR = 12  # bounds of files from before colours had them
SH_RANGE = 8.0  # SH coefficients are in -4 to 4
MAX_LOG_SCALE = 20.0  # a bound of a chunk, as the reference clamps it
ROOT = np.float32(2**0.5)


def is_compressed(header: PlyHeader) -> bool:
    """Whether a `.ply` is a compressed one."""
    return set(WORDS) <= set(header.names)


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of a compressed `.ply`.

    Raises:
        InputError: the file is damaged.
    """
    header = read_ply_header(path)
    chunk, words, stored = _elements(path, header)
    n = len(words)
    of_splat = np.arange(n) // CHUNK
    position, rotation, scale, colour = (words[name].astype(np.uint32) for name in WORDS)
    rest = _fields(rotation, (10, 10, 10), (20, 10, 0))
    sh = np.empty((n, 1 + stored.shape[1] // 3, 3), np.float32)
    unpacked = _fields(colour, (8, 8, 8), (24, 16, 8))
    if set(BOUNDS) <= set(chunk.dtype.names or ()):
        unpacked = _within(chunk, of_splat, ("r", "g", "b"), unpacked)
    sh[:, 0] = (unpacked - 0.5) / np.float32(C0)
    sh[:, 1:] = _sh_table()[stored].reshape(n, 3, sh.shape[1] - 1).transpose(0, 2, 1)
    return SplatParams(
        _within(chunk, of_splat, ("x", "y", "z"), _fields(position, (11, 10, 11), (21, 11, 0))),
        quats_of(rotation >> 30, (rest - 0.5) * ROOT),
        _within(
            chunk,
            of_splat,
            ("scale_x", "scale_y", "scale_z"),
            _fields(scale, (11, 10, 11), (21, 11, 0)),
        ),
        BYTE_LOGITS[colour & 255],
        sh,
    ), info_of(header.comments)


def _elements(
    path: Path, header: PlyHeader
) -> tuple[npt.NDArray[np.void], npt.NDArray[np.void], npt.NDArray[np.uint8]]:
    """The chunks, the words of the splats, and (N, 3 K - 3) bytes of SH."""
    if header.text:
        raise InputError(f"{path}: a compressed .ply is binary, this one is text")
    found: dict[str, npt.NDArray[np.void]] = {}
    at, size = header.body, path.stat().st_size
    for name, n, dtype in header.elements:
        if dtype is None:
            raise InputError(f"{path}: element {name} has lists; a compressed .ply has none")
        end = at + n * dtype.itemsize
        if end > size:
            raise InputError(f"{path}: cut short: {n} of {name} end at byte {end}, of {size}")
        found[name] = (
            np.memmap(path, dtype, "r", at, (n,)) if n and dtype.itemsize else np.empty(n, dtype)
        )
        at = end
    words = found["vertex"]
    chunk = found.get("chunk", np.empty(0, []))
    n_chunks = -(-len(words) // CHUNK)
    if len(chunk) < n_chunks or not set(BOUNDS[:N_WITHOUT_COLOUR]) <= set(chunk.dtype.names or ()):
        raise InputError(f"{path}: a compressed .ply of {len(words)} splats has {n_chunks} chunks")
    stored = found.get("sh", np.empty(len(words), []))
    n_rest = sum(name.startswith("f_rest_") for name in stored.dtype.names or ())
    try:
        sh_degree_of(n_rest // 3 + 1 if n_rest % 3 == 0 else 0)
        rest = [stored[f"f_rest_{i}"] for i in range(n_rest)]
    except ValueError:
        raise InputError(f"{path}: {n_rest} properties f_rest_*; expected 0, 9, 24 or 45") from None
    if n_rest and (len(stored) != len(words) or any(column.dtype != np.uint8 for column in rest)):
        raise InputError(f"{path}: element sh is not a byte of each coefficient of each splat")
    packed = set(stored.dtype.names or ()) == {f"f_rest_{i}" for i in range(n_rest)}
    if n_rest and packed and stored.dtype.names == tuple(f"f_rest_{i}" for i in range(n_rest)):
        return chunk, words, np.asarray(stored).view(np.uint8).reshape(-1, n_rest)
    columns = np.stack(rest, axis=1) if rest else np.empty((len(words), 0), np.uint8)
    return chunk, words, columns


def _fields(words: npt.NDArray[np.uint32], bits: tuple[int, ...], at: tuple[int, ...]) -> F32:
    """(N, fields) numbers of 0 to 1 in some bits of a word."""
    most = np.array([(1 << b) - 1 for b in bits], np.uint32)
    steps = (words[:, None] >> np.array(at, np.uint32)) & most
    parts: F32 = (steps / most).astype(np.float32)
    return parts


def _within(chunk: npt.NDArray[np.void], of_splat: I64, names: tuple[str, ...], parts: F32) -> F32:
    """Numbers between the bounds of their chunk."""
    low: F32 = np.stack([chunk[f"min_{name}"] for name in names], axis=1).astype(np.float32)
    high: F32 = np.stack([chunk[f"max_{name}"] for name in names], axis=1).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        within: F32 = low[of_splat] * (1 - parts) + high[of_splat] * parts
    return within


def _sh_table() -> F32:
    """(256,) the coefficient of each byte: the middle of its step, but at the ends of the range."""
    parts = (np.arange(256) + 0.5) / 256
    parts[[0, 255]] = 0, 1
    return ((parts - 0.5) * SH_RANGE).astype(np.float32)


# --- writing --------------------------------------------------------------------------------------


def order_of(splats: SplatParams) -> I64:
    """(N,) the order in which splats are written: a Morton curve, so that chunks are small."""
    return morton_order(splats.means.T)


def write(splats: SplatParams, info: SceneInfo, command: str) -> bytes:
    """A compressed `.ply`."""
    _warn_of_clipped(splats)
    splats = splats.take(order_of(splats))
    n, n_rest = len(splats), 3 * (splats.sh.shape[1] - 1)
    n_chunks = -(-n // CHUNK)
    log_scales = np.clip(splats.log_scales, -MAX_LOG_SCALE, MAX_LOG_SCALE)
    groups = [splats.means, log_scales, splats.sh[:, 0] * np.float32(C0) + np.float32(0.5)]
    bounds = [_bounds(values, n_chunks) for values in groups]
    parts = [_parts(values, *both) for values, both in zip(groups, bounds, strict=True)]
    parts[2] = np.concatenate([parts[2], sigmoid(splats.opacity_logits)[:, None]], axis=1)
    largest, rest = largest_and_rest(unit(splats.quats))
    words = np.stack(
        [
            _word(parts[0], (11, 10, 11), (21, 11, 0)),
            _word(rest / ROOT + np.float32(0.5), (10, 10, 10), (20, 10, 0))
            | largest.astype(np.uint32) << 30,
            _word(parts[1], (11, 10, 11), (21, 11, 0)),
            _word(parts[2], (8, 8, 8, 8), (24, 16, 8, 0)),
        ],
        axis=1,
    )
    sh = splats.sh[:, 1:].transpose(0, 2, 1).reshape(n, n_rest)
    stored = as_bytes(np.floor((sh / np.float32(SH_RANGE) + np.float32(0.5)) * 256))
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {line}" for line in (comment_of(command), *comments_of(info))]
    lines += [f"element chunk {n_chunks}", *(f"property float {name}" for name in BOUNDS)]
    lines += [f"element vertex {n}", *(f"property uint {name}" for name in WORDS)]
    if n_rest:
        lines += [f"element sh {n}", *(f"property uchar f_rest_{i}" for i in range(n_rest))]
    header = "\n".join([*lines, "end_header\n"]).encode("ascii")
    chunk = np.concatenate([side for both in bounds for side in both], axis=1).astype("<f4")
    return b"".join([header, chunk.tobytes(), words.astype("<u4").tobytes(), stored.tobytes()])


def _bounds(values: F32, n_chunks: int) -> tuple[F32, F32]:
    """(C, 3) the least and the greatest of each chunk."""
    starts = np.arange(n_chunks) * CHUNK
    if not n_chunks:
        return values, values
    return np.minimum.reduceat(values, starts, axis=0), np.maximum.reduceat(values, starts, axis=0)


def _parts(values: F32, low: F32, high: F32) -> F32:
    """Numbers as parts of the range of their chunk, 0 to 1."""
    of_splat = np.arange(len(values)) // CHUNK
    range_ = high.astype(np.float64) - low
    range_[range_ == 0] = 1
    return ((values - low.astype(np.float64)[of_splat]) / range_[of_splat]).astype(np.float32)


def _word(parts: F32, bits: tuple[int, ...], at: tuple[int, ...]) -> npt.NDArray[np.uint32]:
    """(N,) words with numbers of 0 to 1 in some bits: the inverse of `_fields`."""
    most = np.array([(1 << b) - 1 for b in bits])
    steps = np.rint(np.clip(parts, 0, 1) * most).astype(np.uint32)
    words: npt.NDArray[np.uint32] = np.bitwise_or.reduce(steps << np.array(at, np.uint32), axis=1)
    return words


def _warn_of_clipped(splats: SplatParams) -> None:
    beyond = (np.abs(splats.sh[:, 1:]) > SH_RANGE / 2).any((1, 2))
    beyond |= (np.abs(splats.log_scales) > MAX_LOG_SCALE).any(1)
    n_beyond = int(np.count_nonzero(beyond))
    if n_beyond:
        text = f"{n_beyond:,} of {len(splats):,} splats have SH or scales beyond what a compressed"
        warnings.warn(f"{text} .ply holds: the nearest that it holds are taken", stacklevel=2)
