"""What a target that no stream meets is refused with."""

from __future__ import annotations

import numpy as np

from evogs_codec.encoding.settings import MAX_PSNR
from evogs_codec.errors import InputError
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.splats import F64

__all__ = ["TargetMissedError", "bytes_missed", "errors_missed", "psnr_missed", "psnr_reached"]


class TargetMissedError(InputError):
    """No stream of a tree meets a target; `by` how much the nearest misses it."""

    def __init__(self, said: str, by: float) -> None:
        super().__init__(said)
        self.by = by


def psnr_missed(decibels: float, nearest: float, other: float, each: float) -> TargetMissedError:
    """That of a PSNR beyond an end of what streams have.

    Args:
        decibels: the target.
        nearest: PSNR at the end that is nearer to it, dB.
        other: at the other end.
        each: bytes of a splat at the nearer end.
    """
    least, most = sorted([nearest, other])
    said = f"{decibels:g} dB cannot be met: {psnr_reached(least, most)}"
    if least <= MAX_PSNR:
        said += f", {min(nearest, MAX_PSNR):.1f} dB with about {each:.1f} bytes a splat"
    return TargetMissedError(said, abs(nearest - decibels))


def psnr_reached(least: float, most: float, about: str = "") -> str:
    """Which PSNR, dB, streams have, in words; no more than may be asked for."""
    if least > MAX_PSNR:
        return f"every stream has more than {MAX_PSNR:g} dB; leave the target out"
    digits = 0 if about else 1
    return f"{about}{least:.{digits}f} to {min(most, MAX_PSNR):.{digits}f} dB can be reached"


def bytes_missed(n_bytes: int, nearest: int, other: int) -> TargetMissedError:
    """That of a number of bytes beyond an end of what streams take.

    Args:
        n_bytes: the target.
        nearest: bytes at the end that is nearer to it.
        other: at the other end.
    """
    least, most = sorted([nearest, other])
    said = f"{n_bytes:,} bytes cannot be met: {least:,} to {most:,} bytes can be reached"
    return TargetMissedError(said, abs(nearest - n_bytes))


def errors_missed(asked: F64, least: F64, of_tree: F64) -> TargetMissedError:
    """That of errors of which the least that were found are too large.

    Args:
        asked: (5,) per group.
        least: (5,) likewise, those of the tree among them.
        of_tree: (5,) `leaf_error` of `EncodeTask`.
    """
    worst = int(np.argmax(least / asked))
    own = of_tree[worst]
    is_of_tree = own > asked[worst] / 2 and least[worst] - own <= asked[worst]
    why = ", as float32 rounds the tree: try --levels 1" if is_of_tree else ""
    said = (
        f"{GROUPS[worst]}: an error of {asked[worst]:g} cannot be kept: it is at least"
        f" {least[worst]:.3g}{why}"
    )
    return TargetMissedError(said, float(least[worst] / asked[worst]))
