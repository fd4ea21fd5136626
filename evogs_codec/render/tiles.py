"""Which splats each tile draws, front to back.

Tiles are numbered row by row. Splats are put in depth order once and
then counted and written into the lists of their tiles in that order, so every list is in depth
order, and equal depths in order of index. Each worker has a block of splats, consecutive in depth,
and its own place in every list, after those of the blocks before: the lists do not depend on the
number of blocks. Lists are made for a range of tiles at a time, so that memory is bounded by CHUNK
entries or the longest list.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render.compiled import (
    Scalar,
    inlined,
    kernel,
    n_threads,
    parallel_kernel,
    prange,
    prefetch,
)
from evogs_codec.render.spans import RUNS, SIDE, SPAN, columns_of

__all__ = ["Chunk", "Tiles", "depth_order"]

Array = npt.NDArray[Any]
I16 = npt.NDArray[np.int16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]

CHUNK = 1 << 22  # entries of one chunk: 16 MB of lists, 150 MB of gradients, 270 MB of moments
_AHEAD = 32  # splats of an order from one whose span is asked for to the one that is counted
_MIN_BLOCK = 2048  # splats that are worth a thread
_MAX_BLOCKS = 16  # each counts all tiles: 2 MB of a picture of 8192 x 8192 pixels
_DIGIT = 12  # bits of one of the two passes of the radix sort
_DIGITS = 1 << _DIGIT
_ABOVE, _INDEX = np.uint64(32), np.uint64(0xFFFFFFFF)  # bits of a word: above an index, and it
_FAR = 16  # places that a word is moved by, at most, when it is inserted


@dataclass(frozen=True, eq=False)
class Chunk:
    """Lists of the tiles first .. first + len(offsets) - 2.

    Attributes:
        first: number of the first tile.
        offsets: the list of tile first + i is entries[offsets[i]:offsets[i + 1]].
        block_ends: (B, tiles) how many entries of each list come from blocks 0..b.
        entries: indexes of splats.
        order: positions i, longest list first.
    """

    first: int
    offsets: I64
    block_ends: I64
    entries: I32
    order: I64


@dataclass(frozen=True, eq=False)
class Tiles:
    """The lists of all tiles of a picture, made in chunks when asked for.

    Attributes:
        columns: tiles in a row.
        width: pixels.
        records, rows: what `projection.project` made.
        order: indexes of the drawn splats, in depth order.
        runs: (drawn, SPAN) their spans.
        block_ends: (B, tiles) how many entries of every tile's list come from blocks 0..b.
    """

    columns: int
    width: int
    records: Array
    rows: I32
    order: I64
    runs: I16
    block_ends: I64

    @staticmethod
    def of(records: Array, rows: I32, spans: I16, order: I64, width: int, height: int) -> Tiles:
        """Count the entries of every tile; `records`, `rows` and `spans` are of all splats."""
        columns, tile_rows = -(-width // SIDE), -(-height // SIDE)
        n_blocks = max(1, min(n_threads(), _MAX_BLOCKS, len(order) // _MIN_BLOCK))
        block_ends = np.zeros((n_blocks, tile_rows, columns + 1), np.int64)
        runs = np.empty((len(order), SPAN), np.int16)
        _count(records, rows, spans, order, width, runs, block_ends)
        # Until here marks of where runs of tiles begin and end along rows, whose last is no tile.
        np.cumsum(np.cumsum(block_ends, axis=2), axis=0, out=block_ends)
        ends = block_ends[:, :, :-1].reshape(n_blocks, -1)
        return Tiles(columns, width, records, rows, order, runs, ends)

    @property
    def counts(self) -> I64:
        """Length of the list of every tile."""
        counts: I64 = self.block_ends[-1]
        return counts

    @property
    def n_intersections(self) -> int:
        """Entries of all lists."""
        return int(self.counts.sum())

    def chunks(self) -> Iterator[Chunk]:
        """The lists, in chunks of at most CHUNK entries or one tile."""
        ends = np.cumsum(self.counts)
        first = 0
        while first < len(ends):
            before = int(ends[first - 1]) if first else 0
            last = int(np.searchsorted(ends, before + CHUNK, side="right"))
            yield self._chunk(first, max(last, first + 1))
            first = max(last, first + 1)

    def _chunk(self, first: int, last: int) -> Chunk:
        block_ends = self.block_ends[:, first:last]
        counts = block_ends[-1]
        offsets = np.zeros(last - first + 1, np.int64)
        np.cumsum(counts, out=offsets[1:])
        next_entry = np.tile(offsets[:-1], (len(block_ends), 1))
        next_entry[1:] += block_ends[:-1]
        entries = np.empty(int(offsets[-1]), np.int32)
        _fill(
            self.records, self.rows, self.order, self.width, self.columns, self.runs,
            first, last, next_entry, entries,
        )  # fmt: skip
        return Chunk(first, offsets, block_ends, entries, np.argsort(-counts, kind="stable"))


def depth_order(depths: npt.NDArray[np.float64], status: npt.NDArray[np.uint8]) -> I64:
    """Indexes of the drawn splats by camera z, equal ones by index."""
    drawn = np.flatnonzero(status == p.DRAWN)
    if not len(drawn):
        return drawn
    # Positive floats are in the order of their bits.
    keys = depths.view(np.uint64)
    own = keys[drawn]
    least = own.min()
    words = _by_upper_bits(own, drawn, least, int(own.max() - least).bit_length())
    if not _put_in_order(words, keys):
        return drawn[np.argsort(own, kind="stable")]
    order: I64 = (words & _INDEX).astype(np.int64)
    return order


@kernel
def _by_upper_bits(keys: Array, drawn: Array, least: Scalar, n_bits: int) -> Array:
    """Words (n,) in the order of the upper bits of keys, stable; these tell nearly all apart.

    A word has the upper bits of a key above the index of its splat.

    Arguments, several to a line:
        keys: (n,).
        drawn: (n,) the index of the splat of each.
        least: of the keys, which is taken from all.
        n_bits: of the largest of these differences.
    """
    n = len(keys)
    shift, mask = np.uint64(max(0, n_bits - 2 * _DIGIT)), np.uint64(_DIGITS - 1)
    words, others = np.empty(n, np.uint64), np.empty(n, np.uint64)
    lower, upper = np.zeros(_DIGITS, np.int64), np.zeros(_DIGITS, np.int64)  # how often each comes
    for i in range(n):
        key = (keys[i] - least) >> shift
        words[i] = key << _ABOVE | np.uint64(drawn[i])
        lower[np.int64(key & mask)] += 1
        upper[np.int64(key >> np.uint64(_DIGIT))] += 1
    _deal_out(words, _ABOVE, lower, others)
    _deal_out(others, _ABOVE + np.uint64(_DIGIT), upper, words)
    return words


@inlined
def _deal_out(words: Array, shift: Scalar, counts: Array, out: Array) -> None:
    """Words in the order of one digit, which begins at a bit, out; counts of digits are scratch."""
    total = 0
    for digit in range(_DIGITS):
        total, counts[digit] = total + counts[digit], total
    for i in range(len(words)):
        word = words[i]
        own = np.int64(word >> shift & np.uint64(_DIGITS - 1))
        at = counts[own]
        counts[own] = at + 1
        out[at] = word


@kernel
def _put_in_order(words: Array, keys: Array) -> bool:
    """Insert words with the upper bits of the one before where the keys (N,) of splats belong.

    Returns:
        False as soon as one would move far.
    """
    for i in range(1, len(words)):
        word, at = words[i], i
        if word >> _ABOVE != words[i - 1] >> _ABOVE:
            continue
        key = keys[np.int64(word & _INDEX)]
        while at > 0 and keys[np.int64(words[at - 1] & _INDEX)] > key:
            if i - at == _FAR:
                return False
            words[at] = words[at - 1]
            at -= 1
        words[at] = word
    return True


@inlined
def _columns(record: Array, rows: Array, row: int, width: int) -> tuple[int, int]:
    """Tile columns of a splat in a row of tiles that its span does not have."""
    return columns_of(
        record[p.X], record[p.Y], record[p.WEIGHT], record[p.SLOPE], record[p.CURVE],
        record[p.LOG_OPACITY], record[p.WIDEST], rows[0], rows[1], row, width,
    )  # fmt: skip


@parallel_kernel
def _count(
    records: Array, rows: Array, spans: Array, order: Array, width: int, runs: Array, marks: Array
) -> None:  # fmt: skip
    """Put spans in depth order and mark, for each block, where runs of tiles begin and end.

    Arguments, several to a line:
        records, rows, spans: what `projection.project` made.
        order: indexes of the drawn splats, in depth order.
        width: pixels.
        runs: (drawn, SPAN), out.
        marks: (B, rows of tiles, columns + 1), added to.
    """
    n_blocks = len(marks)
    for block in prange(n_blocks):
        for i in range(block * len(order) // n_blocks, (block + 1) * len(order) // n_blocks):
            splat = order[i]
            if i + _AHEAD < len(order):
                prefetch(spans, order[i + _AHEAD])
            for k in range(SPAN):
                runs[i, k] = spans[splat, k]
            first, last = runs[i, 0], runs[i, 1]
            for row in range(first, min(last, first + RUNS)):
                k = 2 + 2 * (row - first)
                marks[block, row, runs[i, k]] += 1
                marks[block, row, runs[i, k + 1]] -= 1
            for row in range(first + RUNS, last):
                begin, end = _columns(records[splat], rows[splat], row, width)
                marks[block, row, begin] += 1
                marks[block, row, end] -= 1


@parallel_kernel
def _fill(
    records: Array, rows: Array, order: Array, width: int, n_columns: int, runs: Array,
    first: int, last: int, next_entry: Array, entries: Array,
) -> None:  # fmt: skip
    """Write the lists of tiles [first, last); `next_entry` begins as where each block does."""
    first_row, last_row = first // n_columns, (last - 1) // n_columns + 1
    n_blocks = len(next_entry)
    for block in prange(n_blocks):
        for i in range(block * len(order) // n_blocks, (block + 1) * len(order) // n_blocks):
            splat, top = order[i], runs[i, 0]
            for row in range(max(top, first_row), min(runs[i, 1], last_row)):
                k = row - top
                if k < RUNS:
                    begin, end = runs[i, 2 + 2 * k], runs[i, 3 + 2 * k]
                else:
                    begin, end = _columns(records[splat], rows[splat], row, width)
                tile = row * n_columns
                for t in range(max(tile + begin, first), min(tile + end, last)):
                    at = next_entry[block, t - first]
                    entries[at] = splat
                    next_entry[block, t - first] = at + 1
