"""Parts of a stream at random: ranges of its bytes, and cuts."""

import random
from itertools import pairwise

from evogs_codec.decoding.cut import Cut
from evogs_codec.format.directory import read_directory


def overlapping_ranges(rng: random.Random, size: int) -> list[tuple[int, int]]:
    """Ranges that cover 0..size, most of them overlapping, in random order."""
    cuts = [0, *sorted(rng.randrange(size + 1) for _ in range(rng.randrange(12))), size]
    ranges = [
        (max(0, a - rng.randrange(20)), min(size, b + rng.randrange(20))) for a, b in pairwise(cuts)
    ]
    ranges += [(a, a + 30) for a in (rng.randrange(size) for _ in range(3))]
    rng.shuffle(ranges)
    return ranges


def random_cut(data: bytes, rng: random.Random) -> Cut:
    """Any valid cut: tiles differ, bands come late or never."""
    directory = read_directory(data)
    steps = directory.chain_lengths.copy()
    for row in steps:
        row[0] = rng.randint(0, int(row[0]))
        for component in range(1, len(row)):
            row[component] = rng.choice([0, min(row[0], rng.randint(0, int(row[component])))])
    return Cut(steps)
