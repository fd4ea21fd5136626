"""`.splat`: 32 bytes for each splat, without a header; SH of band 0 only.

Letters: N splats.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np

from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import read_bytes
from evogs_codec.io.interchange.values import (
    BYTE_COLOURS,
    BYTE_LOGITS,
    C0,
    as_bytes,
    log_scales_of,
    sigmoid,
    unit,
)
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import I64, SplatParams

__all__ = ["is_splat", "order_of", "read", "write"]

ROW = np.dtype(
    [("means", "<f4", 3), ("scales", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)]
)
N_SAMPLED = 4096  # rows by which a file is judged
FARTHEST = 1e9  # units; a position beyond is not one


def is_splat(path: Path, start: bytes) -> bool:
    """Whether a file seems to be a `.splat`: it has no magic, so its name and numbers decide."""
    whole = os.stat(path).st_size % ROW.itemsize == 0  # noqa: PTH116 - a Path may be a device
    rows = np.frombuffer(start[: len(start) // ROW.itemsize * ROW.itemsize], ROW)[:N_SAMPLED]
    return path.suffix.lower() == ".splat" and whole and len(rows) > 0 and _plausible(rows)


def _plausible(rows: np.ndarray) -> bool:
    with np.errstate(invalid="ignore"):
        placed = (np.abs(rows["means"]) < FARTHEST).all(1)
        sized = ((rows["scales"] >= 0) & (rows["scales"] < FARTHEST)).all(1)
    return bool(np.mean(placed & sized) > 0.9) and bool(rows["scales"].any())


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of a `.splat`, whose frame is that of a `.ply`.

    Raises:
        InputError: its size is not that of whole splats.
    """
    data = read_bytes(path)
    if len(data) % ROW.itemsize:
        raise InputError(f"{path}: {len(data):,} bytes are not whole splats of {ROW.itemsize}")
    rows = np.frombuffer(data, ROW)
    splats = SplatParams(
        rows["means"].astype(np.float32),
        ((rows["rotation"].astype(np.float32) - 128) / 128).astype(np.float32),
        log_scales_of(rows["scales"]),
        BYTE_LOGITS[rows["colour"][:, 3]],
        BYTE_COLOURS[rows["colour"][:, None, :3]],
    )
    return splats, SceneInfo()


def write(splats: SplatParams, _info: SceneInfo, _command: str) -> bytes:
    """A `.splat`: the splats that fill most of a view first, since viewers draw what is there.

    Raises:
        InputError: `read_scene` could not tell the file.
    """
    if splats.sh_degree:
        warnings.warn("a .splat has no SH above band 0: they are left out", stacklevel=2)
    splats = splats.take(order_of(splats))
    rows = np.empty(len(splats), ROW)
    rows["means"] = splats.means
    with np.errstate(over="ignore"):
        rows["scales"] = np.minimum(np.exp(splats.log_scales), np.finfo(np.float32).max)
    rows["colour"][:, :3] = as_bytes((splats.sh[:, 0] * C0 + 0.5) * 255)
    rows["colour"][:, 3] = as_bytes(sigmoid(splats.opacity_logits) * 255)
    rows["rotation"] = as_bytes(unit(splats.quats) * 128 + 128)
    if not len(rows) or not _plausible(rows[:N_SAMPLED]):
        raise InputError(
            "a .splat is told by its numbers: one without splats, or with positions or scales of"
            f" {FARTHEST:g} and more, could not be read again; name a .ply"
        )
    _warn_of_clipped(splats)
    return rows.tobytes()


def _warn_of_clipped(splats: SplatParams) -> None:
    n_beyond = int(np.count_nonzero((np.abs(splats.sh[:, 0]) > 0.5 / C0).any(1)))
    if n_beyond:
        text = f"{n_beyond:,} of {len(splats):,} splats have colours beyond what a .splat"
        warnings.warn(f"{text} holds: the nearest that it holds are taken", stacklevel=2)


def order_of(splats: SplatParams) -> I64:
    """(N,) the order in which splats are written: by volume times opacity, the largest first."""
    size = splats.log_scales.sum(1, dtype=np.float64)
    with np.errstate(divide="ignore"):
        weight = size + np.log(sigmoid(splats.opacity_logits).astype(np.float64))
    order: I64 = np.argsort(-weight, kind="stable")
    return order
