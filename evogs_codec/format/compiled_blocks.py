"""What `blocks` asks of a part, compiled: one pass over the bytes, and one over their counts."""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.format.compiled_costs import bits_of_counts
from evogs_codec.model.splats import I64, U8

__all__ = ["best_end", "huffman_bits_and_kinds"]

_jit = jit()


@_jit
def best_end(part: U8, entropy: I64, each: int, fixed: int, least: int) -> int:
    """Bytes of the first of two blocks; 0 if one is better.

    Args:
        part: (n,) bytes, at least 2 * least.
        entropy: of every count up to n, count * log2(count).
        each: cost of a byte in a code.
        fixed: cost of a block.
        least: bytes of a block, at least.
    """
    before, after = np.zeros(256, np.int64), np.zeros(256, np.int64)
    for byte in part:
        after[byte] += 1
    n, second, kinds = len(part), np.int64(0), np.int64(0)
    for count in after:
        second += entropy[count]
        kinds += count > 0
    first, best = np.int64(0), 0
    lowest = entropy[n] - second + each * kinds
    for i in range(n - least):
        byte = part[i]
        kinds += before[byte] == 0
        first += entropy[before[byte] + 1] - entropy[before[byte]]
        second -= entropy[after[byte]] - entropy[after[byte] - 1]
        before[byte] += 1
        after[byte] -= 1
        kinds -= after[byte] == 0
        if i + 1 >= least:
            cost = entropy[i + 1] - first + entropy[n - i - 1] - second + each * kinds + fixed
            if cost < lowest:
                lowest, best = cost, i + 1
    return best


@_jit
def huffman_bits_and_kinds(part: U8) -> tuple[int, int]:
    """`planes.huffman_bits` of bytes (n,), and how many kinds of them there are."""
    counts = np.zeros(256, np.int64)
    for byte in part:
        counts[byte] += 1
    kinds = 0
    for count in counts:
        kinds += count > 0
    return bits_of_counts(counts), kinds
