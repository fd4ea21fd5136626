"""SH that splats of a scene share, found while they are read: of any number of splats, few vectors.

Scenes that were SOG files have a few ten thousand vectors of SH above band 0 (`lifting.shared_sh`).
Once there are more of them than a palette would pay for, nothing is looked for any more.

Letters: n vectors, C SH channels above band 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.scratch_files import arrays_of
from evogs_codec.lifting.shared_sh import MAX_DISTINCT, keys_of
from evogs_codec.model.splats import F32, I64, SplatParams

__all__ = ["MAX_VECTORS", "Distinct", "Vectors"]

MAX_VECTORS = 1 << 18  # of a palette: 47 MB of SH degree 3


@dataclass(frozen=True, eq=False)
class Vectors:
    """Different SH above band 0, none of which is 0.

    Attributes:
        keys: (n,) of them (`keys_of`), rising.
        rows: (n, C).
    """

    keys: I64
    rows: F32

    def write(self, path: Path) -> None:
        """To a file that `read` reads."""
        write_atomic(
            path, lambda file: np.savez(file, allow_pickle=False, keys=self.keys, rows=self.rows)
        )

    @staticmethod
    def read(path: Path) -> Vectors:
        """From a file that `write` wrote.

        Raises:
            InputError: it is damaged.
        """
        with arrays_of(path) as found:
            return Vectors(found["keys"], found["rows"])


@dataclass
class Distinct:
    """The different SH of the splats that were taken, the same in whatever order they come.

    Attributes:
        n_declared: splats that will come at most.
        n_splats: taken so far.
        is_over: they are too many, or two vectors have one key.
    """

    n_declared: int
    n_splats: int = 0
    is_over: bool = False
    _keys: I64 = field(default_factory=lambda: np.empty(0, np.int64))
    _rows: F32 = field(default_factory=lambda: np.empty((0, 0), np.float32))

    def take(self, splats: SplatParams) -> None:
        """Look at some splats."""
        self.n_splats += len(splats)
        if self.is_over or not splats.sh_degree or not len(splats):
            return
        rest = np.ascontiguousarray(splats.sh[:, 1:]).reshape(len(splats), -1)
        keys, first, inverse = np.unique(keys_of(rest), return_index=True, return_inverse=True)
        rows = rest[first] + np.float32(0)  # no -0
        if not len(self._keys):
            self._keys, self._rows = keys[:0], rows[:0]
        place = np.searchsorted(self._keys, keys)
        is_known = place < len(self._keys)
        is_known[is_known] = self._keys[place[is_known]] == keys[is_known]
        is_new = ~is_known
        self.is_over = bool(
            len(self._keys) + np.count_nonzero(is_new)
            > min(MAX_VECTORS, MAX_DISTINCT * self.n_declared)
            or not np.array_equal(rows[inverse.ravel()], rest)
            or not np.array_equal(self._rows[place[is_known]], rows[is_known])
        )
        if self.is_over:
            self._keys, self._rows = self._keys[:0], self._rows[:0]
        elif is_new.any():
            self._keys = np.insert(self._keys, place[is_new], keys[is_new])
            self._rows = np.insert(self._rows, place[is_new], rows[is_new], axis=0)

    def found(self) -> Vectors | None:
        """What the splats share; None if too few of them share it, or if none has any."""
        if self.is_over or len(self._keys) > MAX_DISTINCT * self.n_splats:
            return None
        some = self._rows.any(axis=1)
        return Vectors(self._keys[some], self._rows[some]) if some.any() else None
