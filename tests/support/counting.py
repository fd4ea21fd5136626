"""An array that counts what is read of it: work measured without a clock."""

import numpy as np


class Counted(np.ndarray):
    """An array that counts the numbers that are read of it."""

    n_read = 0

    def __getitem__(self, key):
        found = super().__getitem__(key)
        Counted.n_read += np.size(found)
        return found
