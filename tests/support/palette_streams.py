"""Streams with a palette: one made by hand, and random ones; cuts of them."""

import random
from dataclasses import replace
from functools import cache

import numpy as np

from conformance.decoders import oracle
from conformance.generator.builder import DELTA, DROP, REFINE, SPLIT, Packet, Stream, Tile, build
from conformance.generator.random_streams import random_stream
from evogs_codec import Cut, read_directory
from evogs_codec.model.components import PALETTE, PICKS

HAS_PALETTE = 1  # of the second byte of flags
OF_CHANGED = 4  # flag of a packet of picks
DEGREE, N_ABOVE = 2, 24


def numbers(n, channels, seed):
    rng = random.Random(seed)
    return {channel: [rng.randint(-90, 90) for _ in range(n)] for channel in range(channels)}


def grown(tile, level, records, n_adds, seed):
    """A step of core."""
    n_psi = sum(kind != DROP for kind in records.values())
    return Packet(
        tile=tile,
        level=level,
        records=records,
        psi=numbers(n_psi, 14, seed),
        adds=numbers(n_adds, 14, seed + 1),
        n_adds=n_adds,
    )


def picks(tile, *chosen):
    return Packet(tile=tile, component=PICKS, picks=chosen)


def changed(tile, *chosen):
    """Picks of the slots that the step refines or splits too, before those of the new ones."""
    return replace(picks(tile, *chosen), flags=OF_CHANGED)


def entries(n, seed, **options):
    return Packet(component=PALETTE, adds=numbers(n, N_ABOVE, seed), **options)


FIRST = {t: grown(t, 0, {}, 4, 10 * t) for t in range(3)}
SECOND = {t: grown(t, 1, {0: SPLIT, 1: REFINE, 2: DROP, 3: SPLIT}, 1, 10 * t + 3) for t in range(3)}
THIRD = {t: grown(t, 2, {1: DROP, 4: SPLIT, 5: DROP, 6: REFINE}, 1, 10 * t + 6) for t in range(3)}
# The last steps of tile 0 have no picks; those of tile 1 come after all of core and the palette.
# Picks of level 0 are of 4 entries, those of level 1 of 6, those of level 2 of 7.
PACKETS = (
    *(FIRST[0], FIRST[1]),
    entries(3, 100),
    FIRST[2],
    entries(1, 101),
    *(picks(2, 3, 0, 2, 1), picks(0, 1, 2, 3, 4), SECOND[1], SECOND[2]),
    entries(2, 102, level=1, flags=2, codings={"adds 5": DELTA | 0x24}),
    *(changed(2, 4, 0, 2, 5, 6, 0), THIRD[1], SECOND[0], picks(0, 6, 5, 1), THIRD[0], THIRD[2]),
    entries(1, 103, level=2),
    *(picks(2, 3, 7), picks(1, 3, 0, 4, 4), picks(1), changed(1, 6, 7, 2, 5)),
)
PLACES = {
    *((0, 0, 2), (0, PICKS, 1), (0, PALETTE, 0), (0, PALETTE, 2)),
    *((1, PICKS, 2), (2, PICKS, 0), (2, PICKS, 2)),
}
COLUMN_OF_PICKS = 1  # of a cut


def stream(packets=PACKETS, **options):
    origins = ((0, 0, 0), (4000, -4000, 0), (90_000, 0, 70_000))
    box = {"low": (-1000,) * 3, "high": (1000,) * 3}
    plain = Stream(
        packets,
        degree=DEGREE,
        has_palette=True,
        n_levels=3,
        tiles=[Tile(origin, **box) for origin in origins],
        quantisers={(0, 5): (3, 1), (0, 6): (1, 2)},
    )
    return build(replace(plain, **options))


DATA = stream(digests=dict.fromkeys(sorted(PLACES)))
DIRECTORY = read_directory(DATA)


@cache
def legal_streams():
    """Random streams with a palette, each as unlike what an encoder writes as may be."""
    found, seed = list[bytes](), 0
    while len(found) < 12:
        seed += 1
        data = random_stream(random.Random(seed))
        if data[19] & HAS_PALETTE and len(read_directory(data).palette_packets):
            found.append(data)
    return found


def each_stream():
    return [DATA, *legal_streams()]


def oracle_cut(cut):
    """As the oracle has it: by component, the palette in tile 0."""
    return [
        [core, 0, 0, 0, picks, cut.palette if tile == 0 else 0]
        for tile, (core, picks) in enumerate(cut.steps.tolist())
    ]


def oracle_dump(data, cut):
    return oracle.decode(data, cut=oracle_cut(cut)).dump()


def random_cut(rng, directory):
    """Any valid cut: of the palette what picks require, or more."""
    steps = rng.integers(0, directory.chain_lengths + 1)
    steps = np.minimum(steps, steps[:, :1])
    if rng.random() < 0.3:
        steps[:, COLUMN_OF_PICKS] = 0
    least = n_required(directory, steps)
    return Cut(steps, int(rng.integers(least, len(directory.palette_packets) + 1)))


def n_required(directory, steps):
    """How many packets of the palette the picks of these steps require."""
    return max(
        (
            n
            for (tile, component, step), n in each_required(directory)
            if component == PICKS and step < steps[tile, COLUMN_OF_PICKS]
        ),
        default=0,
    )


def each_required(directory):
    """(tile, component, step) of each packet, and how many of the palette it requires: 3.7."""
    rows = [
        (int(row["tile"]), int(row["component"]), step, int(row["level"]))
        for row, step in zip(directory.packets, directory.steps.tolist(), strict=True)
    ]
    labels = {(tile, step): level for tile, component, step, level in rows if component == 0}
    levels = [level for _, component, _, level in rows if component == PALETTE]
    for tile, component, step, _ in rows:
        is_picks = component == PICKS
        required = [level for level in levels if is_picks and level <= labels[tile, step]]
        yield (tile, component, step), len(required)
