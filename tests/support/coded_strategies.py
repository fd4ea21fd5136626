"""Hypothesis strategies of `CodedTree`s: everything that a legal stream can say, limits included.

Structure is drawn record by record, so that it shrinks; numbers come from a seeded generator in a
drawn style. A tree is legal because it is simulated with Python integers while it is made: a q that
would break a bound of spec 7.3 is halved until it does not, and boxes are what the positions were.
"""

import random
from dataclasses import dataclass, field, replace

import numpy as np
from hypothesis import strategies as st

from evogs_codec.model.arithmetic import MAX_DELTA, MAX_PRODUCT, MAX_X, AlphaTable, Quantiser
from evogs_codec.model.channels import channel_class, n_channels, n_classes
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.tree import Kind
from tests.support.strategies import SH_DEGREES

LEAST_Q, MOST_Q = -(1 << 23), (1 << 23) - 1  # 24 bits after zigzag
UNKNOWN_ERROR = 0xFFFFFFFF

# Largest |q| of a style; "zero" comes first, so that it is what examples shrink to.
Q_STYLES = (0, 1, 3, 100, 3000, 1 << 20, 1 << 23)
QUANTISERS = ((1, 0), (3, 1), (65535, 0), (1, 24), (65535, 24), (40000, 12), (255, 8), (7, 20))
ENTRIES = (1, -1, 0, 2, -3, 32767, -32768, 4096)
ORIGINS = (0, 1, -1, 1 << 52, -(1 << 52), 123456789)


def quantisers():
    """A quantiser: often the finest, sometimes at the limits of M and E."""
    pairs = st.sampled_from(QUANTISERS) | st.tuples(st.integers(1, 65535), st.integers(0, 24))
    return pairs.map(lambda pair: Quantiser(*pair))


@st.composite
def alpha_tables(draw):
    """A table with K 0..12 and 1 to 256 entries."""
    entry = st.sampled_from(ENTRIES) | st.integers(-(1 << 15), (1 << 15) - 1)
    entries = draw(st.lists(entry, min_size=1, max_size=4))
    entries += [0] * draw(st.sampled_from([0, 0, 256 - len(entries)]))
    return AlphaTable(draw(st.integers(0, 12)), tuple(entries))


@st.composite
def infos(draw):
    """What a stream says of its scene; mostly nothing."""
    if draw(st.booleans()):
        return SceneInfo()
    key = st.text("abz09_.-", min_size=1, max_size=5)
    return SceneInfo(
        coordinate_system=draw(st.integers(0, 5)),
        up_axis=draw(st.integers(0, 6)),
        unit=draw(st.integers(0, 5)),
        colour_space=draw(st.integers(0, 2)),
        antialiased=draw(st.booleans()),
        text=draw(st.dictionaries(key, st.text(max_size=5), max_size=2)),
    )


@dataclass
class _Slots:
    """The slots of a tile while it is made."""

    x: list[list[int]]  # [channel][slot]
    live: list[bool] = field(default_factory=list)


@st.composite
def coded_trees(draw, *, sh_degrees=SH_DEGREES, max_tiles=3, max_steps=5, max_adds=5):
    """Legal trees of any shape.

    Args:
        draw: given by hypothesis.
        sh_degrees: strategy of the SH degree.
        max_tiles: tiles at most; there may be none.
        max_steps: steps of a tile at most; there may be none.
        max_adds: adds of a step at most.
    """
    degree, n_levels = draw(sh_degrees), draw(st.integers(1, 4))
    rows = [[draw(quantisers()) for _ in range(2)] for _ in range(1 + n_levels)]
    rng = random.Random(draw(st.integers(0, 2**32)))
    keys = st.tuples(st.integers(0, n_levels - 1), st.integers(0, 4))
    head = CodedTree(
        sh_degree=degree,
        n_levels=n_levels,
        grid_exponents=tuple(draw(st.sampled_from([0, -16, 40, 12])) for _ in range(5)),
        quantisers=tuple(tuple(rng.choices(row, k=n_classes(degree))) for row in rows),
        alpha=draw(st.dictionaries(keys, alpha_tables(), max_size=4)),
        tiles=(),
        info=draw(infos()),
    )
    tiles = [
        _tile(draw, head, rng, draw(st.integers(0, max_steps)), max_adds)
        for _ in range(draw(st.integers(0, max_tiles)))
    ]
    return replace(head, tiles=tuple(tiles))


def _tile(draw, tree: CodedTree, rng: random.Random, n_steps: int, max_adds: int) -> CodedTile:
    slots = _Slots([[] for _ in range(n_channels(tree.sh_degree))])
    steps: list[CodedStep] = []
    low, high = [MAX_X] * 3, [-MAX_X] * 3
    level = 0
    for _ in range(n_steps):
        level = min(level + draw(st.sampled_from([0, 1, 2])), tree.n_levels - 1)
        live = [slot for slot, is_live in enumerate(slots.live) if is_live]
        kind = st.sampled_from([Kind.REFINE, Kind.SPLIT, Kind.DROP])
        only = draw(st.none() | kind)
        chosen = sorted(draw(st.sets(st.sampled_from(live)))) if live else []
        if only is not None and draw(st.booleans()):
            chosen = live
        kinds = [draw(kind) if only is None else only for _ in chosen]
        n_adds = draw(st.integers(0, max_adds))
        steps.append(_step(draw, tree, rng, slots, level, chosen, kinds, n_adds))
        for axis in range(3):
            seen = [x for x, is_live in zip(slots.x[axis], slots.live, strict=True) if is_live]
            low[axis], high[axis] = min([low[axis], *seen]), max([high[axis], *seen])
    if low > high or draw(st.booleans()):  # no splat at all, or a box as large as it may be
        low, high = [-MAX_X] * 3, [MAX_X] * 3
    origin = draw(st.tuples(*[st.sampled_from(ORIGINS)] * 3))
    return CodedTile(origin, (low[0], low[1], low[2]), (high[0], high[1], high[2]), tuple(steps))


def _step(
    draw,
    tree: CodedTree,
    rng: random.Random,
    slots: _Slots,
    level: int,
    chosen: list[int],
    kinds: list[Kind],
    n_adds: int,
) -> CodedStep:
    """A step, applied to `slots`."""
    n_psi = sum(kind != Kind.DROP for kind in kinds)
    n_splits = sum(kind == Kind.SPLIT for kind in kinds)
    tables = [tree.alpha_table(level, group) for group in range(5)]
    alpha = [[rng.randrange(len(t.entries)) for _ in range(n_splits)] for t in tables]
    styles = [draw(st.sampled_from(Q_STYLES)) for _ in range(2)]
    psi, adds = [], []
    for channel, x in enumerate(slots.x):
        kind = channel_class(channel)
        size = rng.choice(styles)
        group = min(kind, 4)
        table = tables[group]
        entries = [table.entries[index] for index in alpha[group]]
        of_psi, of_adds = tree.quantisers[1 + level][kind], tree.quantisers[0][kind]
        psi.append(_psi(rng, size, x, chosen, kinds, of_psi, entries, table.shift))
        adds.append(_adds(rng, size, n_adds, of_adds))
        x.extend(q * of_adds.step for q in adds[-1])
    for slot, kind in zip(chosen, kinds, strict=True):
        slots.live[slot] = kind != Kind.DROP
    slots.live += [True] * (n_splits + n_adds)
    hint = st.integers(0, UNKNOWN_ERROR - 1)
    error = (draw(hint),) * (tree.sh_degree + 1) if draw(st.booleans()) else ()
    d = len(slots.x)
    return CodedStep(
        level,
        np.array(chosen, np.int32),
        np.array(kinds, np.uint8),
        np.array(alpha, np.uint8).reshape(5, n_splits),
        np.array(psi, np.int32).reshape(d, n_psi),
        np.array(adds, np.int32).reshape(d, n_adds),
        error,
    )


def _psi(
    rng: random.Random,
    size: int,
    x: list[int],
    chosen: list[int],
    kinds: list[Kind],
    quantiser: Quantiser,
    entries: list[int],
    shift: int,
) -> list[int]:
    """q of one channel, applied to x."""
    qs, seconds, alphas = [], [], iter(entries)
    limit = min(size, quantiser.max_q)
    for slot, kind in zip(chosen, kinds, strict=True):
        if kind == Kind.DROP:
            x[slot] = 0
            continue
        a = next(alphas) if kind == Kind.SPLIT else 0
        q = rng.choice((limit, -limit, rng.randint(-limit, limit)))
        q = max(LEAST_Q, min(q, MOST_Q))
        while not _is_legal(x[slot], q * quantiser.step, a, shift):
            q = int(q / 2)
        delta = q * quantiser.step
        if kind == Kind.SPLIT:
            seconds.append(x[slot] - round_shift(a * delta, shift))
        x[slot] += delta
        qs.append(q)
    x.extend(seconds)
    return qs


def _is_legal(p: int, delta: int, a: int, shift: int) -> bool:
    """R-7.3-1 to R-7.3-3 for a refine (a = 0) or split."""
    return (
        abs(delta) <= MAX_DELTA
        and abs(a * delta) + ((1 << shift) >> 1) <= MAX_PRODUCT
        and abs(p + delta) <= MAX_X
        and abs(p - round_shift(a * delta, shift)) <= MAX_X
    )


def round_shift(v: int, n: int) -> int:
    """Floor shift, ties toward +infinity (spec 4.2)."""
    return v if n == 0 else (v + (1 << (n - 1))) >> n


def _adds(rng: random.Random, size: int, n: int, quantiser: Quantiser) -> list[int]:
    """q of one channel; of the largest style a walk, which only differences can store."""
    limit = min(size, quantiser.max_q)
    if size < 1 << 23:
        return [rng.randint(-limit, limit) for _ in range(n)]
    direction = rng.choice((-1, 1))
    walk = [direction * MOST_Q * (k + 1) for k in range(n)]
    return [max(-quantiser.max_q, min(q, quantiser.max_q)) for q in walk]
