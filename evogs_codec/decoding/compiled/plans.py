"""What the compiled loops are told of a tile: its tables, where its steps act, its channels.

Letters: P records with psi, S splits, A adds, all of one step; C channels that are turned together,
1 or 3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evogs_codec.common.buffers import Scratch
from evogs_codec.model.splats import I32, I64
from evogs_codec.model.tree import Kind

__all__ = [
    "CHUNK",
    "DROP",
    "FIRST_SH",
    "N_GROUPS",
    "REFINE",
    "SH_GROUP",
    "SPLIT",
    "Channels",
    "Plans",
    "Tables",
]

CHUNK = 4096  # a multiple of 8, so that packed planes begin a byte with each chunk
REFINE, SPLIT, DROP = int(Kind.REFINE), int(Kind.SPLIT), int(Kind.DROP)
N_GROUPS, SH_GROUP, FIRST_SH = 5, 4, 11


class Tables(NamedTuple):
    """Quantisers, alpha tables and the box of a tile.

    Attributes:
        units: (1 + n_levels, classes) grid units of one q: of adds, of psi of each level.
        alphas: the entries of all alpha tables, one after the other.
        alpha_places: (n_levels, 5, 4) first entry, number of entries, K, largest |entry|.
        box: (3, 2) least and largest position.
    """

    units: I64
    alphas: I32
    alpha_places: I64
    box: I64


class Channels(NamedTuple):
    """Channels that are turned together: one, or the three of an SH coefficient.

    Attributes:
        rows: (C, n) their slots.
        kind: their class.
        low, high: the least and the largest number that a slot may hold.
        bounds: (C,) no |number| of a slot is above it.
    """

    rows: I32
    kind: int
    low: np.int64
    high: np.int64
    bounds: I64


class Plans(NamedTuple):
    """Where the core steps of a tile act; the packets of the bands use it again.

    Attributes:
        places: (1 + steps, 6) slots before the step; where its `runs`, `splits` and `drops` begin;
            P of all steps before it; where its `siblings` begin.
        runs: (2, n) first slot and length of runs of slots of P; none crosses a chunk of P.
        splits: (n,) which of P are splits.
        drops: (n,) slots of the drops.
        alphas: (5, n) a of the splits per group.
        siblings: (3, n) of steps that only refine, runs of records whose slots were born from slots
            of the step: the first record, the record of its sibling, and the length.
        terms: (steps,) the most differences that a psi of the step is the sum of.
        bounds: (D,) of each channel, no |number| of a slot is above it.
    """

    places: I64
    runs: I64
    splits: I64
    drops: I64
    alphas: I32
    siblings: I32
    terms: I64
    bounds: I64

    @staticmethod
    def empty(
        scratch: Scratch, n_channels: int, n_steps: int, n_psi: tuple[int, int], n_drops: int
    ) -> Plans:
        """Room for the core steps of a tile; of psi the splits and the refines."""
        n_splits, n_refines = n_psi
        n_records = n_splits + n_refines + n_drops
        n_runs = n_records + n_records // CHUNK + n_steps
        return Plans(
            np.zeros((n_steps + 1, 6), np.int64),
            scratch.take((2, n_runs), np.int64),
            scratch.take((n_splits,), np.int64),
            scratch.take((n_drops,), np.int64),
            scratch.take((N_GROUPS, n_splits), np.int32),
            scratch.take((3, n_refines), np.int32),
            np.ones(n_steps, np.int64),
            np.zeros(n_channels, np.int64),
        )
