"""Huffman-coded literals of frames (spec 5.10, RFC 8878 3.1.1.3.1 and 4.2).

libzstd does not check everything here, so it is checked once more for frames that libzstd took:
that the codes of each stream use up its bits (R-5.10-12), and the tree (R-5.10-13, R-5.10-14).

The library gives the literals of a block, from a frame that has no sequences. The
lengths of their codes add up to the bits of each stream if, and only if, it is consumed exactly: as
long as codes lie within the bits, they are what the library read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache

import numpy as np

__all__ = ["MAX_BITS", "are_exact"]

MAX_BITS = 11  # R-5.10-13
_N_SYMBOLS = 256
# Without a content size, for a window of 128 KiB, the largest block.
_HEAD = b"\x28\xb5\x2f\xfd\x00\x38"
_COMPRESSED, _WITH_HUFFMAN, _TREELESS = 2, 2, 3


def are_exact(frame: memoryview, decompress: Callable[[bytes, int], bytes]) -> bool:
    """Tell whether the literals of a frame keep R-5.10-12 to R-5.10-14.

    Args:
        frame: one that keeps R-5.10-1 to R-5.10-11.
        decompress: gives so many bytes of a frame without a content size, by libzstd.
    """
    at = 5 + (1 << (frame[4] >> 6))
    tree, lengths, last = b"", b"", False
    while not last:
        header = int.from_bytes(frame[at : at + 3], "little")
        last, kind, size = bool(header & 1), header >> 1 & 3, header >> 3
        begin, at = at + 3, at + 3 + (1 if kind == 1 else size)
        if kind != _COMPRESSED or frame[begin] & 3 < _WITH_HUFFMAN:
            continue
        form = frame[begin] >> 2 & 3
        width, streams_at = ((10, 3), (10, 3), (14, 4), (18, 5))[form]
        sizes = int.from_bytes(frame[begin : begin + streams_at], "little") >> 4
        n, end = sizes & (1 << width) - 1, begin + streams_at + (sizes >> width)
        section, streams, carrier = bytes(frame[begin:end]), begin + streams_at, b""
        if frame[begin] & 3 == _TREELESS:
            carrier = _carrier(tree, lengths)
        else:
            head = frame[streams]
            tree = bytes(frame[streams : streams + 1 + (head if head < 128 else (head - 126) // 2)])
            found = _code_lengths(tree)
            if found is None:
                return False
            lengths, streams = found, streams + len(tree)
        again = _HEAD + carrier + _block(section, is_last=True)
        literals = decompress(again, n + bool(carrier))[bool(carrier) :] if n else b""
        if _bits_of_streams(frame[streams:end], form) != _bits_of_codes(literals, lengths, form):
            return False
    return True


def _bits_of_streams(streams: memoryview, form: int) -> list[int]:
    """Bits below the end mark of each stream; -1 if it has no mark."""
    if form == 0:
        return [8 * len(streams) + streams[-1].bit_length() - 9 if streams[-1] else -1]
    found, at = [], 6
    for size in (*struct.unpack_from("<3H", streams), None):
        end = len(streams) if size is None else at + size
        mark = streams[end - 1]
        found.append(8 * (end - at) + mark.bit_length() - 9 if mark else -1)
        at = end
    return found


def _bits_of_codes(literals: bytes, lengths: bytes, form: int) -> list[int]:
    """Bits of the codes of the literals of each stream."""
    of_each = literals.translate(lengths)
    n_streams = 1 if form == 0 else 4
    each = -(-len(literals) // n_streams)
    rows = np.frombuffer(of_each.ljust(n_streams * each, b"\0"), np.uint8)
    bits: list[int] = rows.reshape(n_streams, each).sum(1, dtype=np.int64).tolist()
    return bits


def _block(section: bytes, *, is_last: bool) -> bytes:
    """A compressed block of a literals section and no sequences."""
    header = is_last | _COMPRESSED << 1 | (len(section) + 1) << 3
    return header.to_bytes(3, "little") + section + b"\0"


def _carrier(tree: bytes, lengths: bytes) -> bytes:
    """A block of one literal, which hands a tree on: the code of 0 bits is among the longest."""
    longest = max(lengths)
    body = tree + (1 << longest).to_bytes(longest // 8 + 1, "little")
    head = (_WITH_HUFFMAN | 1 << 4 | len(body) << 14).to_bytes(3, "little")
    return _block(head + body, is_last=False)


def _code_lengths(tree: bytes) -> bytes | None:
    """The length of the code of each byte, 0 if it has none; None for a tree that is refused."""
    if tree[0] >= 128:
        digits = tree[1:].hex()[: tree[0] - 127]
        weights = bytes(map(_HEX.__getitem__, digits))
    else:
        weights = _weights(tree[1:])
    total = sum(weights.count(weight) << weight - 1 for weight in range(1, 16))
    longest = total.bit_length()
    if longest > MAX_BITS:  # R-5.10-13
        return None
    weights += bytes([((1 << longest) - total).bit_length()])
    if weights.count(1) < 2:  # R-5.10-14
        return None
    return weights.translate(_LENGTHS[longest]).ljust(_N_SYMBOLS, b"\0")


_HEX = {digit: int(digit, 16) for digit in "0123456789abcdef"}
# By the longest code: from a weight to a length.
_LENGTHS = [
    bytes(longest + 1 - w if 0 < w <= longest else 0 for w in range(_N_SYMBOLS))
    for longest in range(MAX_BITS + 1)
]


def _weights(coded: bytes) -> bytes:
    """FSE-coded weights: two states take turns (RFC 8878, 4.2.1.2)."""
    log, states, size = _states(coded)
    bits = int.from_bytes(coded[size:], "little")
    left = bits.bit_length() - 1 - log
    mask = (1 << log) - 1
    now = states[bits >> left & mask]
    left -= log
    other = states[bits >> left & mask]
    out = bytearray()
    while True:
        weight, n, below, base = now
        out.append(weight)
        left -= n
        if left < 0:  # R-5.10-15
            out.append(other[0])
            return bytes(out)
        now, other = other, states[base + (bits >> left & below)]


def _states(coded: bytes) -> tuple[int, list[tuple[int, int, int, int]], int]:
    """An FSE table (RFC 8878, 4.1.1): its log, the states, its bytes.

    Of each state weight, bits to read, the largest number of so many bits, and the base.
    """
    bits, log, at = int.from_bytes(coded, "little"), 5 + (coded[0] & 15), 4
    counts, left, weight = [], 1 << log, 0
    while left:
        half = 1 << (left + 1).bit_length() - 1
        short = 2 * half - 2 - left  # so many values take a bit less
        value = bits >> at & 2 * half - 1
        at += half.bit_length()
        if value & half - 1 < short:
            value &= half - 1
            at -= 1
        elif value >= half:
            value -= short
        if value != 1:
            counts.append((weight, value - 1))
            left -= abs(value - 1)
        weight += 1
        while value == 1:
            more = bits >> at & 3
            weight, at = weight + more, at + 2
            value = 1 if more == 3 else 0
    n_rare = sum(count < 0 for _, count in counts)
    order, first = _order(log, n_rare), 0
    states = [(0, 0, 0, 0)] * (1 << log)
    rare = len(states)
    for weight, count in counts:
        if count < 0:
            rare -= 1
            states[rare] = (weight, log, (1 << log) - 1, 0)
            continue
        places = sorted(order[first : first + count])
        first += count
        for place, (n, below, base) in zip(places, _after(log, count), strict=True):
            states[place] = (weight, n, below, base)
    return log, states, (at + 7) // 8


@cache
def _order(log: int, n_rare: int) -> list[int]:
    """The states in the order in which weights take them, without those of rare weights."""
    size = 1 << log
    step = (size >> 1) + (size >> 3) + 3
    return [at for k in range(size) if (at := k * step % size) < size - n_rare]


@cache
def _after(log: int, count: int) -> list[tuple[int, int, int]]:
    """Bits, the largest number of so many, and the base, of each state of a weight of `count`."""
    out = []
    for number in range(count, 2 * count):
        n = log + 1 - number.bit_length()
        out.append((n, (1 << n) - 1, (number << n) - (1 << log)))
    return out
