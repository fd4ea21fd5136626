"""Integers of a channel as byte planes, and the transforms before them (spec 5.9, 7.1).

Each transform stands beside its inverse. Letters: n values of a channel. Decoders may take several
channels with the same coding at once: `...` is nothing, or one axis before the last.
"""

from __future__ import annotations

import heapq
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import Fault, StreamError
from evogs_codec.model.splats import F64, I32, U8

__all__ = ["ABSENT", "Coding", "choose_coding", "join_planes", "split_planes", "unzigzag", "zigzag"]

MAX_STORED = 1 << 24  # z of 7.1: 2 high planes and 8 low bits
MAX_SUM = 1 << 28  # R-7.1-1
SAMPLE_RUN = 8192
MAY_COMPILE = True  # False: costs are counted as without numba
MANY_BYTES = 1 << 17  # of planes: above, a call for each plane costs little
PART = 1 << 15  # values that are joined at a time: larger arrays come from the system page by page


@dataclass(frozen=True)
class Coding:
    """A coding byte: how the integers of a channel are stored (spec 5.9).

    `low` bits of each in a plane of their own, packed if they are 1, 2 or 4; `high` planes above.
    """

    low: int
    high: int
    delta: bool = False

    @property
    def n_planes(self) -> int:
        """Planes of a list stored so."""
        return (self.low > 0) + self.high

    @property
    def bits(self) -> int:
        """Stored integers are below 2**bits."""
        return self.low + 8 * self.high

    def plane_sizes(self, n: int) -> list[int]:
        """Bytes of each plane of n values."""
        lows = [-(-n * self.low // 8) if self.low in PACKED else n] if self.low else []
        return lows + [n] * self.high

    def byte(self) -> int:
        """The coding byte."""
        return self.low | self.high << 4 | self.delta << 6

    @staticmethod
    def of_byte(byte: int) -> Coding | None:
        """The coding, or None for a byte that R-5.9-2 forbids."""
        if byte == 0:
            return ABSENT
        low, high = byte & 15, byte >> 4 & 3
        if low > 8 or high > 2 or low + high == 0 or byte >> 7:
            return None
        return Coding(low, high, bool(byte & 64))


ABSENT = Coding(0, 0)
# The coding of every byte; the same object for the same byte, so `is ABSENT` works.
CODINGS: tuple[Coding | None, ...] = (ABSENT, *map(Coding.of_byte, range(1, 256)))
PACKED = (1, 2, 4)  # numbers of low bits that are packed 8, 4, 2 to a byte


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


def undelta(differences: I32, offset: int, out: I32 | None = None) -> I32:
    """The inverse of `delta`, (..., n); E_RANGE if a sum leaves its bounds (R-7.1-1).

    It is written to `out`, which may be the differences.
    """
    out = np.empty(differences.shape, np.int32) if out is None else out
    before = np.zeros((*differences.shape[:-1], 1), np.int64)
    for at in range(0, differences.shape[-1], PART):
        sums = np.cumsum(differences[..., at : at + PART], axis=-1, dtype=np.int64)
        sums += before
        if sums.size and max(int(sums.max()), -int(sums.min())) > MAX_SUM:
            raise StreamError(Fault.E_RANGE, "a running sum of adds exceeds 2^28", offset)
        out[..., at : at + PART], before = sums, sums[..., -1:]
    return out


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


def entropies(planes: U8, sizes: Sequence[int]) -> list[float]:
    """`entropy` of each of some planes, which follow one another."""
    if len(planes) > MANY_BYTES:
        ends = np.cumsum(sizes)
        return [entropy(planes[end - n : end]) for end, n in zip(ends, sizes, strict=True)]
    # One call for all of them: many small planes cost a call each otherwise.
    lengths = np.array(sizes, np.int64)
    owner = np.repeat(np.arange(len(lengths)) * 256, lengths)
    counts = np.bincount(owner + planes, minlength=256 * len(lengths)).reshape(-1, 256)
    logs = np.log2(counts, out=np.zeros(counts.shape), where=counts > 0)
    of_lengths = np.log2(lengths, out=np.zeros(lengths.shape), where=lengths > 0)
    found: list[float] = (lengths * of_lengths - (counts * logs).sum(1)).tolist()
    return found


def huffman_bits(symbols: npt.NDArray[np.integer]) -> float:
    """Bits that a Huffman code of its own spends on byte symbols, as Zstandard does to a plane."""
    counts = np.bincount(symbols)
    left: list[int] = counts[counts > 0].tolist()
    if len(left) < 2:
        return 0.0
    heapq.heapify(left)
    total = 0
    while len(left) > 1:
        pair = heapq.heappop(left) + left[0]
        total += pair
        heapq.heapreplace(left, pair)
    return float(total)


def choose_coding(z: npt.NDArray[np.integer], *, is_delta: bool = False) -> tuple[Coding, float]:
    """The coding with the fewest bits by `huffman_bits` of its planes, and those bits.

    Few low bits keep the shape of a distribution in one plane, many keep a long tail out of it;
    packed ones let a symbol cost less than a bit.

    Raises:
        ValueError: a value needs more than 24 bits.
    """
    top = int(z.max()) if z.size else 0
    if top == 0:
        return ABSENT, 0.0
    if top >= MAX_STORED:
        raise ValueError(f"{top} needs more than 24 bits")
    bits = top.bit_length()
    # A sample decides: its costs rank the codings as the whole does. Runs, since bits are packed.
    sample = z
    if z.size > 4 * SAMPLE_RUN:
        starts = np.linspace(0, z.size - SAMPLE_RUN, 4).astype(np.int64)
        sample = np.concatenate([z[at : at + SAMPLE_RUN] for at in starts])
    costs = huffman_costs(sample, bits)
    low = int(np.argmin(costs))
    return Coding(low, _high(low, bits), is_delta), float(costs[low]) * z.size / sample.size


def huffman_costs(z: npt.NDArray[np.integer], bits: int) -> F64:
    """(9,) `huffman_bits` of all planes, by the number of low bits; inf where planes are too many.

    Args:
        z: (n,) stored integers.
        bits: of the largest.
    """
    if MAY_COMPILE and sys.modules.get("numba") is not None:
        from evogs_codec.format import compiled_costs

        found: F64 = compiled_costs.huffman_costs(z.astype(np.uint32, copy=False), bits)
        return found
    costs = np.full(9, np.inf)
    for low in range(9):
        high = _high(low, bits)
        if high <= 2 and (low or high):
            planes = split_planes(z, Coding(low, high))
            costs[low] = sum(huffman_bits(np.frombuffer(plane, np.uint8)) for plane in planes)
    return costs


def _high(low: int, bits: int) -> int:
    """Planes above so many low bits."""
    return -(-max(bits - low, 0) // 8)


def split_planes(z: npt.NDArray[np.integer], coding: Coding) -> list[bytes]:
    """The planes of stored integers, in the order of spec 5.9."""
    planes = []
    if coding.low:
        lows = (z & ((1 << coding.low) - 1)).astype(np.uint8)
        planes.append((_pack(lows, coding.low) if coding.low in PACKED else lows).tobytes())
    above = z >> coding.low
    planes += [(above >> (8 * k) & 255).astype(np.uint8).tobytes() for k in range(coding.high)]
    return planes


def join_planes(planes: Sequence[U8], coding: Coding, n: int) -> npt.NDArray[np.integer]:
    """The (..., n) stored integers: uint8, uint16 or int32, the least that holds them."""
    if coding == ABSENT:
        return np.zeros(n, np.uint8)
    lows = planes[0] if coding.low else None
    if lows is not None and coding.low in PACKED:
        lows = _unpack(lows, coding.low, n)
    highs = planes[coding.low > 0 :]
    if not highs:
        assert lows is not None
        return lows
    if lows is None and len(highs) == 1:
        return highs[0]
    dtype: np.dtype[np.integer] = np.dtype(np.uint16 if coding.bits <= 16 else np.int32)
    z = highs[0].astype(dtype)
    if len(highs) == 2:
        z |= highs[1].astype(dtype) << 8
    if lows is not None:
        z <<= coding.low
        z |= lows
    return z


def planes_at(data: U8, start: int, coding: Coding, n: int) -> list[U8]:
    """Views of the planes of a list of n values that begin at `start` of the last axis."""
    planes = []
    for size in coding.plane_sizes(n):
        planes.append(data[..., start : start + size])
        start += size
    return planes


def integers(
    data: U8, starts: Sequence[int], coding: Coding, out: I32, rows: Sequence[int]
) -> None:
    """The integers of lists with the same coding, without `undelta`, to rows of `out` (..., n).

    `starts` says where in `data` the planes of each begin.
    """
    n = out.shape[1]
    sizes = coding.plane_sizes(n)
    to: slice | list[int] = slice(0, len(out)) if len(rows) == len(out) else list(rows)
    for at in range(0, n, PART):  # a multiple of 8: packed planes begin a byte with each part
        m = min(PART, n - at)
        planes, begin = [], 0
        for k, (size, size_of_part) in enumerate(zip(sizes, coding.plane_sizes(m), strict=True)):
            is_packed = k == 0 and coding.low in PACKED
            first = begin + (at * coding.low // 8 if is_packed else at)
            parts = [data[start + first : start + first + size_of_part] for start in starts]
            planes.append(parts[0][None] if len(parts) == 1 else np.stack(parts))
            begin += size
        out[to, at : at + m] = unzigzag(join_planes(planes, coding, m))


def stray_bits(planes: Sequence[U8], coding: Coding, n: int) -> bool:
    """A bit is set in a low plane where no value has one (R-5.9-9)."""
    if not coding.low:
        return False
    if coding.low not in PACKED:
        return bool(int(planes[0].max()) >> coding.low)
    used = n * coding.low % 8
    return bool(used and int(planes[0][-1]) >> used)


def _pack(values: U8, bits: int) -> U8:
    """8 / bits values to a byte, the first in the lowest bits."""
    per_byte = 8 // bits
    padded = np.zeros(-(-len(values) // per_byte) * per_byte, np.uint8)
    padded[: len(values)] = values
    rows = padded.reshape(-1, per_byte)
    out = rows[:, 0].copy()
    for k in range(1, per_byte):
        out |= rows[:, k] << (k * bits)
    return out


def _unpack(packed: U8, bits: int, n: int) -> U8:
    """The inverse of `_pack`, (..., n)."""
    per_byte = 8 // bits
    out = np.empty((*packed.shape, per_byte), np.uint8)
    for k in range(per_byte):
        out[..., k] = packed >> (k * bits) & ((1 << bits) - 1)
    return out.reshape(*packed.shape[:-1], -1)[..., :n]
