"""Encoding to a target: a PSNR, a number of bytes, or a largest error.

What is searched for is one number. With views it is the price of a bit, from which follow all
steps and roundings (`sensitivity`); without, the factor of the steps of the settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.drawn import Drawn
from evogs_codec.encoding.few_views import FewViews
from evogs_codec.encoding.guess import (
    BYTES_SLOPE,
    PRICES,
    PSNR_SLOPE,
    USUAL_PSNR,
    Guess,
    goal_of_bytes,
    goal_of_psnr,
    psnr_slope,
)
from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.largest_errors import largest_errors
from evogs_codec.encoding.layers import Layering
from evogs_codec.encoding.out_of_reach import (
    TargetMissedError,
    bytes_missed,
    errors_missed,
    psnr_missed,
)
from evogs_codec.encoding.pictures import Divisible
from evogs_codec.encoding.prepared import EncodeTask, Prepared
from evogs_codec.encoding.replayed import leaves_of
from evogs_codec.encoding.search import (
    MAX_TRIES,
    MIN_BRACKET,
    TRIES_ON_ONE_SIDE,
    Found,
    Goal,
    Start,
    nearest,
)
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.settings import NearLossless, StepTable
from evogs_codec.encoding.sketch import Sketch
from evogs_codec.encoding.write import write
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import F64, SplatParams

__all__ = ["TargetEncoder"]

FIRST_PRICE = 1e-11  # mean squared error that a bit is worth: about 45 dB
STEP_FACTORS = (1e-4, 1e4)
# Prices that are tried around a jump of the PSNR, of few splats, which a rounding moves; and splats
# of all tries together.
MAX_PROBES, MAX_PROBED = 24, 200_000
JUMP_WIDTH = 0.09  # of the logarithm of a price: an end of it is within 0.2 dB, where no PSNR jumps
POLISH_GAIN_DB = 2.0  # dB, about
# A first try that is so far from the target has the end of the range tried next.
FAR_DB, FAR_LOG_BYTES = 15.0, math.log(8.0)


@dataclass(frozen=True)
class TargetEncoder(EncodeTask):
    """A tree that is encoded until it meets a target.

    Attributes, others than those of `EncodeTask`:
        guess: where a search may begin, if that has been guessed.
    """

    guess: Guess | None = None

    def at_psnr(self, decibels: float) -> bytes:
        """The stream whose leaves have this PSNR in the views, within 0.2 dB.

        Above 60 dB it may be further off: 0.5 dB from 70 dB on. If none is that near, the smallest
        one above that was found.

        Raises:
            InputError: no price of a bit gives it.
            ValueError: there are no views.
        """
        return self.nearest_psnr(decibels).what

    def nearest_psnr(
        self, decibels: float, near: float | None = None, missed_by: float | None = None
    ) -> Found[bytes]:
        """`at_psnr`, and the price of a bit; looked for from `near` on.

        Args:
            decibels: the target.
            near: a price of a bit to begin with.
            missed_by: dB that the stream may be off, if that is more than of `at_psnr`.
        """
        if self.guess and self.guess.met:
            done = self.guess.met
            return Found(done.at, done.value, self.written(done.what))
        goal, prepared = goal_of_psnr(decibels), self.prepared
        if self.guess:
            goal = replace(goal, slack=max(goal.slack, self.guess.jump))
        missed_by = goal.slack if missed_by is None else max(missed_by, goal.slack)
        probes = max(0, min(MAX_PROBES, MAX_PROBED // max(self.tree.n_leaves, 1) - MAX_TRIES))

        def search(
            code: Callable[[float], CodedTree],
            goal: Goal,
            start: float,
            probes: int = 0,
            narrow: float = MIN_BRACKET,
        ) -> Found[CodedTree]:
            views = self.views
            psnr = FewViews(views, goal).psnr if isinstance(views, Divisible) else self._psnr

            def measure(price: float) -> tuple[float, CodedTree]:
                coded = code(price)
                return psnr(leaves_of(coded, self.tree.shown_degree)), coded

            found = nearest(
                measure,
                goal,
                replace(self.guess, at=start) if self.guess else Start(start, PSNR_SLOPE),
                PRICES,
                probes=probes,
                far=FAR_DB,
                narrow=narrow,
            )
            return found if goal.is_met(found.value) else self._with_psnr(found)

        first = near or FIRST_PRICE
        plain = search(prepared.coded, goal, first, probes, JUMP_WIDTH)
        room = missed_by + (2 * POLISH_GAIN_DB if prepared.polishes else 0)
        if plain.is_end and abs(plain.value - decibels) > room:
            raise self._psnr_missed(decibels, plain)
        found = [plain]
        if prepared.polishes:
            lower = Goal(decibels - POLISH_GAIN_DB, POLISH_GAIN_DB / 4)
            below = search(prepared.coded, lower, first)
            found.append(search(prepared.polished, goal, below.at))
        met = [one for one in found if abs(one.value - decibels) <= missed_by]
        if not met and plain.above is not None and not plain.is_end:
            met = [self._with_psnr(plain.above)]
        if not met:
            said = f"{decibels:g} dB cannot be met: {plain.value:.2f} dB is nearest"
            raise TargetMissedError(said, abs(plain.value - decibels))
        streams = [Found(one.at, one.value, self.written(one.what)) for one in met]
        return min(streams, key=lambda one: len(one.what))

    def expect_psnr(self, decibels: float) -> None:
        """Try the end of the range of prices that is nearer to a PSNR, which is high or low.

        Raises:
            TargetMissedError: it misses the PSNR by more than a stream may.
        """
        is_high = decibels > USUAL_PSNR
        price = PRICES[0 if is_high else 1]
        coded = self.prepared.coded(price)
        value = self._psnr_of(coded)
        if (decibels - value if is_high else value - decibels) > goal_of_psnr(decibels).slack:
            raise self._psnr_missed(decibels, Found(price, value, coded))

    def _psnr_missed(self, decibels: float, end: Found[CodedTree]) -> TargetMissedError:
        """That of a PSNR beyond an end of the range of prices."""
        other = self._psnr_of(self.prepared.coded(PRICES[end.at == PRICES[0]]))
        each = len(write(end.what, zstd_level=1, digests=False)) / self.tree.n_leaves
        return psnr_missed(decibels, end.value, other, each)

    def at_bytes(self, n_bytes: int) -> bytes:
        """The stream of at most this many bytes, and at least 98 % of them.

        Raises:
            InputError: no price of a bit gives it.
        """
        return self.nearest_bytes(n_bytes).what

    def nearest_bytes(self, n_bytes: int, near: float | None = None) -> Found[bytes]:
        """`at_bytes`, and the price of a bit; looked for from `near` on."""
        if self.guess and self.guess.met:
            done = self.guess.met
            return Found(done.at, done.value, self.written(done.what))
        prepared = self.prepared
        slope = BYTES_SLOPE if self.views else -0.1

        def search(code: Callable[[float], CodedTree], start: float) -> Found[bytes]:
            def measure(price: float) -> tuple[float, bytes]:
                data = self.written(code(price))
                return math.log(len(data)), data

            return nearest(
                measure,
                goal_of_bytes(n_bytes),
                replace(self.guess, at=start) if self.guess else Start(start, slope),
                self._bounds,
                far=FAR_LOG_BYTES,
            )

        plain = search(prepared.coded, near or (FIRST_PRICE if self.views else 1.0))
        if plain.is_end and not 0.98 * n_bytes <= len(plain.what) <= n_bytes:
            raise self._bytes_missed(n_bytes, plain)
        found = [search(prepared.polished, plain.at), plain] if prepared.polishes else [plain]
        met = [one for one in found if 0.98 * n_bytes <= len(one.what) <= n_bytes]
        if not met:
            said = f"{n_bytes:,} bytes cannot be met: {len(plain.what):,} is nearest"
            raise TargetMissedError(said, abs(len(plain.what) - n_bytes))
        return met[0] if len(met) == 1 else max(met, key=lambda one: self.psnr(one.what))

    def expect_bytes(self, n_bytes: int) -> None:
        """Try the end of the range of prices that has the fewest bytes.

        Raises:
            TargetMissedError: it has more than `n_bytes`.
        """
        price = PRICES[1]
        data = self.written(self.prepared.coded(price))
        if len(data) > n_bytes:
            raise self._bytes_missed(n_bytes, Found(price, math.nan, data))

    def _bytes_missed(self, n_bytes: int, end: Found[bytes]) -> TargetMissedError:
        """That of a number of bytes beyond an end of the range."""
        other = self._bounds[end.at == self._bounds[0]]
        return bytes_missed(n_bytes, len(end.what), len(self.written(self.prepared.coded(other))))

    @cached_property
    def sketch(self) -> Sketch:
        """Of the tree, by views."""
        return Sketch.of(self.prepared)

    def nearer(self, guess: Guess, decibels: float, coded: CodedTree) -> Guess:
        """A better one, by the PSNR of what is coded at the price of a guess."""
        found, goal = self._psnr_of(coded), goal_of_psnr(decibels)
        if goal.is_met(found):
            return replace(guess, met=Found(guess.price, found, coded))
        return replace(guess, slope=psnr_slope(decibels)).measured(decibels, found)

    def nearer_bytes(self, guess: Guess, n_bytes: int, coded: CodedTree) -> Guess:
        """`nearer`, by the bytes of what is coded."""
        found, goal = math.log(len(self.written(coded))), goal_of_bytes(n_bytes)
        if goal.is_met(found):
            return replace(guess, met=Found(guess.price, found, coded))
        return guess.measured(goal.value, found)

    def guessing(self, guess: Guess) -> TargetEncoder:
        """The same that begins there; nothing is drawn again."""
        return replace(self, guess=guess)._having(self.prepared)

    def _having(self, prepared: Prepared) -> TargetEncoder:
        """This encoder, which has just been made, with a tree that is prepared already."""
        self.__dict__["prepared"] = prepared  # where `cached_property` looks first
        return self

    @property
    def _bounds(self) -> tuple[float, float]:
        """Of what is searched for."""
        return PRICES if self.views else STEP_FACTORS

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

    def holding(self, runs: Sequence[Run], layering: Layering) -> TargetEncoder:
        """The same with runs of steps joined or held back; nothing is drawn again.

        Args:
            runs: of the streams that this one makes.
            layering: in place of its own layers, if it has several.
        """
        other = replace(self, guess=self.guess and self.guess.unmeasured)
        return other._having(self.prepared.holding(runs, layering))

    def weighed_as(self, other: TargetEncoder) -> TargetEncoder:
        """The same with what views tell of another tree: little is drawn again.

        Args:
            other: its tree differs in the SH above band 0 alone, or in having a palette.
        """
        drawn, pictures = other.prepared.drawn, self.ordering or self.views
        if drawn is None or pictures is None:
            return self
        gains = drawn.gains and drawn.gains.with_bands_of(self.tree, pictures)
        return replace(self, drawn=Drawn(drawn.cuts, gains))

    def at_once(self) -> TargetEncoder:
        """The same with all leaves in the place of the roots at once, in one layer."""
        other = replace(self, guess=self.guess and self.guess.unmeasured)
        return other._having(self.prepared.at_once())

    def leaving_empty(
        self, packets: frozenset[PacketId], order: tuple[PacketId, ...] | None = None
    ) -> TargetEncoder:
        """The same with these packets of SH bands empty; nothing is drawn again.

        Args:
            packets: that are empty.
            order: of all packets, as of `EncodeTask`.
        """
        guess = self.guess and self.guess.unmeasured
        other = replace(self, empty=packets, order=order, guess=guess)
        return other._having(self.prepared.leaving_empty(other))

    def within(self, errors: Mapping[str, float]) -> bytes:
        """The stream no number of whose leaves is further off than its group allows.

        Args:
            errors: largest error per name of a group, in its own units; of some or all groups.

        Raises:
            InputError: float32, or the alphas of the tree, do not allow it.
            ValueError: an error is not above 0, or is of no group.
        """
        if not all(error > 0 for error in errors.values()):
            raise ValueError("largest errors are above 0")
        unknown = sorted(set(errors) - set(GROUPS))
        if unknown or not errors:
            what = ", ".join(unknown) or "nothing"
            raise ValueError(f"largest errors of {what}, expected some of {', '.join(GROUPS)}")
        asked = np.array([errors.get(name, math.inf) for name in GROUPS])
        own = np.array(self.leaf_error)
        if np.any(own > asked):
            raise errors_missed(asked, own, own)
        prepared = Prepared(replace(self, views=None, polish=0, layers=1))
        finest = replace(self.settings, accuracy=NearLossless())
        table = prepared.wanted_steps()
        groups = np.minimum(np.arange(table.shape[1]), 4)
        table = np.where(np.isinf(asked[groups]), table, 2 * asked[groups])
        for attempt in range(MAX_TRIES):
            is_last = attempt == MAX_TRIES - 1
            settings = finest if is_last else replace(self.settings, accuracy=StepTable.of(table))
            data = self._stream(prepared.quantised(settings))
            found = self._errors_of(prepared, data)
            if np.all(found <= asked):
                return data
            if attempt == TRIES_ON_ONE_SIDE - 1 or (not attempt and np.any(found > 2 * asked)):
                least = self._errors_of(prepared, write(prepared.quantised(finest), zstd_level=1))
                if np.any(least > 2 * asked):  # what is finest is a unit off; steps half of one
                    raise errors_missed(asked, least, own)
            finer = np.where(
                found > asked, np.minimum(0.9 * asked / np.maximum(found, 1e-300), 0.9), 1
            )
            table = table * np.maximum(finer, 0.02)[groups]
        raise errors_missed(asked, found, own)

    def _errors_of(self, prepared: Prepared, data: bytes) -> F64:
        """(5,) largest error of a stream per group, with those of the tree."""
        return largest_errors(prepared.tiles, data, self.tree.shown_degree) + self.leaf_error

    def psnr(self, data: bytes) -> float:
        """Of the leaves of a stream, dB.

        Raises:
            ValueError: there are no views.
        """
        return self._psnr(decode(data).leaves(sh_degree=self.tree.shown_degree))

    def _psnr_of(self, coded: CodedTree) -> float:
        """`psnr` of the stream of a coded tree, which is not written."""
        return self._psnr(leaves_of(coded, self.tree.shown_degree))

    def _psnr(self, leaves: SplatParams) -> float:
        if self.views is None:
            raise ValueError("a PSNR needs views")
        return self.views.psnr(leaves)

    def _with_psnr(self, found: Found[CodedTree]) -> Found[CodedTree]:
        """With the PSNR of all views, where it was that of a few."""
        return replace(found, value=self._psnr_of(found.what))

    def written(self, coded: CodedTree) -> bytes:
        """The stream of a coded tree that `prepared` made, with digests."""
        known = self.prepared.written
        if known is not None and known[1] is coded:
            return known[0]
        data = self._stream(coded)
        self.prepared.written = data, coded
        return data

    def _stream(self, coded: CodedTree) -> bytes:
        zstd_level = self.settings.zstd_level
        return write(coded, zstd_level=zstd_level, order=self.order, progress=self.progress)
