"""Where a frame is divided into blocks (spec 5.10): parts whose bytes are unlike have own codes.

Each block of a frame has a Huffman code of its own. A list of refines may begin with splats that
are shown and end with splats that were hidden, whose opacities are far from those of the others.

The division is recursive: at the place where the entropy of the two sides is the least, as long as
codes of their own, with what they cost beside, take fewer bits than one.

Letters: n bytes of a part.
"""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np

from evogs_codec.format.grouping import SYMBOL_BYTES
from evogs_codec.format.planes import huffman_bits
from evogs_codec.model.splats import I64, U8

__all__ = ["block_ends"]

BLOCK_BYTES = 16.0  # bytes: of the headers of a block
MAX_PART = 128 << 10  # bytes of a part that is divided; R-5.10-5
MIN_BLOCK = 64  # bytes of a block that is made here
MAX_DEPTH = 12  # divisions of divisions
UNIT = 256  # of a bit: entropies are whole numbers, the same for numpy and compiled code
MAY_COMPILE = True  # False: as without numba

_COUNTS = np.arange(1, MAX_PART + 1)
# n log2 n of every n, and what a count more adds.
_ENTROPY = np.append(0, np.rint(UNIT * _COUNTS * np.log2(_COUNTS))).astype(np.int64)
_STEP = np.diff(_ENTROPY)


def block_ends(content: bytes) -> list[int]:
    """Ends of all blocks but the last, in order; none if one code serves all bytes best."""
    found: list[int] = []
    symbols = np.frombuffer(content, np.uint8)
    for begin in range(0, len(symbols), MAX_PART):
        _, ends = _divided(symbols[begin : begin + MAX_PART], MAX_DEPTH)
        found += [begin + end for end in ends]
    return found


def _divided(part: U8, depth: int) -> tuple[float, list[int]]:
    """Bits of a part (n,) with its codes, and where it is divided."""
    bits, kinds = _bits_and_kinds(part)
    whole = bits + 8 * (BLOCK_BYTES + SYMBOL_BYTES * kinds)
    end = _best_end(part) if depth and len(part) >= 2 * MIN_BLOCK else 0
    if not end:
        return whole, []
    (first, before), (second, after) = (_divided(p, depth - 1) for p in (part[:end], part[end:]))
    if first + second >= whole:
        return whole, []
    return first + second, [*before, end, *(end + other for other in after)]


def _compiled() -> ModuleType | None:
    """The compiled loops where numba is loaded."""
    if not MAY_COMPILE or sys.modules.get("numba") is None:
        return None
    from evogs_codec.format import compiled_blocks

    return compiled_blocks


def _bits_and_kinds(part: U8) -> tuple[float, int]:
    """Bits of a part (n,) with a code of its own, and how many kinds of bytes it has."""
    compiled = _compiled()
    if compiled is not None:
        bits, kinds = compiled.huffman_bits_and_kinds(part)
        return float(bits), int(kinds)
    return huffman_bits(part), int(np.count_nonzero(np.bincount(part)))


def _best_end(part: U8) -> int:
    """Bytes of the first of two blocks by their entropies; 0 if one is better, by this estimate."""
    each, fixed = round(8 * UNIT * SYMBOL_BYTES), round(8 * UNIT * BLOCK_BYTES)
    compiled = _compiled()
    if compiled is not None:
        return int(compiled.best_end(part, _ENTROPY, each, fixed, MIN_BLOCK))
    return _best_end_by_numpy(part, each, fixed)


def _best_end_by_numpy(part: U8, each: int, fixed: int) -> int:
    n = len(part)
    counts = np.bincount(part, minlength=256)
    before = _occurrences(part, counts)  # of the same byte
    after = counts[part] - before - 1
    first = np.cumsum(_STEP[before])[:-1]
    second = _ENTROPY[counts].sum() - np.cumsum(_STEP[after])[:-1]
    lengths = np.arange(1, n)
    bits = _ENTROPY[lengths] - first + _ENTROPY[n - lengths] - second
    kinds = np.cumsum(before == 0)[:-1] + np.count_nonzero(counts) - np.cumsum(after == 0)[:-1]
    costs = bits + each * kinds + fixed
    some = costs[MIN_BLOCK - 1 : n - MIN_BLOCK]
    whole = _ENTROPY[n] - _ENTROPY[counts].sum() + each * np.count_nonzero(counts)
    best = int(np.argmin(some))
    return best + MIN_BLOCK if some[best] < whole else 0


def _occurrences(part: U8, counts: I64) -> I64:
    """(n,) how often the same byte comes before each."""
    order = np.argsort(part, kind="stable")
    found = np.empty(len(part), np.int64)
    found[order] = np.arange(len(part)) - np.repeat(np.cumsum(counts) - counts, counts)
    return found
