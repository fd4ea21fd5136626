"""`literals.are_exact`, compiled: it adds up the lengths of codes as it reads them.

It trusts that libzstd took the frame for what a table may hold, and for nothing else: what would
lead it out of the bytes of the frame is refused.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numba
import numpy as np
import numpy.typing as npt

from evogs_codec.format.literals import MAX_BITS
from evogs_codec.model.splats import I64, U8

__all__ = ["all_are_exact", "are_exact"]

U16: TypeAlias = npt.NDArray[np.uint16]
_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False)
_MAX_LOG = 6  # of FSE-coded weights
_MAX_WEIGHTS = 255
_AT_ONCE = 57 // MAX_BITS  # indices that 8 bytes hold, whatever bit comes first
# An entry of a table stands for one or two whole codes: their bits, their number, the bits of the
# first. The bits and numbers of `_AT_ONCE` entries can be added up without a carry.
_NUMBER_AT, _FIRST_AT = 6, 10
_BITS, _NUMBER = 63, 15
_MOST = 2 * _AT_ONCE  # codes


@_jit
def all_are_exact(data: U8, places: I64) -> bool:
    """`are_exact` for frames at (F, 3) offset, size and content size."""
    for k in range(len(places)):
        begin = places[k, 0]
        if not are_exact(data[begin : begin + places[k, 1]]):
            return False
    return True


@_jit
def are_exact(frame: U8) -> bool:
    """Tell whether the literals of a frame that libzstd took keep R-5.10-12 to R-5.10-14."""
    table = np.empty(1 << MAX_BITS, np.uint16)  # an entry for each index
    log = 0
    at = 5 + (1 << (frame[4] >> 6))
    last = False
    while not last:
        header = _number(frame, at, 3)
        last, kind, begin = header & 1 == 1, header >> 1 & 3, at + 3
        at = begin + (1 if kind == 1 else header >> 3)
        if at > len(frame):
            return False
        if kind != 2 or frame[begin] & 3 < 2:
            continue
        form = np.int64(frame[begin] >> 2 & 3)
        width, streams = (10, begin + 3) if form < 2 else (4 * form + 6, begin + form + 2)
        if streams >= at:
            return False
        sizes = _number(frame, begin, streams - begin) >> 4
        n, end = sizes & (1 << width) - 1, streams + (sizes >> width)
        if end > at:
            return False
        if frame[begin] & 3 == 2:
            log, streams = _read_tree(frame, streams, end, table)
        if log == 0:
            return False
        if form == 0:
            if _rest(frame, _mark(frame, streams, end), streams, n, table, log) != 0:
                return False
        elif not _four_are_exact(frame, streams, end, n, table, log):
            return False
    return True


@_jit
def _four_are_exact(frame: U8, sizes: int, end: int, n: int, table: U16, log: int) -> bool:
    """Four streams behind their sizes, read in turn, so that none waits for itself."""
    a = sizes + 6
    if a > end:
        return False
    b = a + _number(frame, sizes, 2)
    c = b + _number(frame, sizes + 2, 2)
    d = c + _number(frame, sizes + 4, 2)
    if d > end:
        return False
    at_a, at_b = _mark(frame, a, b), _mark(frame, b, c)
    at_c, at_d = _mark(frame, c, d), _mark(frame, d, end)
    each = (n + 3) // 4
    n_a, n_b, n_c, n_d = each, each, each, n - 3 * each  # literals that are left
    if n_d < 0:
        return False
    shift, bits = np.uint64(64 - log), np.uint64(_BITS)
    while min(n_a, n_b, n_c, n_d) >= _MOST:
        if at_a < 8 * a or at_b < 8 * b or at_c < 8 * c or at_d < 8 * d:
            return False
        word_a, word_b = _top(frame, at_a), _top(frame, at_b)
        word_c, word_d = _top(frame, at_c), _top(frame, at_d)
        sum_a = sum_b = sum_c = sum_d = np.uint64(0)
        for _ in range(_AT_ONCE):
            one_a, one_b = np.uint64(table[word_a >> shift]), np.uint64(table[word_b >> shift])
            one_c, one_d = np.uint64(table[word_c >> shift]), np.uint64(table[word_d >> shift])
            word_a, word_b = word_a << (one_a & bits), word_b << (one_b & bits)
            word_c, word_d = word_c << (one_c & bits), word_d << (one_d & bits)
            sum_a, sum_b = sum_a + one_a, sum_b + one_b
            sum_c, sum_d = sum_c + one_c, sum_d + one_d
        at_a, n_a = _after(at_a, n_a, sum_a)
        at_b, n_b = _after(at_b, n_b, sum_b)
        at_c, n_c = _after(at_c, n_c, sum_c)
        at_d, n_d = _after(at_d, n_d, sum_d)
    return (
        _rest(frame, at_a, a, n_a, table, log) == 0
        and _rest(frame, at_b, b, n_b, table, log) == 0
        and _rest(frame, at_c, c, n_c, table, log) == 0
        and _rest(frame, at_d, d, n_d, table, log) == 0
    )


@_jit
def _after(at: int, n: int, total: int) -> tuple[int, int]:
    """The place and the number of literals that are left, after entries that add up to `total`."""
    total = np.int64(total)
    return at - (total & _BITS), n - (total >> _NUMBER_AT & _NUMBER)


@_jit
def _rest(frame: U8, at: int, begin: int, n: int, table: U16, log: int) -> int:
    """Bits of the stream that n codes leave, from bit `at` down; below 0 if there are too few."""
    shift = np.uint64(64 - log)
    while n > 0:
        if at < 8 * begin:
            return -1
        entry = np.int64(table[_top(frame, at) >> shift])
        if n == 1:
            at, n = at - (entry >> _FIRST_AT), 0
        else:
            at, n = _after(at, n, entry)
    return at - 8 * begin


@_jit
def _mark(frame: U8, begin: int, end: int) -> int:
    """The bit behind the first one of a stream, in bits of the frame; -1 if it has no end mark."""
    if begin >= end or frame[end - 1] == 0:
        return -1
    return 8 * end - 9 + _bit_length(frame[end - 1])


@_jit
def _top(frame: U8, at: int) -> np.uint64:
    """The bits below bit `at`, 57 of them at least; before a stream are 12 bytes of headers."""
    end = (at + 7) >> 3
    first = np.uint64(end - 8)  # of an index that may be below 0 numba makes no plain load
    word = (
        np.uint64(frame[first])
        | np.uint64(frame[first + np.uint64(1)]) << np.uint64(8)
        | np.uint64(frame[first + np.uint64(2)]) << np.uint64(16)
        | np.uint64(frame[first + np.uint64(3)]) << np.uint64(24)
        | np.uint64(frame[first + np.uint64(4)]) << np.uint64(32)
        | np.uint64(frame[first + np.uint64(5)]) << np.uint64(40)
        | np.uint64(frame[first + np.uint64(6)]) << np.uint64(48)
        | np.uint64(frame[first + np.uint64(7)]) << np.uint64(56)
    )
    return word << np.uint64(8 * end - at)


@_jit
def _number(data: U8, at: int, n_bytes: int) -> int:
    """A little-endian number of up to 7 bytes; past the end are zeros."""
    found = np.int64(0)
    for k in range(min(n_bytes, len(data) - at)):
        found |= np.int64(data[at + k]) << (8 * k)
    return found


@_jit
def _read_tree(frame: U8, at: int, end: int, table: U16) -> tuple[int, int]:
    """(longest code, end of the description) of a tree, its table out; (0, 0) if refused."""
    weights = np.empty(_MAX_WEIGHTS + 1, np.uint8)
    head = np.int64(frame[at])
    size = head if head < 128 else (head - 126) // 2
    at += 1
    if at + size > end:
        return 0, 0
    if head < 128:
        n = _read_weights(frame, at, at + size, weights)
    else:
        n = head - 127
        for k in range(n):
            weights[k] = (frame[at + k // 2] >> (0 if k & 1 else 4)) & 15
    counts, others = np.zeros(16, np.int64), np.zeros(16, np.int64)  # so that none waits for itself
    largest = np.uint8(0)
    for k in range(0, n, 2):
        counts[weights[k] & 15] += 1
        if k + 1 < n:
            others[weights[k + 1] & 15] += 1
    for k in range(n):
        largest = max(largest, weights[k])
    counts += others
    total = np.int64(0)
    for weight in range(1, MAX_BITS + 1):
        total += counts[weight] << (weight - 1)
    log = _bit_length(total)
    if total == 0 or log > MAX_BITS or largest > MAX_BITS:  # R-5.10-13
        return 0, 0
    counts[_bit_length((1 << log) - total)] += 1
    if counts[1] < 2:  # R-5.10-14
        return 0, 0
    return (log, at + size) if _fill(counts, log, table) else (0, 0)


@_jit
def _fill(counts: I64, log: int, table: U16) -> bool:
    """The table of a tree, out: the codes of each weight follow those of the weights below."""
    ends = np.zeros(MAX_BITS + 1, np.int64)  # of the indices that begin with a code of each weight
    for weight in range(1, log + 1):
        ends[weight] = ends[weight - 1] + (counts[weight] << (weight - 1))
    if ends[log] != 1 << log:
        return False
    for weight in range(1, log + 1):
        begin, end = ends[weight - 1], ends[weight]
        if begin == end:
            continue
        # For each code of the weight the indices hold the same: what comes behind it.
        first, at = log + 1 - weight, begin
        for second in range(1, log + 1):
            bits = first + log + 1 - second
            entry = first | 1 << _NUMBER_AT | first << _FIRST_AT
            if bits <= log:
                entry = bits | 2 << _NUMBER_AT | first << _FIRST_AT
            stop = begin + ((ends[second] + (1 << first) - 1) >> first)
            for k in range(at, stop):
                table[k] = entry
            at = stop
        while at < end:
            n = min(at - begin, end - at)
            for k in range(n):
                table[at + k] = table[begin + k]
            at += n
    return True


@_jit
def _read_weights(frame: U8, at: int, end: int, weights: U8) -> int:
    """FSE-coded weights (RFC 8878, 4.2.1.2): how many; 0 if they cannot be read."""
    states = np.empty(
        1 << _MAX_LOG, np.int64
    )  # weight, bits and base of the next state, a byte each
    log, size = _read_states(frame[at:end], states)
    begin = 8 * (at + size)
    at = _mark(frame, at + size, end)
    if log == 0 or at < begin + 2 * log:  # R-5.10-10
        return 0
    now, other = states[_below(frame, at, log)], states[_below(frame, at - log, log)]
    at -= 2 * log
    n = 0
    while n < _MAX_WEIGHTS - 1:
        weights[n] = now & 255
        n += 1
        n_bits = now >> 8 & 255
        if at - n_bits < begin:  # R-5.10-15
            weights[n] = other & 255
            return n + 1
        after = states[(now >> 16) + _below(frame, at, n_bits)]
        at -= n_bits
        now, other = other, after
    return 0


@_jit
def _below(frame: U8, at: int, n: int) -> int:
    """The number of the n bits below bit `at`, up to 56."""
    return np.int64((_top(frame, at) >> np.uint64(1)) >> np.uint64(63 - n))


@_jit
def _read_states(coded: U8, states: I64) -> tuple[int, int]:
    """The table of states, out (RFC 8878, 4.1.1): (its log, its bytes); (0, 0) if refused."""
    if len(coded) == 0:
        return 0, 0
    log, at = np.int64(5 + (coded[0] & 15)), np.int64(4)
    if log > _MAX_LOG:
        return 0, 0
    size = np.int64(1 << log)
    counts = np.zeros(_MAX_WEIGHTS + 1, np.int64)
    left, n = size, 0
    while left > 0:
        half = np.int64(1) << (_bit_length(left + 1) - 1)
        short = 2 * half - 2 - left  # so many values take a bit less
        value = (_number(coded, at >> 3, 3) >> (at & 7)) & (2 * half - 1)
        at += _bit_length(half)
        if value & (half - 1) < short:
            value &= half - 1
            at -= 1
        elif value >= half:
            value -= short
        if n > _MAX_WEIGHTS or at > 8 * len(coded):
            return 0, 0
        counts[n] = value - 1
        left -= abs(value - 1)
        n += 1
        more = np.int64(3 if value == 1 else 0)
        while more == 3:
            more = (_number(coded, at >> 3, 2) >> (at & 7)) & 3
            at += 2
            n += more
            if n > _MAX_WEIGHTS or at > 8 * len(coded):
                return 0, 0
    if left < 0:
        return 0, 0
    rare = size
    for weight in range(n):
        if counts[weight] < 0:
            rare -= 1
            states[rare] = weight
    state = 0
    for weight in range(n):
        for _ in range(counts[weight]):
            states[state] = weight
            state = (state + (size >> 1) + (size >> 3) + 3) & (size - 1)
            while state >= rare:
                state = (state + (size >> 1) + (size >> 3) + 3) & (size - 1)
    for state in range(size):
        weight = states[state]
        number = abs(counts[weight])
        counts[weight] = number + 1
        n_bits = log + 1 - _bit_length(number)
        states[state] = weight | n_bits << 8 | ((number << n_bits) - size) << 16
    return log, (at + 7) >> 3


@_jit
def _bit_length(number: int) -> int:
    found = np.int64(0)
    while number >> found:
        found += 1
    return found
