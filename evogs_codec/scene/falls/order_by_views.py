"""Some packets of a stream in the order in which its pictures fall least.

Packets are put in order by estimates. An SH band alone may make pictures worse until another one is
there, whatever estimates say. So states between two prefixes are looked at, and the way through
them is taken that falls least: from a fall until pictures are better than before it, or to the
end, or, of few splats, through the last packets.

All states are looked at if they are few. Otherwise packets keep their order until one falls, and
those after it are tried in its place.

A state is how many packets of each component are there. Letters: B components.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.splats import I64, SplatParams
from evogs_codec.scene.falls.judges import PACKET_FALL_DB, Prefix
from evogs_codec.scene.prefixes import Prefixes

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["MAX_AROUND", "ordered_by_views"]

# Of the last packets, states that are drawn, and splats of all of these together.
MAX_STATES, MAX_SPLATS = 256, 64_000
# Of packets around a fall, or from it on: states that are drawn, or so many for each packet if that
# is more. Ways that do not fall were found with 4.
MAX_AROUND, MAX_STATES_OF_TURN = 16, 4
# Of the bytes of a component in a stretch; a packet that has less comes with the one before it.
JOINED_PART = 1 / 32
DIGITS = 2  # of a fall, dB: what is less is no difference
_State: TypeAlias = tuple[int, ...]


def ordered_by_views(
    data: bytes,
    prefixes: Prefixes[Any],
    views: Views,
    sh_degree: int,
    before: Callable[[int], tuple[float, Prefix | None]],
    rows: range | None = None,
    max_states: int = MAX_STATES,
    most: float = math.inf,
) -> tuple[bytes, float]:
    """The stream with some packets in another order, and the deepest fall until these end, dB.

    Itself, with an infinite fall, with several tiles or a palette, if no way to the end is found,
    or if it falls too much before. With rows, what small packets look like may not be drawn.

    Args:
        data: a stream.
        prefixes: of it.
        views: that judge.
        sh_degree: of the splats that are looked at.
        before: the deepest fall of the prefixes that end before a row, dB, and the best of them.
        rows: of the packets, to the end or not; None: as many of the last as may be.
        max_states: that are drawn, at most; fewer where there are few rows. Of the last packets all
            states are drawn.
        most: dB; a deeper fall is of no use.
    """
    directory = read_directory(data)
    if len(directory.tiles) != 1 or directory.has_palette:
        return data, math.inf
    stretch = _Stretch.of_last(directory) if rows is None else _Stretch.of(directory, rows)
    fall, best = before(len(stretch.first))
    if fall >= most:
        return data, math.inf
    cuts = _Cuts(prefixes, len(directory.components.of_tiles), sh_degree)
    sizes = directory.packets["size"].astype(np.int64)
    max_states = min(max_states, stretch.max_drawn)
    if best is None or rows is None or math.prod(stretch.counts) <= max_states:
        looks = {state: views.psnr(cuts.leaves(stretch.cut(state))) for state in stretch.states()}
        way: _Way | _Begun | None
        way = _best_way(stretch, looks, -math.inf if best is None else best.psnr, sizes)
    else:
        stretch = stretch.joined(sizes)
        way = _some_way(stretch, lambda cut: best.like(cuts.leaves(cut)), best, max_states, most)
        if way is None:
            return data, math.inf
    return _reordered(data, directory, stretch.rows(way.columns)), max(fall, way.fall)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """The packets of each component that are put in order.

    A packet without bytes comes with the next one that has some, or after all others.

    Attributes:
        first: (n,) rows before them.
        chains: per component, the groups of rows that come together.
        steps: (B,) of each component in the first rows.
        last: rows without bytes that nothing follows, and those after the stretch.
    """

    first: I64
    chains: tuple[tuple[I64, ...], ...]
    steps: I64
    last: I64

    @staticmethod
    def of_last(directory: Directory) -> _Stretch:
        """Of as many last packets as give no more states than may be drawn."""
        n, n_slots = len(directory.packets), max(int(directory.tile_slots.sum()), 1)
        most = min(MAX_STATES, MAX_SPLATS // n_slots)
        best = _Stretch.of(directory, range(n, n))
        for begin in reversed(range(n)):
            stretch = _Stretch.of(directory, range(begin, n))
            if math.prod(stretch.counts) > most:
                break
            best = stretch
        return best

    @staticmethod
    def of(directory: Directory, rows: range) -> _Stretch:
        """Of the packets of these rows."""
        columns, has_bytes = directory.columns, directory.packets["size"] > 0
        n_columns = len(directory.components.of_tiles)
        chains, last = [], []
        for column in range(n_columns):
            own = rows.start + np.flatnonzero(columns[rows.start : rows.stop] == column)
            groups = np.split(own, np.flatnonzero(has_bytes[own]) + 1)
            chains.append(tuple(groups[:-1]))
            last.append(groups[-1])
        first, after = np.arange(rows.start), np.arange(rows.stop, len(columns))
        steps = np.bincount(columns[first], minlength=n_columns)
        empty = np.sort(np.concatenate(last))
        return _Stretch(first, tuple(chains), steps, np.concatenate([empty, after]))

    def joined(self, sizes: I64) -> _Stretch:
        """Where packets that have a small part of the bytes of their component come with others.

        `sizes`: (n,) bytes of all packets.
        """
        chains: list[tuple[I64, ...]] = []
        for chain in self.chains:
            groups: list[I64] = []
            n_small = JOINED_PART * sum(int(sizes[group].sum()) for group in chain)
            for group in chain:
                if groups and sizes[group].sum() < n_small:
                    groups[-1] = np.concatenate([groups[-1], group])
                else:
                    groups.append(group)
            chains.append(tuple(groups))
        return replace(self, chains=tuple(chains))

    @property
    def max_drawn(self) -> int:
        """How many states may be drawn at most."""
        return max(MAX_AROUND, MAX_STATES_OF_TURN * sum(self.end))

    @property
    def counts(self) -> list[int]:
        """(B,) states of each component."""
        return [1 + len(chain) for chain in self.chains]

    @property
    def begin(self) -> _State:
        """(B,) the state that has none of the packets."""
        return (0,) * len(self.chains)

    @property
    def end(self) -> _State:
        """(B,) the state that has all packets."""
        return tuple(map(len, self.chains))

    def states(self) -> Iterator[_State]:
        """All there are."""
        return filter(self._is_there, product(*map(range, self.counts)))

    def after(self, state: _State) -> Iterator[tuple[int, int, _State]]:
        """Of each component with a packet left: its row, the component, and the state with it."""
        for column, chain in enumerate(self.chains):
            then = (*state[:column], state[column] + 1, *state[column + 1 :])
            if state[column] < len(chain) and self._is_there(then):
                yield int(chain[state[column]][-1]), column, then

    def cut(self, state: _State) -> Cut:
        """What a state has."""
        return Cut(self._steps(state)[None])

    def _is_there(self, state: _State) -> bool:
        """Whether no band has a step that core does not."""
        steps = self._steps(state)
        return bool((steps <= steps[0]).all())

    def _steps(self, state: _State) -> I64:
        """(B,) of each component."""
        steps = self.steps.copy()
        for column, n in enumerate(state):
            steps[column] += sum(len(group) for group in self.chains[column][:n])
        return steps

    def rows(self, way: _State) -> I64:
        """All rows, those of the stretch in the order in which components take their turns."""
        turns = [iter(chain) for chain in self.chains]
        return np.concatenate([self.first, *(next(turns[column]) for column in way), self.last])


def _some_way(
    stretch: _Stretch,
    look: Callable[[Cut], Prefix],
    before: Prefix,
    max_states: int,
    most: float,
) -> _Begun | None:
    """The way to the end that falls least; a fall of up to `PACKET_FALL_DB` is none.

    Of all ways so far the one that falls least goes on, of these the longest, with the packet that
    comes first in the stream.

    Args:
        stretch: the packets that are put in order.
        look: at what a state has.
        before: the best of the prefixes of packets that stay where they are.
        max_states: that are looked at; there is no way if the end is not reached.
        most: dB that a way falls, or there is none.
    """
    if sum(stretch.end) >= max_states:
        return None
    looks: dict[_State, Prefix] = {}
    # States that were gone on from, and the best prefix until there.
    done: dict[_State, Prefix] = {}
    ways = [_Begun(0.0, 0, 0, (), stretch.begin, before)]
    while ways:
        way = heappop(ways)
        if way.fall > most:
            break
        state, best = way.state, way.best
        if state not in looks:
            if len(looks) == max_states:
                break
            looks[state] = look(stretch.cut(state))
        own = looks[state].fall_after(best, most)
        if own > max(way.fall, PACKET_FALL_DB) and way.columns:
            heappush(ways, way._replace(fall=own))
            continue
        if state == stretch.end:
            return way
        best = looks[state] if own < 0 else best
        if state not in done or best.fall_after(done[state]) > 0:
            done[state] = best
            for row, column, then in stretch.after(state):
                columns = (*way.columns, column)
                heappush(ways, _Begun(way.fall, -len(columns), row, columns, then, best))
    return None


class _Begun(NamedTuple):
    """A way to a state that may not have been looked at yet. The least of the ways goes on first.

    Attributes:
        fall: the deepest on it, dB.
        minus_length: minus the number of its turns: of equal falls the longest way goes on.
        row: of its last packet.
        columns: of the components, in the order of their turns.
        state: where it ends.
        best: the best prefix before that.
    """

    fall: float
    minus_length: int
    row: int
    columns: tuple[int, ...]
    state: _State
    best: Prefix


def _best_way(stretch: _Stretch, looks: Mapping[_State, float], before: float, sizes: I64) -> _Way:
    """The way through all states that falls least.

    Of ways that fall as little, the one whose prefixes look better, byte for byte.

    Args:
        stretch: the packets that are put in order.
        looks: PSNR of each state that there is, dB.
        before: the highest PSNR of the prefixes of packets that stay where they are, dB.
        sizes: bytes of each packet.
    """
    ways = {stretch.begin: [_Way((), 0.0, max(before, looks[stretch.begin]), 0.0)]}
    for state in sorted(looks, key=sum)[1:]:
        found: list[_Way] = []
        for column, n in enumerate(state):
            n_bytes = int(sizes[stretch.chains[column][n - 1]].sum()) if n else 0
            there = ways.get((*state[:column], n - 1, *state[column + 1 :]), ())
            found += [way.after(column, looks[state], n_bytes) for way in there]
        ways[state] = _not_beaten(found)
    last = ways[max(ways, key=sum)]
    return min(last, key=lambda way: (round(way.fall, DIGITS), way.lost))


def _not_beaten(ways: Sequence[_Way]) -> list[_Way]:
    """Ways to a state, without those that another one equals or beats in all that matters later."""
    kept: list[_Way] = []
    for way in sorted(ways, key=lambda way: (way.fall, way.highest, way.lost)):
        if not any(one.highest <= way.highest and one.lost <= way.lost for one in kept):
            kept.append(way)
    return kept


@dataclass(frozen=True)
class _Way:
    """A way to a state.

    Attributes:
        columns: of the components, in the order of their turns.
        fall: the deepest on it, dB.
        highest: the highest PSNR on it, dB.
        lost: minus the sum over its packets of the best PSNR before each times its bytes. The less,
            the better its prefixes look.
    """

    columns: tuple[int, ...]
    fall: float
    highest: float
    lost: float

    def after(self, column: int, decibels: float, n_bytes: int) -> _Way:
        """With a turn of a component, after which the PSNR is this."""
        return _Way(
            (*self.columns, column),
            max(self.fall, self.highest - decibels),
            max(self.highest, decibels),
            self.lost - self.highest * n_bytes,
        )


@dataclass(frozen=True)
class _Cuts:
    """What cuts of a stream of one tile show.

    Attributes:
        prefixes: of the stream.
        n_components: of the tile.
        sh_degree: of the splats.
        bands: by steps of core, a band and its steps, the leaves of what has these alone.
    """

    prefixes: Prefixes[Any]
    n_components: int
    sh_degree: int
    bands: dict[tuple[int, int, int], SplatParams] = field(default_factory=dict)

    def leaves(self, cut: Cut) -> SplatParams:
        """Of a cut. Bands do not depend on each other, so each is decoded once."""
        core, *others = cut.steps[0].tolist()
        leaves = self._with_band(core, 0, 0)
        sh = leaves.sh.copy()
        for band, n_steps in enumerate(others[: self.sh_degree], 1):
            part = slice(band**2, (band + 1) ** 2)
            sh[:, part] = self._with_band(core, band, n_steps).sh[:, part]
        return replace(leaves, sh=sh)

    def _with_band(self, core: int, band: int, n_steps: int) -> SplatParams:
        key = (core, band, n_steps)
        if key not in self.bands:
            steps = np.zeros((1, self.n_components), np.int64)
            steps[0, band], steps[0, 0] = n_steps, core
            cut = self.prefixes.of_cut(Cut(steps))
            self.bands[key] = next(self.prefixes.shown([cut], self.sh_degree))
        return self.bands[key]


def _reordered(data: bytes, directory: Directory, rows: I64) -> bytes:
    """The stream with its packets in the order of these rows."""
    packets = directory.packets[rows]
    head = rebuild_directory(directory, directory.tiles, packets, directory.digests)
    begins, sizes = directory.offsets[rows].tolist(), packets["size"].tolist()
    bodies = [data[at : at + size] for at, size in zip(begins, sizes, strict=True)]
    return b"".join([head, *bodies])
