"""Huffman-coded literals of frames, compiled (spec 5.10, RFC 8878 3.1.1.3.1 and 4.2).

A stream is read if its codes take all of its bits, no more and no fewer (R-5.10-12), and a tree if
it keeps R-5.10-10 and R-5.10-13 to R-5.10-15. What would lead out of the bytes of the frame is
refused.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.format.compiled_bits import (
    below,
    bit_length,
    fill_states,
    mark,
    number,
    read_counts,
    top,
)
from evogs_codec.format.literals import MAX_BITS
from evogs_codec.model.splats import I32, I64, U8

__all__ = ["N_WEIGHTS", "read_streams", "read_tree"]

U16: TypeAlias = npt.NDArray[np.uint16]
_jit = jit()
_MAX_LOG = 6  # of FSE-coded weights
N_WEIGHTS = 256
_AT_ONCE = 57 // MAX_BITS  # codes that 8 bytes hold, whatever bit comes first


@_jit
def read_streams(
    frame: U8, at: int, end: int, n: int, is_one: bool, table: U16, log: int, out: U8
) -> bool:
    """The n literals of one stream, or of four behind their sizes, to `out`; False if refused.

    Args:
        frame: the whole frame, with its headers.
        at: where the streams, or their sizes, begin.
        end: where the last of them ends.
        n: how many.
        is_one: one stream.
        table: of the tree: a literal and the bits of its code, for each `log` bits.
        log: bits of the longest code.
        out: (at least n,) bytes.
    """
    if is_one:
        return _rest(frame, mark(frame, at, end), at, 0, n, table, log, out)
    a = at + 6
    if a > end or n < 6:  # R-5.10-8
        return False
    b = a + number(frame, at, 2)
    c = b + number(frame, at + 2, 2)
    d = c + number(frame, at + 4, 2)
    if d > end:
        return False
    at_a, at_b = mark(frame, a, b), mark(frame, b, c)
    at_c, at_d = mark(frame, c, d), mark(frame, d, end)
    each = (n + 3) // 4
    if 3 * each > n:
        return False
    # All four are read in turn, so that none waits for itself.
    out_a, out_b, out_c, out_d = out[:each], out[each:], out[2 * each :], out[3 * each :]
    shift, bits, done = np.uint64(64 - log), np.uint64(8), np.int64(0)
    while done + _AT_ONCE <= n - 3 * each:
        if at_a < 8 * a or at_b < 8 * b or at_c < 8 * c or at_d < 8 * d:
            return False
        word_a, word_b = top(frame, at_a), top(frame, at_b)
        word_c, word_d = top(frame, at_c), top(frame, at_d)
        sum_a = sum_b = sum_c = sum_d = np.uint64(0)
        for k in range(_AT_ONCE):
            to = np.uint64(done + k)
            one_a, one_b = np.uint64(table[word_a >> shift]), np.uint64(table[word_b >> shift])
            one_c, one_d = np.uint64(table[word_c >> shift]), np.uint64(table[word_d >> shift])
            out_a[to], out_b[to] = one_a, one_b
            out_c[to], out_d[to] = one_c, one_d
            one_a, one_b, one_c, one_d = one_a >> bits, one_b >> bits, one_c >> bits, one_d >> bits
            word_a, word_b = word_a << one_a, word_b << one_b
            word_c, word_d = word_c << one_c, word_d << one_d
            sum_a, sum_b, sum_c, sum_d = sum_a + one_a, sum_b + one_b, sum_c + one_c, sum_d + one_d
        at_a, at_b = at_a - np.int64(sum_a), at_b - np.int64(sum_b)
        at_c, at_d = at_c - np.int64(sum_c), at_d - np.int64(sum_d)
        done += _AT_ONCE
    return (
        _rest(frame, at_a, a, done, each, table, log, out_a)
        and _rest(frame, at_b, b, done, each, table, log, out_b)
        and _rest(frame, at_c, c, done, each, table, log, out_c)
        and _rest(frame, at_d, d, done, n - 3 * each, table, log, out_d)
    )


@_jit
def _rest(frame: U8, at: int, begin: int, done: int, n: int, table: U16, log: int, out: U8) -> bool:
    """Literals `done` to n of the stream that begins at `begin`; they take all bits below `at`."""
    shift = np.uint64(64 - log)
    for k in range(done, n):
        if at < 8 * begin:
            return False
        entry = np.int64(table[top(frame, at) >> shift])
        out[k] = entry & 255
        at -= entry >> 8
    return at == 8 * begin


@_jit
def read_tree(
    frame: U8, at: int, end: int, weights: U8, counts: I64, states: I32, table: U16
) -> tuple[int, int]:
    """(longest code, end of the description) of a tree, its table out; (0, 0) if refused.

    Args:
        frame: the whole frame.
        at: where the description begins.
        end: where the literals end.
        weights: (N_WEIGHTS,) of any content.
        counts: as of `read_counts`, of any content.
        states: (1 << 6,) of any content.
        table: (1 << MAX_BITS,), out.
    """
    if at >= end:
        return 0, 0
    head = np.int64(frame[at])
    size = head if head < 128 else (head - 126) // 2
    at += 1
    if at + size > end:
        return 0, 0
    if head < 128:
        n = _read_weights(frame, at, at + size, weights, counts, states)
    else:
        n = head - 127
        for k in range(n):
            weights[k] = (frame[at + k // 2] >> (0 if k & 1 else 4)) & 15
    ends = np.zeros(MAX_BITS + 2, np.int64)  # of the indices of each weight, then of a code of it
    total = np.int64(0)
    for k in range(n):
        weight = np.int64(weights[k])
        if weight > MAX_BITS:  # R-5.10-13
            return 0, 0
        ends[weight] += 1
        total += (1 << weight) >> 1
    log = bit_length(total)
    if total == 0 or log > MAX_BITS:
        return 0, 0
    rest = (np.int64(1) << log) - total
    last = bit_length(rest)
    if rest != 1 << (last - 1):
        return 0, 0
    weights[n] = last
    ends[last] += 1
    if ends[1] < 2:  # R-5.10-14
        return 0, 0
    first = np.int64(0)
    for weight in range(1, log + 1):
        first, ends[weight] = first + (ends[weight] << (weight - 1)), first
    for k in range(n + 1):
        weight = np.int64(weights[k])
        if weight:
            begin = ends[weight]
            ends[weight] = begin + (1 << (weight - 1))
            entry = np.uint16(k | (log + 1 - weight) << 8)
            for index in range(begin, ends[weight]):
                table[index] = entry
    return log, at + size


@_jit
def _read_weights(frame: U8, at: int, end: int, weights: U8, counts: I64, states: I32) -> int:
    """FSE-coded weights (RFC 8878, 4.2.1.2): how many; 0 if they cannot be read."""
    log, n, size = read_counts(frame[at:end], _MAX_LOG, N_WEIGHTS - 1, counts)
    begin = 8 * (at + size)
    at = mark(frame, at + size, end)
    if log == 0 or at < begin + 2 * log:  # R-5.10-10
        return 0
    fill_states(counts, n, log, states)
    now, other = states[below(frame, at, log)], states[below(frame, at - log, log)]
    at -= 2 * log
    n = 0
    while n < N_WEIGHTS - 2:
        weights[n] = now & 255
        n += 1
        n_bits = np.int64(now >> 8 & 255)
        if at - n_bits < begin:  # R-5.10-15
            weights[n] = other & 255
            return n + 1
        after = states[(now >> 16) + below(frame, at, n_bits)]
        at -= n_bits
        now, other = other, after
    return 0
