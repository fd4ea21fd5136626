"""Encoding to a target: a PSNR, a number of bytes, or a largest error.

What is searched for is one number. With views it is the price of a bit, from which follow all
steps and roundings (`sensitivity`); without, the factor of the steps of the settings.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.arrange import arrange, default_tiles
from evogs_codec.encoding.grids import AccuracyWarning
from evogs_codec.encoding.held_steps import Run, held
from evogs_codec.encoding.layers import Layered, expect_levels
from evogs_codec.encoding.measured_gains import MeasuredGains, Pictures, Telling, nothing_of
from evogs_codec.encoding.polish import polished
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.sensitivity import SEEN, Importance, StepWeights
from evogs_codec.encoding.settings import ALPHA_BITS, N_ALPHA, NearLossless, Settings, StepTable
from evogs_codec.encoding.write import write
from evogs_codec.errors import InputError
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, SplatParams
from evogs_codec.model.tree import EvolutionTree

__all__ = ["PRICES", "Prepared", "TargetEncoder", "TargetMissedError"]

FIRST_PRICE = 1e-11  # mean squared error that a bit is worth: about 45 dB
PRICES = (1e-18, 1e-5)
FACTORS = (1e-4, 1e4)
MOST_TRIES = 14
MORE_TRIES = 60  # of few splats, where a rounding moves a PSNR
TRIED = 200_000  # splats, those of all tries together
NARROW = 1e-6
ROUGH, SPREAD, GOLDEN = 0.02, 0.2, 0.618  # of the logarithm of a price
PSNR_SLACK, BYTES_SLACK = 0.1, 0.005  # dB, and part of the bytes asked for
POLISH_GAIN = 2.0  # dB, about
FAR_PSNR, FAR_BYTES = 15.0, math.log(8.0)  # from the first try: the end of the range is tried next
ONE_SIDED = 3  # tries on one side of a target, after which it is, too

T = TypeVar("T")


class TargetMissedError(InputError):
    """No stream of a tree meets a target; `by` how much the nearest misses it."""

    def __init__(self, said: str, by: float) -> None:
        super().__init__(said)
        self.by = by


@dataclass(frozen=True)
class TargetEncoder:
    """A tree that is encoded until it meets a target.

    Attributes:
        tree: any.
        settings: what is kept of them: the effort, and the steps where there are no views.
        views: of the tree's leaves, or None.
        polish: iterations of `polished`, where views decide; 0 for none.
        layers: of precision (`layers`), where views decide.
        leaf_error: (5,) per group, the largest distance of the tree's leaves from the splats that
            they stand for: `within` adds it to the error of the stream.
        ordering: a few views by which packets are put in order, where those that are drawn for the
            sensitivity do not tell; `views` by default.
        seen: part of the worth of a number that the views decide.
        n_tiles, info, progress: as of `encode`.
        n_levels: of the first layer; by default those of the tree.
    """

    tree: EvolutionTree
    settings: Settings
    views: Pictures | None = None
    polish: int = 0
    layers: int = 1
    leaf_error: tuple[float, ...] = (0.0,) * len(GROUPS)
    ordering: Pictures | None = None
    seen: float = SEEN
    n_tiles: int | None = None
    info: SceneInfo | None = None
    progress: Progress | None = None
    n_levels: int = 1

    def at_psnr(self, decibels: float) -> bytes:
        """The stream whose leaves have this PSNR against the tree's, within 0.2 dB.

        Raises:
            InputError: no price of a bit gives it.
            ValueError: there are no views.
        """
        coder = self.prepared
        tries = max(MOST_TRIES, min(MORE_TRIES, TRIED // max(self.tree.n_leaves, 1)))

        def measure(coded: CodedTree) -> tuple[float, CodedTree]:
            return self.psnr(write(coded, effort=1, digests=False)), coded

        def search(
            code: Callable[[float], CodedTree],
            target: float,
            start: float,
            slack: float,
            tries: int = MOST_TRIES,
        ) -> _Found[CodedTree]:
            # 3 dB for a price twice as high.
            slope = -10 / math.log(10)
            return _search(
                lambda price: measure(code(price)),
                target,
                slope,
                start,
                PRICES,
                slack,
                tries=tries,
                far=FAR_PSNR,
            )

        plain = search(coder.coded, decibels, FIRST_PRICE, PSNR_SLACK, tries)
        room = 2 * PSNR_SLACK + (2 * POLISH_GAIN if coder.polishes else 0)
        if plain.is_end and abs(plain.value - decibels) > room:
            end = "largest" if plain.value < decibels else "smallest"
            each = len(write(plain.what, effort=1, digests=False)) / self.tree.n_leaves
            said = (
                f"{decibels:g} dB cannot be met: the {end} PSNR that can be reached is"
                f" {plain.value:.1f} dB, with about {each:.1f} bytes a splat"
            )
            raise TargetMissedError(said, abs(plain.value - decibels))
        found = [plain]
        if coder.polishes:
            near = search(coder.coded, decibels - POLISH_GAIN, FIRST_PRICE, POLISH_GAIN / 4)
            found.append(search(coder.polished, decibels, near.at, PSNR_SLACK))
        met = [one.what for one in found if abs(one.value - decibels) <= 2 * PSNR_SLACK]
        if not met:
            said = f"{decibels:g} dB cannot be met: {plain.value:.2f} dB is nearest"
            raise TargetMissedError(said, abs(plain.value - decibels))
        return min(map(self.written, met), key=len)

    def at_bytes(self, n_bytes: int) -> bytes:
        """The stream of at most this many bytes, and at least 98 % of them.

        Raises:
            InputError: no price of a bit gives it.
        """
        coder = self.prepared

        def search(code: Callable[[float], CodedTree], start: float) -> _Found[bytes]:
            def measure(price: float) -> tuple[float, bytes]:
                data = self.written(code(price))
                return math.log(len(data)), data

            bounds = PRICES if self.views else FACTORS
            most = math.log(n_bytes)
            return _search(
                measure,
                most - BYTES_SLACK,
                -0.1,
                start,
                bounds,
                BYTES_SLACK,
                most,
                far=FAR_BYTES,
            )

        plain = search(coder.coded, FIRST_PRICE if self.views else 1.0)
        if plain.is_end and not 0.98 * n_bytes <= len(plain.what) <= n_bytes:
            end = "largest" if len(plain.what) < n_bytes else "smallest"
            n_end = len(plain.what)
            said = f"{n_bytes:,} bytes cannot be met: the {end} stream has {n_end:,} bytes"
            raise TargetMissedError(said, abs(len(plain.what) - n_bytes))
        found = [search(coder.polished, plain.at), plain] if coder.polishes else [plain]
        met = [one.what for one in found if 0.98 * n_bytes <= len(one.what) <= n_bytes]
        if not met:
            said = f"{n_bytes:,} bytes cannot be met: {len(plain.what):,} is nearest"
            raise TargetMissedError(said, abs(len(plain.what) - n_bytes))
        return met[0] if len(met) == 1 else max(met, key=self.psnr)

    def at_prices(self, prices: Iterable[float]) -> Iterator[bytes]:
        """A stream for each price of a bit, a mean squared error of the views; not polished.

        Raises:
            ValueError: there are no views.
        """
        if self.views is None:
            raise ValueError("a price of a bit needs views")
        for price in prices:
            yield self.written(self.prepared.coded(price))

    def at_price(self, price: float) -> bytes:
        """The stream of `at_prices` for one price.

        Raises:
            ValueError: there are no views.
        """
        return next(iter(self.at_prices([price])))

    @property
    def importance(self) -> Importance | None:
        """Of the numbers of the arranged tree, by the views; None without."""
        return self.prepared.importance

    @cached_property
    def prepared(self) -> Prepared:
        """The tree, arranged and weighed."""
        return Prepared(self)

    def holding(self, runs: Sequence[Run], ratio: float) -> TargetEncoder:
        """The same with runs of steps held back (`held_steps`); nothing is drawn again.

        Args:
            runs: of the streams that this one makes.
            ratio: of the price of a bit, from a layer to the next.
        """
        other = replace(self)
        other.__dict__["prepared"] = self.prepared.holding(runs, ratio)
        return other

    def within(self, errors: Mapping[str, float]) -> bytes:
        """The stream no number of whose leaves is further off than its group allows.

        Args:
            errors: largest error per name of a group, in its own units; of some or all groups.

        Raises:
            InputError: float32, or the alphas of the tree, do not allow it.
            ValueError: an error is not above 0.
        """
        if not all(error > 0 for error in errors.values()):
            raise ValueError("largest errors are above 0")
        asked = np.array([errors.get(name, math.inf) for name in GROUPS])
        if np.any(self.leaf_error > asked):
            raise self._missed(asked, np.array(self.leaf_error))
        coder = Prepared(replace(self, views=None, polish=0, layers=1))
        finest = replace(self.settings, accuracy=NearLossless())
        table = coder.first_table()
        groups = np.minimum(np.arange(table.shape[1]), 4)
        table = np.where(np.isinf(asked[groups]), table, 2 * asked[groups])
        for attempt in range(MOST_TRIES):
            is_last = attempt == MOST_TRIES - 1
            settings = finest if is_last else replace(self.settings, accuracy=StepTable.of(table))
            data = self.written(coder.quantised(settings))
            found = self._errors_of(coder, data)
            if np.all(found <= asked):
                return data
            if attempt == ONE_SIDED - 1 or (not attempt and np.any(found > 2 * asked)):
                least = self._errors_of(coder, write(coder.quantised(finest), effort=1))
                if np.any(least > 2 * asked):  # what is finest is a unit off; steps half of one
                    raise self._missed(asked, least)
            finer = np.where(
                found > asked, np.minimum(0.9 * asked / np.maximum(found, 1e-300), 0.9), 1
            )
            table = table * np.maximum(finer, 0.02)[groups]
        raise self._missed(asked, found)

    def _errors_of(self, coder: Prepared, data: bytes) -> F64:
        """(5,) largest error of a stream per group, with those of the tree."""
        return _errors(coder.tiles, data, self.tree.shown_degree) + self.leaf_error

    def _missed(self, asked: F64, least: F64) -> TargetMissedError:
        """That of these (5,) errors the least that were found are too large."""
        worst = int(np.argmax(least / asked))
        why = (
            ", as float32 rounds the tree: try --levels 1"
            if self.leaf_error[worst] > asked[worst] / 2
            else ""
        )
        said = (
            f"{GROUPS[worst]}: an error of {asked[worst]:g} cannot be kept: the least is"
            f" {least[worst]:.3g}{why}"
        )
        return TargetMissedError(said, float(least[worst] / asked[worst]))

    def psnr(self, data: bytes) -> float:
        """Of the leaves of a stream, dB.

        Raises:
            ValueError: there are no views.
        """
        if self.views is None:
            raise ValueError("a PSNR needs views")
        return self.views.psnr(decode(data).leaves(sh_degree=self.tree.shown_degree))

    def written(self, coded: CodedTree) -> bytes:
        """The stream of a coded tree, with digests."""
        return write(coded, effort=self.settings.effort, progress=self.progress)


class Prepared:
    """A tree arranged once, and quantised as often as it takes."""

    def __init__(self, aim: TargetEncoder) -> None:
        self.aim = aim
        self.n_levels = max(aim.tree.n_levels, aim.n_levels)
        if (aim.polish or aim.layers > 1) and aim.views is None:
            raise ValueError(f"{'polishing needs' if aim.polish else 'layers need'} views")
        if aim.layers > 1:
            expect_levels(self.n_levels, aim.layers)  # before anything is rendered
        self.polishes = aim.polish > 0 and (self.n_levels > 1 or aim.layers > 1)
        report = aim.progress or no_progress
        report("arrange", 0.0)
        self.tiles = arrange(aim.tree, aim.n_tiles or default_tiles(aim.tree.n_leaves))
        self.importance = self.shown = self.layered = None
        if aim.views is not None:
            report("draw", 0.0)
            self.importance, self.shown = _drawn(aim, aim.views, self.tiles, self.n_levels)
            if aim.layers > 1 and aim.tree.n_leaves:
                self.layered = Layered.of(self.tiles, self.n_levels, self.importance, aim.layers)
        self.ranges = Ranges.of(self.tiles, self.n_levels)

    def holding(self, runs: Sequence[Run], ratio: float) -> Prepared:
        """The same with runs of steps held back."""
        other = copy(self)
        if self.importance is None:
            return other
        pairs = zip(self.tiles, self.importance.weights, strict=True)
        tiles, weights = zip(*(held(tile, own, runs) for tile, own in pairs), strict=True)
        other.tiles, other.importance = list(tiles), replace(self.importance, weights=weights)
        if self.layered is not None:
            n_layers = self.aim.layers
            other.layered = Layered.of(
                other.tiles, self.n_levels, other.importance, n_layers, ratio
            )
        other.ranges = Ranges.of(other.tiles, self.n_levels)
        return other

    def coded(self, at: float) -> CodedTree:
        """At a price of a bit, or at a factor of the steps."""
        if self.importance is None:
            return self.quantised(self.aim.settings.finer(1 / at))
        source = self.layered or self.importance
        settings = replace(
            self.aim.settings,
            accuracy=StepTable.of(source.steps(at, self.ranges.extent)),
            n_alpha=N_ALPHA,
            alpha_bits=ALPHA_BITS,
        )
        if self.layered is not None:
            weights = self.layered.weights(at, self.ranges.extent)
            return self.layered.with_gains(self.quantised(settings, weights, at))
        return self.quantised(settings, self.importance.raised(at, self.ranges.extent), at)

    def polished(self, price: float) -> CodedTree:
        """At a price of a bit, the integers of the last level moved by pictures."""
        views, report = self.aim.views, self.aim.progress or no_progress
        assert views is not None, "polishing has views"
        return polished(
            self.coded(price), views, price, self.aim.polish, lambda part: report("polish", part)
        )

    def quantised(
        self,
        settings: Settings,
        weights: Sequence[Sequence[StepWeights | None]] | None = None,
        price: float = 1.0,
    ) -> CodedTree:
        """With these settings."""
        with warnings.catch_warnings():
            # Of a search: whoever asks for a target is told whether it was met.
            warnings.simplefilter("ignore", AccuracyWarning)
            coded = quantise(
                self.layered.tiles if self.layered else self.tiles,
                self.layered.n_levels if self.layered else self.n_levels,
                settings,
                weights=weights,
                entry_weights=self.importance.entries if weights and self.importance else None,
                price=price,
                ranges=self.ranges,  # layers move nothing
                info=self.aim.info,
            )
        return self.shown.rescale(coded) if self.shown else coded

    def first_table(self) -> F64:
        """(1 + n_levels, K) steps of the settings."""
        return self.aim.settings.accuracy.wanted_steps(self.ranges, self.n_levels)


def _drawn(
    aim: TargetEncoder, views: Pictures, tiles: Sequence[EvolutionTree], n_levels: int
) -> tuple[Importance, MeasuredGains]:
    """What the numbers of arranged tiles are worth, and what their packets gain."""
    if aim.ordering is None or not isinstance(views, Telling):
        found = Importance.of(tiles, n_levels, views.sensitivity, seen=aim.seen)
        return found, MeasuredGains.of(aim.tree, aim.ordering or views)
    told: list[float] = []

    def sensitivity(splats: SplatParams) -> F32:
        found, decibels = views.sensitivity_and_psnr(splats)
        told.append(decibels)
        return found

    sensitivity(nothing_of(aim.tree.leaves(0)))
    found = Importance.of(tiles, n_levels, sensitivity, seen=aim.seen)
    shown = told[:-1] if len(told) == 1 + n_levels else None  # of each level that has splats
    return found, MeasuredGains.of(aim.tree, aim.ordering, shown)


def _errors(tiles: Sequence[EvolutionTree], data: bytes, sh_degree: int) -> F64:
    """(5,) largest error of the leaves of a stream, per group, in the units of the group."""
    leaves = [tile.leaves().channels() for tile in tiles if tile.steps]
    if not leaves:
        return np.zeros(len(GROUPS))
    right = np.concatenate(leaves, axis=1)
    found = decode(data).leaves(sh_degree=sh_degree).channels()
    off = np.abs(found.astype(np.float64) - right)
    return np.array([off[part].max(initial=0.0) for part in GROUP_CHANNELS])


@dataclass(frozen=True)
class _Found(Generic[T]):
    """The best of a search: where, its value, and what has it.

    `is_end`: an end of what was searched, beyond which the target lies.
    """

    at: float
    value: float
    what: T
    is_end: bool = False


def _search(
    measure: Callable[[float], tuple[float, T]],
    target: float,
    slope: float,
    start: float,
    bounds: tuple[float, float],
    slack: float,
    most: float = math.inf,
    tries: int = MOST_TRIES,
    far: float = math.inf,
) -> _Found[T]:
    """Where a value that falls is nearest to `target`: secants in the logarithm, kept in brackets.

    Args:
        measure: value at a place, and what has it.
        target: of the value.
        slope: first guess of the change of the value over that of the logarithm of the place.
        start: first place.
        bounds: no place is outside.
        slack: a value this near is good enough.
        most: a value above it is the best only where none is below.
        tries: at most.
        far: a first value that is further off has the end of the range tried, as one does of which
            the first tries are all on one side: if the end does not reach the target, nothing does.
    """

    def badness(value: float) -> tuple[bool, float]:
        return value > most, abs(value - target)

    low, high = (math.log(bound) for bound in bounds)
    at = math.log(start)
    best: _Found[T] | None = None
    before: tuple[float, float] | None = None
    middle: float | None = None
    is_above: set[bool] = set()
    tried: set[float] = set()  # ends of the range
    for k in range(tries):
        value, what = measure(math.exp(at))
        if best is None or badness(value) < badness(best.value):
            best = _Found(math.exp(at), value, what)
        if abs(value - target) <= slack:
            break
        is_above.add(value > target)
        if k + 1 == ONE_SIDED or (not k and abs(value - target) > far):
            end = bounds[0] if value < target else bounds[1]
            if len(is_above) == 1 and end not in tried:
                tried.add(end)
                last, at_end = measure(end)
                if (last > target) == (value > target) and abs(last - target) > slack:
                    return _Found(end, last, at_end, is_end=True)
        if value > target:
            low = at
        else:
            high = at
        if before is not None and before[0] != at and (before[1] - value) * (before[0] - at) < 0:
            slope = (before[1] - value) / (before[0] - at)
        before = at, value
        at += (target - value) / slope
        if not low < at < high:
            at = (low + high) / 2
        if k + 1 == MOST_TRIES and high - low < ROUGH and is_above == {True, False}:
            middle = (low + high) / 2
        if middle is not None:
            # Of few splats a PSNR is rough: places around have any value near it.
            at = middle + SPREAD * (k * GOLDEN % 1 - 0.5)
        elif high - low < NARROW or k + 1 >= MOST_TRIES:
            break
    assert best is not None
    return best
