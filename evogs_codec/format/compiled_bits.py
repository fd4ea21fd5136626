"""Bits of Zstandard frames and tables of FSE codes, compiled (RFC 8878, 4.1).

Nothing here raises: what a table may not hold is told by a log of 0. Callers see to it that what is
read lies in the frame.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import I32, I64, U8

__all__ = [
    "below",
    "bit_length",
    "fill_states",
    "mark",
    "number",
    "put_word",
    "read_counts",
    "top",
    "word_at",
]

_jit = jit()

_BIT_LENGTHS = np.array([k.bit_length() for k in range(1024)], np.int64)


@_jit
def bit_length(value: int) -> int:
    """Bits of a number that is not negative."""
    found = np.int64(0)
    while value >= len(_BIT_LENGTHS):
        value >>= 8
        found += 8
    return found + _BIT_LENGTHS[value]


@_jit
def number(data: U8, at: int, n_bytes: int) -> int:
    """A little-endian number of up to 7 bytes; past the end are zeros."""
    found = np.int64(0)
    for k in range(min(n_bytes, len(data) - at)):
        found |= np.int64(data[at + k]) << (8 * k)
    return found


@_jit
def mark(frame: U8, begin: int, end: int) -> int:
    """The bit behind the first one of a stream, in bits of the frame; -1 if it has no end mark."""
    if begin >= end or frame[end - 1] == 0:
        return -1
    return 8 * end - 9 + bit_length(frame[end - 1])


@_jit
def word_at(data: U8, at: int) -> np.uint64:
    """The 8 bytes from `at` on, the first in the lowest bits, in one load."""
    first = np.uint64(at)  # of an index that may be below 0 numba makes no plain load
    return (
        np.uint64(data[first])
        | np.uint64(data[first + np.uint64(1)]) << np.uint64(8)
        | np.uint64(data[first + np.uint64(2)]) << np.uint64(16)
        | np.uint64(data[first + np.uint64(3)]) << np.uint64(24)
        | np.uint64(data[first + np.uint64(4)]) << np.uint64(32)
        | np.uint64(data[first + np.uint64(5)]) << np.uint64(40)
        | np.uint64(data[first + np.uint64(6)]) << np.uint64(48)
        | np.uint64(data[first + np.uint64(7)]) << np.uint64(56)
    )


@_jit
def put_word(word: np.uint64, out: U8, at: int) -> None:
    """The inverse of `word_at`, in one store."""
    first = np.uint64(at)
    out[first] = np.uint8(word)
    out[first + np.uint64(1)] = np.uint8(word >> np.uint64(8))
    out[first + np.uint64(2)] = np.uint8(word >> np.uint64(16))
    out[first + np.uint64(3)] = np.uint8(word >> np.uint64(24))
    out[first + np.uint64(4)] = np.uint8(word >> np.uint64(32))
    out[first + np.uint64(5)] = np.uint8(word >> np.uint64(40))
    out[first + np.uint64(6)] = np.uint8(word >> np.uint64(48))
    out[first + np.uint64(7)] = np.uint8(word >> np.uint64(56))


@_jit
def top(frame: U8, at: int) -> np.uint64:
    """The bits below bit `at`, 57 of them at least; before a stream are 12 bytes of headers."""
    end = (at + 7) >> 3
    return word_at(frame, end - 8) << np.uint64(8 * end - at)


@_jit
def below(frame: U8, at: int, n: int) -> int:
    """The number of the n bits below bit `at`, up to 56."""
    return np.int64((top(frame, at) >> np.uint64(1)) >> np.uint64(63 - n))


@_jit
def read_counts(coded: U8, max_log: int, max_symbol: int, counts: I64) -> tuple[int, int, int]:
    """The description of a table: its log, its symbols, its bytes; (0, 0, 0) if refused.

    Args:
        coded: bytes that begin with it.
        max_log: the largest log that it may have.
        max_symbol: its largest symbol.
        counts: (at least max_symbol + 5,) states of each symbol, out; -1 of rare ones.
    """
    if len(coded) == 0:
        return 0, 0, 0
    log, at = np.int64(5 + (coded[0] & 15)), np.int64(4)
    if log > max_log:
        return 0, 0, 0
    left, n = np.int64(1) << log, np.int64(0)
    while left > 0:
        half = np.int64(1) << (bit_length(left + 1) - 1)
        short = 2 * half - 2 - left  # so many values take a bit less
        value = (number(coded, at >> 3, 3) >> (at & 7)) & (2 * half - 1)
        at += bit_length(half)
        if value & (half - 1) < short:
            value &= half - 1
            at -= 1
        elif value >= half:
            value -= short
        if n > max_symbol or at > 8 * len(coded):
            return 0, 0, 0
        counts[n] = value - 1
        left -= abs(value - 1)
        n += 1
        more = np.int64(3 if value == 1 else 0)
        while more == 3:
            more = (number(coded, at >> 3, 2) >> (at & 7)) & 3
            at += 2
            if n + more > max_symbol + 1 or at > 8 * len(coded):
                return 0, 0, 0
            counts[n : n + more] = 0
            n += more
    if left < 0:
        return 0, 0, 0
    return log, n, (at + 7) >> 3


@_jit
def fill_states(counts: I64, n: int, log: int, states: I32) -> None:
    """The table of n symbols, out (RFC 8878, 4.1.1): symbol, bits and base of the next state.

    A byte each, the base in the bytes above them. `counts` is used up.
    """
    size = np.int64(1) << log
    rare = size
    for symbol in range(n):
        if counts[symbol] < 0:
            rare -= 1
            states[rare] = symbol
    state = np.int64(0)
    for symbol in range(n):
        for _ in range(counts[symbol]):
            states[state] = symbol
            state = (state + (size >> 1) + (size >> 3) + 3) & (size - 1)
            while state >= rare:
                state = (state + (size >> 1) + (size >> 3) + 3) & (size - 1)
    for state in range(size):
        symbol = np.int64(states[state])
        count = abs(counts[symbol])
        counts[symbol] = count + 1
        n_bits = log + 1 - bit_length(count)
        states[state] = symbol | n_bits << 8 | ((count << n_bits) - size) << 16
