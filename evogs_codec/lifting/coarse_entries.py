"""Entries of a palette for coarse splats, and picks of them that take few bits (spec 12).

A coarse splat is seen until its children come, so its SH above band 0 need not be near. Entries and
picks are those of an entropy-constrained quantiser: each splat picks the entry whose squared error
and bits together cost least. At the error of the nearest of 32 entries, picks take 2.7 bits instead
of 4.6 (coarse splats of playbot).

Source: Chou, Lookabaugh and Gray, "Entropy-constrained vector quantization", 1989.

Letters: N splats, C SH channels above band 0, n entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evogs_codec.model.splats import F32, F64, I32

__all__ = ["N_SAMPLED", "CoarseEntries"]

MAX_ENTRIES = 256  # entries
N_SAMPLED, N_ROUNDS = 32_768, 10  # splats, by which entries are found
BIT_PRICE = 0.1  # of a bit of a pick: this part of the mean square of the SH of a splat
LOUD_SHARE = 0.99  # of splats; squares of the rest count no more, so that one splat sets no price
BLOCK = 40  # splats compared with entries at a time: of more, BLAS starts threads, which spin


@dataclass(frozen=True, eq=False)
class CoarseEntries:
    """Entries, and what the bits of their picks cost.

    Attributes:
        values: (C, n) SH.
        costs: (1 + n,) of the pick 0, which is no entry, and of each entry: squared SH.
    """

    values: F32
    costs: F64

    @staticmethod
    def of(x: F32, most: int) -> CoarseEntries:
        """For coarse splats like some.

        Args:
            x: (C, N) SH of some coarse splats. About `N_SAMPLED` of them are looked at, evenly.
            most: entries at most.
        """
        if not x.shape[1]:  # all splats are leaves
            return CoarseEntries(x, np.zeros(1))
        x = x[:, :: max(1, x.shape[1] // N_SAMPLED)]
        first = x[:, :: max(1, -(-x.shape[1] // max(min(MAX_ENTRIES, most), 1)))]
        squares = np.square(x, dtype=np.float64).sum(axis=0)
        square = float(np.minimum(squares, np.quantile(squares, LOUD_SHARE)).mean())
        found = CoarseEntries(first, np.zeros(1 + first.shape[1]))
        for _ in range(N_ROUNDS):
            found = found._moved(x, BIT_PRICE * square)
        return found

    def cheapest(self, x: F32 | F64) -> I32:
        """(N,) picks for SH (C, N): 0 for none, or 1 and the number of an entry."""
        out = np.zeros(x.shape[1], np.int32)
        candidates = _with_none(self.values)
        unit = np.float32(max(1.0, np.abs(candidates).max(), np.abs(x).max(initial=0)))
        candidates /= unit  # so that no square overflows
        offsets = np.square(candidates).sum(0) + (self.costs / np.float64(unit) ** 2).astype(
            np.float32
        )
        for at in range(0, len(out), BLOCK):
            part = (x[:, at : at + BLOCK] / unit).astype(np.float32)
            products = 2 * part.T @ candidates
            out[at : at + BLOCK] = np.subtract(offsets, products, out=products).argmin(axis=1)
        return out

    def _moved(self, x: F32, price: float) -> CoarseEntries:
        """The entries that are picked, each the mean of what picks it, at a price of a bit."""
        picks = self.cheapest(x)
        counts = np.bincount(picks, minlength=1 + self.values.shape[1])
        some = 1 + np.flatnonzero(counts[1:])
        sums = np.array([np.bincount(picks, row, len(counts))[some] for row in x])
        kept = counts[np.append(0, some)]
        bits = np.log2(x.shape[1] / np.maximum(kept, 1))
        values = (sums.reshape(len(x), -1) / counts[some]).astype(np.float32)
        return CoarseEntries(values, price * bits)


def _with_none(values: F32) -> F32:
    """(C, 1 + n), the pick 0 first."""
    return np.concatenate([np.zeros((len(values), 1), np.float32), values], axis=1)
