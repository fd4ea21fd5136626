"""Tokens, contexts and tables: what a coder with static tables spends on a list of integers.

A token says how large an integer is, and all of it if it is small; the bits that it does not say
are stored as they are. A context is how large a number is that is known beforehand: a class, in
half octaves; neighbouring classes share a table where that costs less than two tables.

Letters: n integers of a list, T tokens, K tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from evogs_codec.splats import F64, I32, I64, U8

__all__ = [
    "CLASS_OF",
    "CONTEXTS",
    "SPLITS",
    "Model",
    "Split",
    "adaptive_bits",
    "choose_model",
    "classes_of",
    "entropy_bits",
    "joint_counts",
    "magnitudes_of",
]

CONTEXTS = ("none", "neighbour", "channel", "record", "parent", "alpha")
N_CLASSES = 26
MAX_TABLES = 8
MAX_TOKENS = 256
TABLE_BITS = 12
N_LANES = 8


def classes_of(magnitudes: I32) -> U8:
    """Half octaves of 1 + m."""
    classes: U8 = np.minimum(2 * np.log2(1.0 + magnitudes), N_CLASSES - 1).astype(np.uint8)
    return classes


CLASS_OF = classes_of(np.arange(6000, dtype=np.int32))  # the last is N_CLASSES - 1


@dataclass(frozen=True)
class Split:
    """How integers become tokens and raw bits, as JPEG XL does it.

    Integers below 2**direct are tokens; of the others the exponent, `high` bits below the first
    one and the `low` last bits are in the token.
    """

    direct: int
    high: int
    low: int

    def tokens(self, z: I32) -> tuple[I32, I32]:
        """(n,) tokens and number of raw bits of each."""
        exponent = np.frexp(np.maximum(z, 1).astype(np.float64))[1] - 1
        above = np.maximum(exponent - self.direct, 0)
        n_raw = np.where(z >> self.direct, exponent - self.high - self.low, 0)
        head = (z >> np.maximum(exponent - self.high, 0)) & ((1 << self.high) - 1)
        tail = z & ((1 << self.low) - 1)
        large = (1 << self.direct) + (((above << self.high) | head) << self.low | tail)
        return np.where(z >> self.direct, large, z).astype(np.int32), n_raw.astype(np.int32)

    def bases(self, n_tokens: int) -> tuple[I32, I32]:
        """(T,) the least integer of each token and its number of raw bits; raw bits go at `low`."""
        token = np.arange(n_tokens)
        above = np.maximum(token - (1 << self.direct), 0)
        exponent = self.direct + (above >> (self.high + self.low))
        head = above >> self.low & ((1 << self.high) - 1)
        n_raw = np.where(token >> self.direct, exponent - self.high - self.low, 0)
        base = ((1 << self.high) + head << n_raw) << self.low | above & ((1 << self.low) - 1)
        return np.where(token >> self.direct, base, token).astype(np.int32), n_raw.astype(np.int32)


SPLITS = (Split(4, 1, 1), Split(5, 2, 1), Split(6, 3, 1), Split(7, 4, 1), Split(8, 4, 1))


@dataclass(frozen=True, eq=False)
class Model:
    """How a list is coded.

    Attributes:
        split: of SPLITS.
        context: of CONTEXTS.
        table_of: (N_CLASSES,) the table of each class.
        counts: (K, T) occurrences of each token.
        bits: entropy under the tables, with the raw bits, and bits of the tables.
    """

    split: Split
    context: str
    table_of: U8
    counts: I64
    bits: float


def choose_model(z: I32, known: Mapping[str, I32], contexts: Sequence[str] = CONTEXTS) -> Model:
    """The cheapest model of a list with one of these contexts, or without."""
    models = []
    for split in SPLITS:
        tokens, n_raw = split.tokens(z)
        if int(tokens.max()) < MAX_TOKENS:
            models.append(_model(split, "none", tokens, n_raw, known))
    split = min(models, key=lambda model: model.bits).split
    tokens, n_raw = split.tokens(z)
    models += [
        _model(split, context, tokens, n_raw, known)
        for context in contexts
        if context == "neighbour" or context in known
    ]
    return min(models, key=lambda model: model.bits)


def magnitudes_of(context: str, split: Split, tokens: I32, known: Mapping[str, I32]) -> I32:
    """(n,) magnitudes that choose the tables of a list."""
    if context == "none":
        return np.zeros(len(tokens), np.int32)
    if context == "neighbour":  # the one before in its lane, whose raw bits are not known yet
        before = np.roll(split.bases(int(tokens.max()) + 1)[0][tokens], 1)
        before[:: -(-len(tokens) // N_LANES)] = 0
        return before
    return known[context]


def _model(split: Split, context: str, tokens: I32, n_raw: I32, known: Mapping[str, I32]) -> Model:
    counts = joint_counts(tokens, classes_of(magnitudes_of(context, split, tokens, known)))
    table_of, bits = _merge(counts)
    merged = np.zeros((int(table_of.max()) + 1, counts.shape[1]), np.int64)
    np.add.at(merged, table_of, counts)
    return Model(split, context, table_of, merged, bits + float(n_raw.sum(dtype=np.int64)))


def joint_counts(tokens: I32, classes: npt.NDArray[np.integer]) -> I64:
    """(classes, T) occurrences; N_CLASSES rows at least."""
    n_tokens, n_classes = int(tokens.max()) + 1, max(int(classes.max()) + 1, N_CLASSES)
    places = classes.astype(np.int64) * n_tokens + tokens
    return np.bincount(places, minlength=n_classes * n_tokens).reshape(n_classes, n_tokens)


def _merge(counts: I64) -> tuple[U8, float]:
    """Runs of classes that share a table, MAX_TABLES at most, and their bits: the cheapest."""
    used = np.flatnonzero(counts.sum(1))
    sums = np.concatenate([np.zeros((1, counts.shape[1]), np.int64), np.cumsum(counts[used], 0)])
    n = len(used)
    firsts, lasts = np.triu_indices(n)
    cost = np.full((n, n + 1), np.inf)
    runs = sums[lasts + 1] - sums[firsts]
    cost[firsts, lasts + 1] = entropy_bits(runs) + table_bits(runs) + 8
    best = np.full((MAX_TABLES + 1, n + 1), np.inf)
    begin = np.zeros((MAX_TABLES + 1, n + 1), np.int64)
    best[0, 0] = 0
    for k in range(1, MAX_TABLES + 1):
        paths = best[k - 1, :n, None] + cost
        begin[k], best[k] = paths.argmin(0), paths.min(0)
    k, end = int(best[:, n].argmin()), n
    bits = float(best[k, n])
    table_of = np.zeros(len(counts), np.uint8)
    while k:
        first = int(begin[k, end])
        table_of[used[first] :] = np.maximum(table_of[used[first] :], k - 1)
        k, end = k - 1, first
    return table_of, bits


def entropy_bits(counts: I64) -> F64:
    """(K,) bits of the tokens counted in each row, at their order-0 entropy."""
    n = counts.sum(1)
    logs = np.log2(np.maximum(counts, 1))
    bits: F64 = n * np.log2(np.maximum(n, 1)) - (counts * logs).sum(1)
    return bits


def adaptive_bits(counts: I64, prior: float = 0.1) -> float:
    """Bits of tokens in classes, each with a count of its own that begins at `prior`."""
    counts = counts[counts.sum(1) > 0]
    n, n_tokens = counts.sum(1), counts.shape[1]
    start = gammaln(n_tokens * prior) - gammaln(n + n_tokens * prior)
    each = (gammaln(counts + prior) - gammaln(prior)).sum(1)
    return float(-(start + each).sum() / np.log(2))


def table_bits(counts: I64) -> F64:
    """(K,) bits of the tables of rows of counts, as `rans` writes them."""
    n = np.maximum(counts.sum(1, keepdims=True), 1)
    frequencies = np.maximum(np.rint(counts * (1 << TABLE_BITS) / n), counts > 0)
    length = np.floor(np.log2(np.maximum(frequencies, 1)))
    each = 4 + np.where(frequencies > 0, np.minimum(length, 3), 0)
    last = counts.shape[1] - np.argmax(counts[:, ::-1] > 0, axis=1)
    bits: F64 = 16 + np.where(np.arange(counts.shape[1]) < last[:, None], each, 0).sum(1)
    return bits
