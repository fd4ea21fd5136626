"""The content of Zstandard frames, compiled: `frames` without libzstd (spec 5.10, RFC 8878 3.1.1).

It knows no faults: a frame that is not plainly legal is refused, and `frames` finds out whether
libzstd takes it. What is written lies in the content of the frame, what is read in its bytes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.format.compiled_bits import (
    below,
    fill_states,
    mark,
    number,
    put_word,
    read_counts,
    word_at,
)
from evogs_codec.format.compiled_literals import N_WEIGHTS, read_streams, read_tree
from evogs_codec.format.literals import MAX_BITS
from evogs_codec.model.splats import I32, I64, U8

__all__ = ["is_frame", "read_frames"]

_jit = jit()
_MAX_CONTENT, _MAX_BLOCK = 16 << 20, 128 << 10  # R-5.10-4, R-5.10-5
_MAX_OFFSET_BITS = 24  # an offset of more is above any content (R-5.10-4)
# Of literals lengths, offsets and match lengths: the predefined tables and what tables may hold.
_N_LL, _N_OF, _N_ML = 36, 32, 53
_LL_BITS = np.array([0] * 16 + [1] * 4 + [2, 2, 3, 3, 4] + list(range(6, 17)), np.int64)
_ML_BITS = np.array([0] * 32 + [1] * 4 + [2, 2, 3, 3, 4, 4, 5] + list(range(7, 17)), np.int64)
_LL_BASE = np.cumsum(1 << _LL_BITS) - (1 << _LL_BITS)
_ML_BASE = 3 + np.cumsum(1 << _ML_BITS) - (1 << _ML_BITS)
_LL_COUNTS = np.array([4, 3] + [2] * 11 + [1] * 3 + [2] * 9 + [3, 2] + [1] * 5 + [-1] * 4, np.int64)
_OF_COUNTS = np.array([1] * 6 + [2] * 3 + [1] * 15 + [-1] * 5, np.int64)
_ML_COUNTS = np.array([1, 4, 3] + [2] * 6 + [1] * 37 + [-1] * 7, np.int64)
_PREDEFINED, _RUN, _CODED, _BEFORE = 0, 1, 2, 3  # modes of a table; the last: as in a block before


class _Memory(NamedTuple):
    """What is used again from block to block.

    Attributes:
        literals: of a block, no more than a frame has (R-5.10-5), and 8, as they are read in words.
        tree: the table of the Huffman tree.
        weights, counts: of what is being read.
        tables: (7, 512) states of literals lengths, offsets, match lengths; the predefined ones of
            each; those of the weights of a tree.
        logs: (6,) of each but the last.
        used: (3,) which of `tables` the block before has used; -1 for none.
        repeated: (3,) offsets.
    """

    literals: U8
    tree: npt.NDArray[np.uint16]
    weights: U8
    counts: I64
    tables: I32
    logs: I64
    used: I64
    repeated: I64


@_jit
def read_frames(data: U8, places: I64, out: U8) -> bool:
    """The contents of frames to `out`, one after the other; False if one is not plainly legal.

    Args:
        data: the file.
        places: (F, 3) offset, size and content size of each frame, which lies in the file.
        out: room for all contents.
    """
    largest = np.int64(0)
    for k in range(len(places)):
        largest = max(largest, places[k, 2])
    memory, at = _new_memory(min(largest, _MAX_BLOCK)), np.int64(0)
    for k in range(len(places)):
        begin, size, content = places[k]
        frame = data[begin : begin + size]
        if not is_frame(frame, content):
            return False
        if not _read_frame(frame, out[at : at + content], memory):
            return False
        at += content
    return True


@_jit
def is_frame(frame: U8, content: int) -> bool:
    """`frames.check_frame` again, since numba compiles neither slices of bytes nor its errors."""
    if len(frame) < 5 or number(frame, 0, 4) != 0xFD2FB528 or frame[4] & 63 != 32:
        return False
    n_size = 1 << (frame[4] >> 6)
    at = 5 + n_size
    if len(frame) < at:
        return False
    stated = np.int64(256 if n_size == 2 else 0)
    for k in range(n_size):
        if k > 3 and frame[5 + k]:
            return False
        stated += np.int64(frame[5 + k]) << (8 * (k & 3))
    if stated != content or content > _MAX_CONTENT:
        return False
    last = False
    while not last:
        if len(frame) < at + 3:
            return False
        header = np.int64(frame[at]) | np.int64(frame[at + 1]) << 8 | np.int64(frame[at + 2]) << 16
        last, kind, block = header & 1 == 1, (header >> 1) & 3, header >> 3
        if kind == 3 or block > min(content, _MAX_BLOCK) or (block == 0 and (kind or not last)):
            return False
        at += 3 + (1 if kind == 1 else block)
    return at == len(frame)


@_jit
def _new_memory(n_literals: int) -> _Memory:
    counts, tables = np.empty(N_WEIGHTS + 4, np.int64), np.empty((7, 512), np.int32)
    logs = np.array([0, 0, 0, 6, 5, 6])
    for kind in range(3):
        predefined = _LL_COUNTS if kind == 0 else _OF_COUNTS if kind == 1 else _ML_COUNTS
        counts[: len(predefined)] = predefined
        fill_states(counts, len(predefined), logs[3 + kind], tables[3 + kind])
    return _Memory(
        np.empty(n_literals + 8, np.uint8),
        np.empty(1 << MAX_BITS, np.uint16),
        np.empty(N_WEIGHTS, np.uint8),
        counts,
        tables,
        logs,
        np.empty(3, np.int64),
        np.empty(3, np.int64),
    )


@_jit
def _read_frame(frame: U8, out: U8, memory: _Memory) -> bool:
    memory.used[:] = -1
    memory.repeated[:] = 1, 4, 8
    log = np.int64(0)  # of the tree
    at, to, last = 5 + (np.int64(1) << (frame[4] >> 6)), np.int64(0), False
    while not last:
        header = number(frame, at, 3)
        last, kind, size, begin = header & 1 == 1, header >> 1 & 3, header >> 3, at + 3
        at = begin + (1 if kind == 1 else size)
        if at > len(frame):
            return False
        room = min(min(len(out), _MAX_BLOCK), len(out) - to)
        if kind == 2:
            log, size = _read_block(frame, begin, at, out, to, room, log, memory)
            if size < 0:
                return False
        elif size > room:
            return False
        else:
            _copy(frame, begin, kind == 1, out[to : to + size])
        to += size
    return to == len(out)


@_jit
def _read_block(
    frame: U8, at: int, end: int, out: U8, to: int, room: int, log: int, memory: _Memory
) -> tuple[int, int]:
    """A compressed block to `out`, from `to` on: (log of the tree, bytes); (0, -1) if refused."""
    kind, form, most = frame[at] & 3, np.int64(frame[at] >> 2 & 3), min(len(out), _MAX_BLOCK)
    if kind < 2:
        n_head = np.int64(1 if form & 1 == 0 else (form + 3) // 2)
        n = number(frame, at, n_head) >> (3 if n_head == 1 else 4)
        n_stored = n if kind == 0 else np.int64(1)
    else:
        width, n_head = (np.int64(10), np.int64(3)) if form < 2 else (4 * form + 6, form + 2)
        sizes = number(frame, at, n_head) >> 4
        n, n_stored = sizes & (1 << width) - 1, sizes >> width
    begin, after = at + n_head, at + n_head + n_stored
    if after >= end or n > most or (kind >= 2 and n == 0):
        return 0, -1
    n_sequences, at_sequences = _number_of_sequences(frame, after)
    if n_sequences == 0 and (at_sequences != end or n > room):  # R-5.10-17
        return 0, -1
    literals = out[to : to + n] if n_sequences == 0 else memory.literals[:n]
    if kind < 2:
        _copy(frame, begin, kind == 1, literals)
    else:
        if kind == 2:
            log, begin = read_tree(
                frame, begin, after, memory.weights, memory.counts, memory.tables[6], memory.tree
            )
        if log == 0 or not read_streams(
            frame, begin, after, n, form == 0, memory.tree, log, literals
        ):
            return 0, -1
    if n_sequences == 0:
        return log, n
    n = _execute(frame, at_sequences, end, n_sequences, n, out[: to + room], to, memory)
    return log, n


@_jit
def _number_of_sequences(frame: U8, at: int) -> tuple[int, int]:
    """(how many, where what follows begins); the latter is past the end if bytes are missing."""
    first = np.int64(frame[at])
    if first < 128:
        return first, at + 1
    if first < 255:
        return ((first - 128) << 8) + number(frame, at + 1, 1), at + 2
    return number(frame, at + 1, 2) + 0x7F00, at + 3


@_jit
def _copy(frame: U8, begin: int, is_run: bool, out: U8) -> None:
    """The bytes of the frame from `begin` on, or the first of them again and again."""
    if is_run:
        out[:] = frame[begin]
    else:
        out[:] = frame[begin : begin + len(out)]


@_jit
def _copy_words(source: U8, at: int, out: U8, to: int, n: int) -> None:
    """N bytes, 8 at a time where there is room for more: what comes after them is written later.

    They may overlap those that are copied if these begin at least 8 bytes before them.
    """
    if to + n + 8 <= len(out):
        for k in range(0, n, 8):
            put_word(word_at(source, at + k), out, to + k)
        return
    for k in range(n):
        out[to + k] = source[at + k]


@_jit
def _repeat(out: U8, offset: int, to: int, n: int) -> None:
    """N bytes from `to` on, each as that `offset` before it."""
    if offset < 8:  # after some bytes also as that a multiple of it before
        head = (7 // offset) * offset
        for k in range(min(head, n)):
            out[to + k] = out[to + k - offset]
        offset, to, n = offset + head, to + head, n - head
    _copy_words(out, to - offset, out, to, n)


@_jit
def _read_tables(frame: U8, at: int, end: int, memory: _Memory) -> int:
    """The tables of a block, to `memory`: where their descriptions end, -1 if refused."""
    if at >= end or frame[at] & 3:  # R-5.10-9
        return -1
    modes, at = np.int64(frame[at]), at + 1
    for kind in range(3):
        mode = modes >> (6 - 2 * kind) & 3
        max_log = 8 if kind == 1 else 9
        max_symbol = _N_LL - 1 if kind == 0 else _N_OF - 1 if kind == 1 else _N_ML - 1
        if mode == _PREDEFINED:
            memory.used[kind] = 3 + kind
            continue
        if mode == _RUN:
            if at >= end or frame[at] > max_symbol:
                return -1
            memory.tables[kind, 0], memory.logs[kind] = frame[at], 0
            at += 1
        elif mode == _CODED:
            log, n, size = read_counts(frame[at:end], max_log, max_symbol, memory.counts)
            if log == 0:
                return -1
            fill_states(memory.counts, n, log, memory.tables[kind])
            memory.logs[kind] = log
            at += size
        elif memory.used[kind] < 0:
            return -1
        if mode != _BEFORE:
            memory.used[kind] = kind
    return at


@_jit
def _execute(
    frame: U8, at: int, end: int, n: int, n_literals: int, out: U8, to: int, memory: _Memory
) -> int:
    """The n sequences of a block to `out`, from `to` on: the bytes they give; -1 if refused.

    `at` is where the modes of their tables are, `end` the end of the block.
    """
    begin = _read_tables(frame, at, end, memory)
    if begin < 0:
        return -1
    kind_ll, kind_of, kind_ml = memory.used[0], memory.used[1], memory.used[2]
    lls, ofs, mls = memory.tables[kind_ll], memory.tables[kind_of], memory.tables[kind_ml]
    log_ll, log_of = memory.logs[kind_ll], memory.logs[kind_of]
    log_ml = memory.logs[kind_ml]
    at = mark(frame, begin, end)
    begin *= 8
    if at - log_ll - log_of - log_ml < begin:
        return -1
    ll = np.int64(lls[below(frame, at, log_ll)])
    at -= log_ll
    of = np.int64(ofs[below(frame, at, log_of)])
    at -= log_of
    ml = np.int64(mls[below(frame, at, log_ml)])
    at -= log_ml
    rep_1, rep_2, rep_3 = memory.repeated[0], memory.repeated[1], memory.repeated[2]
    literals, first, literal = memory.literals, to, np.int64(0)
    for k in range(n):
        of_bits, ml_bits, ll_bits = of & 255, _ML_BITS[ml & 255], _LL_BITS[ll & 255]
        extra = of_bits + ml_bits + ll_bits
        if of_bits > _MAX_OFFSET_BITS or at - extra < begin:
            return -1
        bits, at = below(frame, at, extra), at - extra  # 56 at most
        length = _LL_BASE[ll & 255] + (bits & ((1 << ll_bits) - 1))
        bits >>= ll_bits
        match = _ML_BASE[ml & 255] + (bits & ((1 << ml_bits) - 1))
        value = (np.int64(1) << of_bits) + (bits >> ml_bits)
        offset = value - 3
        if value > 3:
            rep_1, rep_2, rep_3 = offset, rep_1, rep_2
        else:
            which = value + 1 if length == 0 else value
            if which == 2:
                rep_1, rep_2 = rep_2, rep_1
            elif which == 3:
                rep_1, rep_2, rep_3 = rep_3, rep_1, rep_2
            elif which == 4:
                rep_1, rep_2, rep_3 = rep_1 - 1, rep_1, rep_2
            offset = rep_1
        if length > n_literals - literal or length + match > len(out) - to:
            return -1
        _copy_words(literals, literal, out, to, length)
        literal, to = literal + length, to + length
        if offset < 1 or offset > to:  # R-5.10-7
            return -1
        _repeat(out, offset, to, match)
        to += match
        if k == n - 1:
            break
        of_bits, ml_bits, ll_bits = of >> 8 & 255, ml >> 8 & 255, ll >> 8 & 255
        more = of_bits + ml_bits + ll_bits
        if at - more < begin:
            return -1
        bits, at = below(frame, at, more), at - more
        of_next = (of >> 16) + (bits & ((1 << of_bits) - 1))
        bits >>= of_bits
        ml_next = (ml >> 16) + (bits & ((1 << ml_bits) - 1))
        of, ml = np.int64(ofs[of_next]), np.int64(mls[ml_next])
        ll = np.int64(lls[(ll >> 16) + (bits >> ml_bits)])
    memory.repeated[0], memory.repeated[1], memory.repeated[2] = rep_1, rep_2, rep_3
    n_left = n_literals - literal
    if at != begin or n_left > len(out) - to:  # R-5.10-16
        return -1
    _copy_words(literals, literal, out, to, n_left)
    return to + n_left - first
