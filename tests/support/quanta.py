"""A tree of whole numbers of quanta, as trainers in integers make it."""

import numpy as np

from evogs_codec import EvolutionTree
from evogs_codec.model.tree import Step


def in_quanta(quantum=0.25):
    """Four roots and two levels of whole numbers of quanta."""
    rng = np.random.default_rng(5)

    def numbers(n):
        return (quantum * rng.integers(-8, 9, (11 + 3, n))).astype(np.float32)

    steps = [Step.of_adds(0, numbers(4))]
    for level in (1, 2):
        n = 4 * level
        alpha = rng.integers(-4096, 4097, (5, n)) / 4096
        steps.append(Step.of_splits(level, np.arange(n), numbers(n), alpha))
    return EvolutionTree(0, tuple(steps), ((quantum,) * 5,) * 4)
