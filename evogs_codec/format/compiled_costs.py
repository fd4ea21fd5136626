"""`planes.huffman_costs`, compiled: the bits of every coding of a list from one count of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import F64, I64

__all__ = ["bits_of_counts", "huffman_costs"]

Stored = npt.NDArray[np.uint32]
_jit = jit()
_COUNTED = 16  # bits of values that are counted, each once; longer ones are looked at one by one


@_jit
def huffman_costs(z: Stored, bits: int) -> F64:
    """(9,) bits of a Huffman code for each plane, by the number of low bits; inf: too many planes.

    Args:
        z: (n,) stored integers.
        bits: of the largest.
    """
    if bits <= _COUNTED:
        values, counts = _counted(z, bits)
    else:
        values, counts = z.astype(np.int64), np.ones(len(z), np.int64)
    costs = np.full(9, np.inf)
    symbols = np.empty(256, np.int64)
    for low in range(9):
        high = (max(bits - low, 0) + 7) // 8
        if high > 2 or low + high == 0:
            continue
        total = 0
        if low == 1 or low == 2 or low == 4:
            _count_packed(z, low, symbols)
            total += bits_of_counts(symbols)
        elif low:
            symbols[:] = 0
            for k in range(len(values)):
                symbols[values[k] & ((1 << low) - 1)] += counts[k]
            total += bits_of_counts(symbols)
        for plane in range(high):
            symbols[:] = 0
            for k in range(len(values)):
                symbols[values[k] >> (low + 8 * plane) & 255] += counts[k]
            total += bits_of_counts(symbols)
        costs[low] = total
    return costs


@_jit
def _counted(z: Stored, bits: int) -> tuple[I64, I64]:
    """The values that occur, and how often each does."""
    found = np.zeros(1 << bits, np.int64)
    for k in range(len(z)):
        found[z[k]] += 1
    values = np.flatnonzero(found)
    return values, found[values]


@_jit
def _count_packed(z: Stored, low: int, symbols: I64) -> None:
    """Count the bytes of a packed plane of the low bits."""
    symbols[:] = 0
    per_byte, mask = 8 // low, (1 << low) - 1
    for begin in range(0, len(z), per_byte):
        byte = 0
        for k in range(min(per_byte, len(z) - begin)):
            byte |= (np.int64(z[begin + k]) & mask) << (k * low)
        symbols[byte] += 1


@_jit
def bits_of_counts(symbols: I64) -> int:
    """Bits of all symbols that occur so often, as `planes.huffman_bits`."""
    leaves = np.sort(symbols[symbols > 0])
    n = len(leaves)
    if n < 2:
        return 0
    # Sums come in order of size: the least is the first of the leaves or of the sums that are left.
    sums = np.empty(n - 1, np.int64)
    leaf = first = 0
    total = 0
    for made in range(n - 1):
        pair = 0
        for _ in range(2):
            if leaf < n and (first >= made or leaves[leaf] <= sums[first]):
                pair += leaves[leaf]
                leaf += 1
            else:
                pair += sums[first]
                first += 1
        sums[made] = pair
        total += pair
    return total
