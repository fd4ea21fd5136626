"""Integers of a channel as byte planes, and the transforms before them (spec 5.9, 7.1).

Each transform stands beside its inverse. Letters: n values of a channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import Fault, StreamError
from evogs_codec.splats import I32, U8

__all__ = ["ABSENT", "Coding", "choose_coding", "split_planes", "join_planes", "zigzag", "unzigzag"]

MAX_STORED = 1 << 24  # z of 7.1: 2 high planes and 8 low bits
MAX_SUM = 1 << 28  # R-7.1-1


@dataclass(frozen=True)
class Coding:
    """A coding byte: how the integers of a channel are stored (spec 5.9)."""

    low: int
    high: int
    delta: bool = False

    @property
    def n_planes(self) -> int:
        return (self.low > 0) + self.high

    @property
    def bits(self) -> int:
        """Stored integers are below 2**bits."""
        return self.low + 8 * self.high if self.high else 0

    def byte(self) -> int:
        return self.low | self.high << 4 | self.delta << 6

    @staticmethod
    def of_byte(byte: int) -> Coding | None:
        """The coding, or None for a byte that R-5.9-2 forbids."""
        if byte == 0:
            return ABSENT
        low, high = byte & 15, byte >> 4 & 3
        if low > 8 or high not in (1, 2):
            return None
        return Coding(low, high, bool(byte & 64))


ABSENT = Coding(0, 0)


def zigzag(q: npt.NDArray[np.integer]) -> npt.NDArray[np.uint32]:
    """0, -1, 1, -2, 2 ... to 0, 1, 2, 3, 4 ..."""
    wide = q.astype(np.int64)
    return ((wide << 1) ^ (wide >> 63)).astype(np.uint32)


def unzigzag(z: npt.NDArray[np.integer]) -> I32:
    """The inverse of `zigzag`; z is below 2**24."""
    z = z.astype(np.int32, copy=False)
    return (z >> 1) ^ -(z & 1)


def delta(q: I32) -> I32:
    """Differences from the value before, the first from 0."""
    return np.diff(q, prepend=np.int32(0)).astype(np.int32)


def undelta(differences: I32, offset: int) -> I32:
    """The inverse of `delta`; E_RANGE if a running sum leaves its bounds (R-7.1-1)."""
    sums = np.cumsum(differences, dtype=np.int64)
    if sums.size and max(int(sums.max()), -int(sums.min())) > MAX_SUM:
        raise StreamError(Fault.E_RANGE, "a running sum of adds exceeds 2^28", offset)
    return sums.astype(np.int32)


def ycocg(rgb: I32) -> I32:
    """(3 T, n) rows R G B of T triples to rows Y Co Cg, reversibly."""
    r, g, b = rgb[0::3], rgb[1::3], rgb[2::3]
    out = np.empty_like(rgb)
    co = r - b
    t = b + (co >> 1)
    cg = g - t
    out[0::3], out[1::3], out[2::3] = t + (cg >> 1), co, cg
    return out


def inverse_ycocg(rows: I32) -> I32:
    """The inverse of `ycocg` (spec 7.1)."""
    y, co, cg = rows[0::3], rows[1::3], rows[2::3]
    out = np.empty_like(rows)
    t = y - (cg >> 1)
    b = t - (co >> 1)
    out[0::3], out[1::3], out[2::3] = b + co, cg + t, b
    return out


def entropy(symbols: npt.NDArray[np.integer]) -> float:
    """Order-0 entropy of non-negative symbols, in bits in all."""
    counts = np.bincount(symbols)
    counts = counts[counts > 0]
    n = symbols.size
    return float(n * np.log2(n) - (counts * np.log2(counts)).sum()) if n else 0.0


def choose_coding(z: npt.NDArray[np.uint32], *, is_delta: bool = False) -> Coding:
    """The coding of the least order-0 entropy of its planes.

    Few low bits keep the shape of a distribution in one plane; many keep a long tail out of it.

    Raises:
        ValueError: a value needs more than 24 bits.
    """
    top = int(z.max()) if z.size else 0
    if top == 0:
        return ABSENT
    if top >= MAX_STORED:
        raise ValueError(f"{top} needs more than 24 bits")
    bits = top.bit_length()
    if bits <= 8:
        return Coding(0, 1, is_delta)
    if bits > 16:
        return Coding(8, 2, is_delta) if bits > 23 else Coding(bits - 16, 2, is_delta)
    # A sample decides: its entropies rank the codings as the whole does.
    sample = z[:: max(1, z.size // 20000)]
    costs = {}
    for low in range(bits - 8, 9):
        costs[low] = entropy(sample >> low) + entropy(sample & ((1 << low) - 1))
    return Coding(min(costs, key=costs.__getitem__), 1, is_delta)


def split_planes(z: npt.NDArray[np.uint32], coding: Coding) -> list[bytes]:
    """The planes of stored integers, in the order of spec 5.9."""
    planes = []
    if coding.low:
        planes.append((z & ((1 << coding.low) - 1)).astype(np.uint8).tobytes())
    above = z >> coding.low
    planes += [(above >> (8 * k) & 255).astype(np.uint8).tobytes() for k in range(coding.high)]
    return planes


def join_planes(planes: list[U8], coding: Coding, n: int) -> npt.NDArray[np.integer]:
    """The n stored integers: uint8, uint16 or int32, the least that holds them."""
    if not coding.high:
        return np.zeros(n, np.uint8)
    if coding.bits == 8:
        return planes[0]
    dtype = np.uint16 if coding.bits <= 16 else np.int32
    planes = list(planes)
    lows = planes.pop(0) if coding.low else None
    z = planes[0].astype(dtype)
    if coding.high == 2:
        z |= planes[1].astype(dtype) << 8
    if lows is not None:
        z <<= coding.low
        z |= lows
    return z
