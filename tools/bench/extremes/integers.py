"""Rows of the decoder: integers at their limits, and the float view, against Python's integers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from conformance.decoders import oracle
from evogs_codec import decode
from evogs_codec.encoding.write import write
from evogs_codec.model.arithmetic import MAX_DELTA, MAX_PRODUCT, MAX_X, AlphaTable, Quantiser
from evogs_codec.model.channels import N_GROUPS, channel_class, n_channels
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.tree import Kind
from tools.bench.extremes import exact
from tools.bench.extremes.row import Row, outcome

__all__ = ["chains_at_limits", "float_view"]

ENTRIES = (-32768, 1, *range(-126, 126), -1, 32767)  # an alpha table of 256
TAKEN = (0, 255, 1, 254)  # the ends of the s16, and the least, at the ends of the table
SHIFTS = (12, 0, 7)  # K of levels 1, 2, 3
MAX_ORIGIN = 1 << 52
BOX = ((-MAX_X,) * 3, (MAX_X,) * 3)
FINEST, COARSEST = 40, -16


def chains_at_limits(n: int) -> Iterator[Row]:
    """Take n generations as far as R-7.3-1 to R-7.3-3 let them."""
    tree, x = _chain(n)
    stream = write(tree, zstd_level=1)
    got = decode(stream, verify=True).tiles[0].channels()
    extreme = f"{n} generations at the limits: X to {int(abs(x).max())}, a from -2^15 to 2^15 - 1"
    beyond = "; ".join(
        f"{what}: {outcome(partial(_decoded, stream))}" for what, stream in _steps_too_far(tree, x)
    )
    yield Row.exact(extreme, int(np.count_nonzero(got != x)), x.size, beyond)
    same = oracle.decode(stream).dump() == decode(stream).dump()
    yield Row.exact(
        f"the dump of these {n}, of `conformance.decoders.oracle`", int(not same), 1, ""
    )


def float_view(n: int) -> Iterator[Row]:
    """View n splats at the largest origins, on every grid from the finest to the coarsest."""
    rng = np.random.default_rng(4)
    d, n_wrong, n_all = n_channels(0), 0, 0
    for exponent in range(COARSEST, FINEST + 1):
        x = rng.integers(-(1 << 23) + 1, 1 << 23, (d, n)).astype(np.int32)
        origin = (MAX_ORIGIN, -MAX_ORIGIN, int(rng.integers(-MAX_ORIGIN, MAX_ORIGIN)))
        tile = CodedTile(origin, *BOX, (_adds(x),))
        row = (Quantiser(1, 5),) * 5
        tree = CodedTree(0, 1, (exponent,) * N_GROUPS, (row, row), {}, (tile,))
        got = decode(write(tree, zstd_level=1)).leaves().channels()
        offsets = [*origin, *([0] * (d - 3))]
        for channel, offset in enumerate(offsets):
            wanted = [exact.float32_of(offset + 32 * int(v), exponent) for v in x[channel]]
            n_wrong += int(np.count_nonzero(got[channel] != np.array(wanted, np.float32)))
        n_all += x.size
    extreme = f"float view at O = +-2^52, X to 2^28, G = {COARSEST} to {FINEST}"
    over = replace(tree, tiles=(replace(tile, origin=(MAX_ORIGIN + 1, 0, 0)),))
    beyond = outcome(partial(_decoded, write(over, digests=False)))
    yield Row.exact(extreme, n_wrong, n_all, f"O = 2^52 + 1: {beyond}")


def _decoded(stream: bytes) -> str:
    return f"{len(decode(stream).leaves())} splats"


def _chain(n: int) -> tuple[CodedTree, exact.Integers]:
    """A tree whose every record goes to a limit, and its last state."""
    d = n_channels(0)
    # Classes of a level differ in their steps; the last level reaches every integer.
    rows = [
        tuple(Quantiser(*pair) for pair in ((1, 24), (65535, 5), (32, 0), (3, 20), (1, 5))),
        tuple(Quantiser(*pair) for pair in ((1, 5), (65535, 0), (1, 24), (7, 13), (255, 8))),
        tuple(Quantiser(*pair) for pair in ((65535, 12), (1, 6), (33, 0), (1, 20), (5, 4))),
        (Quantiser(1, 0),) * 5,
    ]
    alpha = {
        (level, group): AlphaTable(shift, ENTRIES)
        for level, shift in zip((1, 2, 3), SHIFTS, strict=True)
        for group in range(N_GROUPS)
    }
    steps = [_adds(np.zeros((d, 3), np.int32))]
    tree = CodedTree(0, 4, (0,) * N_GROUPS, (rows[0], *rows), alpha, ())
    quantisers = (rows[0], rows[0], *rows[1:])
    tree = replace(tree, quantisers=quantisers)
    x = exact.slots_of_coded(tree, CodedTile((0, 0, 0), *BOX, tuple(steps)))
    for k in range(n):
        steps.append(_to_the_limit(tree, x, 1 + 3 * k // n, k))
        x = exact.slots_of_coded(tree, CodedTile((0, 0, 0), *BOX, tuple(steps)))
    return replace(tree, tiles=(CodedTile((0, 0, 0), *BOX, tuple(steps)),)), x


def _to_the_limit(tree: CodedTree, x: exact.Integers, level: int, k: int) -> CodedStep:
    """A split of slot 0, a refine of slot 1, a split of slot 2, each as far as it may go."""
    table = tree.alpha_table(level, 0)
    index = np.array([TAKEN[k % 4], TAKEN[k // 4 % 4]], np.uint8)
    a = (table.entries[index[0]], None, table.entries[index[1]])
    psi = np.zeros((len(x), 3), np.int32)
    for channel in range(len(x)):
        quantiser = tree.quantisers[1 + level][channel_class(channel)]
        for slot in range(3):
            sign = 1 if (k + channel + slot) % 3 else -1
            psi[channel, slot] = _furthest(x[channel, slot], quantiser, a[slot], table.shift, sign)
    kinds = np.array([Kind.SPLIT, Kind.REFINE, Kind.SPLIT], np.uint8)
    indices = np.tile(index, (N_GROUPS, 1))
    slots = np.arange(3, dtype=np.int32)
    return CodedStep(level, slots, kinds, indices, psi, np.zeros((len(x), 0), np.int32))


def _furthest(p: int, quantiser: Quantiser, a: int | None, shift: int, sign: int) -> int:
    """The q of this sign, or else of the other, that moves P and C2 furthest and stays legal."""
    half = (1 << shift) >> 1
    for direction in (sign, -sign):
        q = min(MAX_DELTA // quantiser.step, (1 << 23) - 1)
        q = min(q, (MAX_X - direction * p) // quantiser.step)
        if a:
            q = min(q, (MAX_PRODUCT - half) // abs(a) // quantiser.step)
        while q > 0:
            second = p if a is None else p - ((a * direction * q * quantiser.step + half) >> shift)
            if abs(second) <= MAX_X:
                return direction * q
            q -= max(1, q >> 6)
    return 0


def _steps_too_far(tree: CodedTree, x: exact.Integers) -> Iterator[tuple[str, bytes]]:
    """The tree with one step more that breaks a rule by the least."""
    channel, slot = np.unravel_index(int(np.argmax(abs(x))), x.shape)
    at = int(x[channel, slot])
    further = 1 if at > 0 else -1
    yield (
        f"X = {at + further * (MAX_X + 1 - abs(at))}",
        _more(tree, int(slot), Kind.REFINE, int(channel), further * (MAX_X + 1 - abs(at))),
    )
    yield "|a Delta| = 2^30 + 2^15", _more(tree, 0, Kind.SPLIT, 7, (1 << 15) + 1)
    row = (Quantiser(1, 6),) * 5
    coarse = replace(tree, quantisers=(*tree.quantisers[:4], row))
    yield "|Delta| = 2^28 + 2^6", _more(coarse, 0, Kind.REFINE, 7, (1 << 22) + 1)


def _more(tree: CodedTree, slot: int, kind: Kind, channel: int, q: int) -> bytes:
    """The stream of the tree with a record in its last level; a split takes a = -2^15."""
    tile = tree.tiles[0]
    n_splits = int(kind == Kind.SPLIT)
    psi = np.zeros((n_channels(0), 1), np.int32)
    psi[channel] = q
    step = CodedStep(
        3,
        np.array([slot], np.int32),
        np.array([kind], np.uint8),
        np.zeros((N_GROUPS, n_splits), np.uint8),
        psi,
        np.zeros((n_channels(0), 0), np.int32),
    )
    longer = replace(tree, tiles=(replace(tile, steps=(*tile.steps, step)),))
    return write(longer, zstd_level=1, digests=False)


def _adds(q: exact.Integers) -> CodedStep:
    none = np.zeros(0, np.int32)
    no_psi, no_alpha = np.zeros((len(q), 0), np.int32), np.zeros((N_GROUPS, 0), np.uint8)
    return CodedStep(0, none, none.astype(np.uint8), no_alpha, no_psi, q)
