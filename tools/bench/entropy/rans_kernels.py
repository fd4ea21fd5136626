"""The loops of `rans`, compiled: lanes, bits and tables."""

# As in the kernels of the codec: to numba an int is any integer of numpy.
# mypy: disable-error-code="assignment, return-value"

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from evogs_codec.splats import I32, I64, U8

__all__ = [
    "LEAST",
    "MANTISSA",
    "N_LANES",
    "decode_known",
    "decode_neighbour",
    "decode_plain",
    "encode_list",
    "join_raw",
    "read_model",
    "write_bits",
]

U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]
U64 = npt.NDArray[np.uint64]
Function = TypeVar("Function", bound=Callable[..., object])
N_LANES = 8
LEAST = 1 << 16  # states are at least this before each token; then 16 bits refill any of them
MANTISSA = 3  # bits of a frequency below its first that are stored
TABLE_BITS = 12
TOTAL = 1 << TABLE_BITS
SLOT, TOKEN = np.uint32(TOTAL - 1), np.uint32(255)
HALF, TABLE = np.uint32(16), np.uint32(TABLE_BITS)


def _jit(function: Function) -> Function:
    return cast(Function, numba.njit(nogil=True, cache=True, boundscheck=False)(function))


def _inlined(function: Function) -> Function:
    compiled = numba.njit(nogil=True, cache=True, boundscheck=False, forceinline=True)(function)
    return cast(Function, compiled)


@_jit
def encode_list(
    tokens: I32, tables: U8, frequencies: I64, starts: I64, states: I64, words: U16, n_words: int
) -> int:
    """Put a list before those in `states` and `words`; returns the new number of words."""
    n = len(tokens)
    run = (n + N_LANES - 1) // N_LANES
    for row in range(run - 1, -1, -1):
        for lane in range(N_LANES - 1, -1, -1):
            i = lane * run + row
            if i >= n:
                continue
            frequency = frequencies[tables[i], tokens[i]]
            x = states[lane]
            if x >= frequency << 20:
                words[n_words] = x & 0xFFFF
                n_words += 1
                x >>= 16
            states[lane] = (
                (x // frequency << TABLE_BITS) + x % frequency + starts[tables[i], tokens[i]]
            )
    return n_words


@_jit
def decode_plain(words: U16, word: int, states: U32, lookup: U32, out: I32) -> int:
    """Tokens of a list with one table; returns the next word."""
    n = len(out)
    run = (n + N_LANES - 1) // N_LANES
    whole = max(n - (N_LANES - 1) * run, 0)
    for row in range(run):
        for lane in range(N_LANES):
            i = lane * run + row
            if row < whole or i < n:
                out[i], word = _token(words, word, states, lane, lookup, np.uint32(0))
    return word


@_jit
def decode_neighbour(
    words: U16, word: int, states: U32, lookup: U32, table_of_token: U8, out: I32
) -> int:
    """Tokens of a list whose tables follow from the token before; returns the next word."""
    n = len(out)
    run = (n + N_LANES - 1) // N_LANES
    whole = max(n - (N_LANES - 1) * run, 0)
    tables = np.full(N_LANES, table_of_token[0], np.uint8)
    for row in range(run):
        for lane in range(N_LANES):
            i = lane * run + row
            if row < whole or i < n:
                out[i], word = _token(words, word, states, lane, lookup, np.uint32(tables[lane]))
                tables[lane] = table_of_token[out[i]]
    return word


@_jit
def decode_known(
    words: U16,
    word: int,
    states: U32,
    lookup: U32,
    class_of: U8,
    table_of: U8,
    magnitudes: I32,
    out: I32,
) -> int:
    """Tokens of a list whose tables follow from magnitudes; returns the next word."""
    n, most = len(out), np.int32(len(class_of) - 1)
    tables = np.empty(n, np.uint8)
    for i in range(n):
        tables[i] = table_of[class_of[min(magnitudes[i], most)]]
    run = (n + N_LANES - 1) // N_LANES
    whole = max(n - (N_LANES - 1) * run, 0)
    for row in range(run):
        for lane in range(N_LANES):
            i = lane * run + row
            if row < whole or i < n:
                out[i], word = _token(words, word, states, lane, lookup, np.uint32(tables[i]))
    return word


@_inlined
def _token(
    words: U16, word: int, states: U32, lane: int, lookup: U32, table: np.uint32
) -> tuple[np.uint32, int]:
    """The next token of a lane and the next word; the lane is refilled where it runs low."""
    entry = lookup[table << TABLE | states[lane] & SLOT]
    frequency = (entry >> np.uint32(8) & SLOT) + np.uint32(1)
    x = frequency * (states[lane] >> TABLE) + (entry >> np.uint32(20))
    low = x < LEAST
    refilled = x << HALF | np.uint32(words[word])  # no branch: which is in vain
    states[lane] = refilled if low else x
    return entry & TOKEN, word + low


@_jit
def join_raw(bits: U64, at: int, bases: I32, n_raw: U8, low: int, out: I32) -> int:
    """Tokens to integers, in place; returns the next bit."""
    place, six, all_but_one = np.uint64(at), np.uint64(63), np.uint64(63)
    for i in range(len(out)):
        token = np.uint64(out[i])
        need, word, bit = np.uint64(n_raw[token]), place >> np.uint64(6), place & six
        pair = bits[word] >> bit | bits[word + np.uint64(1)] << (all_but_one - bit) << np.uint64(1)
        raw = pair & ((np.uint64(1) << need) - np.uint64(1))
        out[i] = bases[token] + (np.int32(raw) << low)
        place += need
    return np.int64(place)


@_jit
def read_model(bits: U8, at: int, model: I64, table_of: U8, lookup: U32) -> int:
    """How a list is coded: split, context and T in `model`, the tables; returns the next bit."""
    model[0], model[1] = _bits(bits, at, 3), _bits(bits, at + 3, 3)
    n_tables, n_tokens = _bits(bits, at + 6, 3) + 1, _bits(bits, at + 9, 8) + 1
    model[2], at = n_tokens, at + 17
    table_of[:] = n_tables - 1
    first = 0
    for k in range(n_tables - 1):
        last = _bits(bits, at, 5)
        table_of[first : last + 1] = k
        first, at = last + 1, at + 5
    frequencies = np.empty(n_tokens, np.int64)
    for k in range(n_tables):
        greatest, left = _bits(bits, at, 8), TOTAL
        at += 8
        for token in range(n_tokens):
            if token == greatest:
                continue
            length = _bits(bits, at, 4)
            at += 4
            frequencies[token] = 0
            if length:
                kept = min(MANTISSA, length - 1)
                mantissa = _bits(bits, at, kept) | 1 << kept
                frequencies[token] = mantissa << (length - 1 - kept)
                at += kept
            left -= frequencies[token]
        frequencies[greatest] = left
        start = 0
        for token in range(n_tokens):
            frequency = frequencies[token]
            entry = token | (frequency - 1) << 8
            for slot in range(frequency):
                lookup[k * TOTAL + start + slot] = entry | slot << 20
            start += frequency
    return at


@_jit
def _bits(bits: U8, at: int, n: int) -> int:
    """Up to 8 bits, the first lowest."""
    pair = np.int64(bits[at >> 3]) | np.int64(bits[(at >> 3) + 1]) << 8
    return pair >> (at & 7) & ((1 << n) - 1)


@_jit
def write_bits(
    bits: U8, at: int, values: npt.NDArray[np.integer], n_bits: npt.NDArray[np.integer]
) -> int:
    """Append values of so many bits each; returns the next bit."""
    for i in range(len(values)):
        value, left = int(values[i]), int(n_bits[i])
        while left > 0:
            room = 8 - (at & 7)
            take = min(room, left)
            bits[at >> 3] |= np.uint8((value & ((1 << take) - 1)) << (at & 7))
            value, left, at = value >> take, left - take, at + take
    return at
