"""What prefixes show: of a stream, or of the coded tree that is to become one.

A cut of a stream, and the steps that each tile of a coded tree has, are the same thing here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.progressive import Decoder
from evogs_codec.encoding.replayed import Replayed
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.splats import I64, SplatParams
from evogs_codec.model.tree import Kind

__all__ = ["Prefixes", "StreamPrefixes", "TreePrefixes", "shown", "steps_of"]


C = TypeVar("C")  # a cut


class Prefixes(Protocol[C]):
    """Cuts, and what they show."""

    @property
    def n_levels(self) -> int:
        """Of the stream."""

    def of_level(self, level: int) -> C:
        """All steps up to those of a level."""

    def steps_of(self, level: int, *, rooms: bool = True) -> Iterator[C]:
        """After each of the steps of a level (`steps_of`)."""

    def of_cut(self, cut: Cut) -> C:
        """A cut of the stream, which has no palette."""

    def shown(self, cuts: Sequence[C], sh_degree: int) -> Iterator[SplatParams]:
        """The leaves of cuts of which each contains the one before."""


@dataclass(frozen=True, eq=False)
class StreamPrefixes:
    """Those of a stream.

    Attributes:
        data: its bytes.
    """

    data: bytes

    @cached_property
    def directory(self) -> Directory:
        """Of the stream."""
        return read_directory(self.data)

    @property
    def n_levels(self) -> int:
        """Of the stream."""
        return self.directory.n_levels

    def of_level(self, level: int) -> Cut:
        """All steps up to those of a level."""
        return Cut.of_level(self.directory, level)

    def steps_of(self, level: int, *, rooms: bool = True) -> Iterator[Cut]:
        """After each of the steps of a level (`steps_of`)."""
        return steps_of(self.directory, level, rooms=rooms)

    def of_cut(self, cut: Cut) -> Cut:
        """The same."""
        return cut

    def shown(self, cuts: Sequence[Cut], sh_degree: int) -> Iterator[SplatParams]:
        """The leaves of cuts of which each contains the one before."""
        return shown(self.data, self.directory, cuts, sh_degree)


@dataclass(frozen=True, eq=False)
class TreePrefixes:
    """Those of the stream that a coded tree becomes, with none of its bytes.

    Attributes:
        tree: the integers.
    """

    tree: CodedTree

    @property
    def n_levels(self) -> int:
        """Of the tree."""
        return self.tree.n_levels

    def of_level(self, level: int) -> I64:
        """(n_tiles,) steps of each tile up to those of a level."""
        return self._counts(lambda of: of <= level)

    def steps_of(self, level: int, *, rooms: bool = True) -> Iterator[I64]:
        """(n_tiles,) steps of each tile after each of the steps of a level (`steps_of`)."""
        before, whole = self._counts(lambda of: of < level), self.of_level(level)
        longest = int((whole - before).max(initial=0))
        for number in range(1, longest):
            if rooms or self._refines(before, number, whole):
                yield np.minimum(before + number, whole)
        yield whole

    def of_cut(self, cut: Cut) -> I64:
        """(n_tiles, 1 + degree) steps of core and of each SH band."""
        return cut.steps

    def shown(self, cuts: Sequence[I64], sh_degree: int) -> Iterator[SplatParams]:
        """The leaves after steps (n_tiles,), or those of `of_cut`; each has the one before."""
        replayed = Replayed(self.tree)
        for cut in cuts:
            yield replayed.after(cut, sh_degree)

    def _refines(self, before: I64, number: int, whole: I64) -> bool:
        """Whether the step of this number of a level refines a splat of some tile."""
        return any(
            bool((tile.steps[first + number - 1].kinds == Kind.REFINE).any())
            for tile, first, end in zip(self.tree.tiles, before, whole, strict=True)
            if first + number <= end
        )

    def _counts(self, takes: Callable[[int], bool]) -> I64:
        """(n_tiles,) steps of each tile whose level is taken."""
        return np.array(
            [sum(takes(step.level) for step in tile.steps) for tile in self.tree.tiles], np.int64
        )


def shown(
    data: bytes, directory: Directory, cuts: Sequence[Cut], sh_degree: int
) -> Iterator[SplatParams]:
    """The leaves of cuts of which each contains the one before; no packet is decoded twice."""
    decoder, stream = Decoder(), memoryview(data)
    decoder.feed(stream[: directory.data_offset])
    done = np.zeros(len(directory.packets), bool)
    sizes = directory.packets["size"].astype(np.int64)
    for cut in cuts:
        selected = cut.packets(directory)
        for packet in np.flatnonzero(selected & ~done).tolist():
            at = int(directory.offsets[packet])
            decoder.feed(stream[at : at + int(sizes[packet])], at)
        done |= selected
        yield decoder.leaves(sh_degree=sh_degree)


def steps_of(directory: Directory, level: int, *, rooms: bool = True) -> Iterator[Cut]:
    """After each of the steps of a level, of all tiles that have so many.

    Without `rooms` only after those that refine in some tile: others of late levels show nothing.
    """
    whole = Cut.of_level(directory, level)
    core = directory.columns == 0
    before = np.bincount(
        directory.packets["tile"][core & (directory.labels < level)], minlength=len(whole.steps)
    )
    own = np.flatnonzero(core & (directory.labels == level))
    numbers = directory.steps[own] - before[directory.packets["tile"][own]] + 1
    shows = rooms | (directory.packets["n_refines"][own] > 0)
    for number in np.unique(numbers[shows & (numbers < numbers.max(initial=0))]).tolist():
        n_steps = np.minimum(before + number, whole.steps[:, 0])
        yield Cut(np.minimum(whole.steps, n_steps[:, None]), whole.palette)
    yield whole
