"""No step back from packet to packet: all are looked at, and other streams made where one falls.

What an error is worth is estimated number by number. Errors of one packet may make up for those of
another, so that pictures are worse without these. Packets of SH bands with which the whole is worse
are left empty, and where a prefix falls all the same, those of it that have few bytes. If that is
not enough, packets from there on are put in another order, or those that fall are left empty. At
last other streams are tried: at other prices of a bit, with one layer, with all levels that split
held back until the last of them, and with all leaves at once in the place of the roots: where
splats have the same depth, even steps that show nothing new change the order in which they are
drawn.

Of many splats, a few prefixes are looked at first, and all only if one of these falls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.layers import Layering
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.write_directory import MAX_LEVELS
from evogs_codec.model.components import CORE
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I64
from evogs_codec.scene.falls.judges import PACKET_FALL_DB
from evogs_codec.scene.falls.order_by_views import MAX_AROUND, ordered_by_views
from evogs_codec.scene.falls.packet_looks import (
    MAX_ORDERED,
    Looks,
    may_be_ordered,
    rows_of,
    shown,
)
from evogs_codec.scene.falls.states import FALL_DB, N_JUDGING_FIRST
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.measure import ALL_LOOK_UP_TO, MANY_ABOVE, Gauge
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["without_falls"]

MAX_TRIES, MAX_TRIES_OF_MANY = 6, 3
# Times the bytes that a stream with empty packets may take; to meet a target it may need more.
MAX_TIMES_BYTES = 1.05
DB_PER_LOG_BYTES = 14.0  # dB of a stream to the logarithm of its bytes, from 30 to 65 dB at least
# Times the price of a bit, of other streams; more of them of very few splats.
FINER_PRICES, OTHER_PRICES = (0.93, 0.86), (0.8, 0.74, 1.08, 0.69, 0.64)
ALL_ABOVE_ROOTS = Run((1, 0), (MAX_LEVELS, 0))

# Of more than `ALL_LOOK_UP_TO` splats, the prefixes that are looked at first: at least and at most
# so many, by every so-many-th view, of which one is large. Less than `NO_FALL_DB` is no fall.
N_FIRST_PREFIXES, FIRST_VIEWS_EVERY, NO_FALL_DB = (6, 12), 7, 0.01
# A fall above this is worth a stream that takes more bytes or looks worse, with a target and of
# more than `MANY_ABOVE` splats. Of these its whole may look worse by as much.
DEAR_FALL_DB = 3 * FALL_DB
# That the whole of another stream looks worse for its bytes, at most: with a target, and without
# one of more than `ALL_LOOK_UP_TO` splats. 10 dB are twice the bytes.
MAX_COST_DB, MAX_COST_OF_PLAIN_DB = 3.0, 10.0
# Splats of all states together that are drawn in search of an order, of up to `MANY_ABOVE`.
MAX_SPLATS_DRAWN = 1_000_000
MAX_ORDERS = 2  # that are looked for
ALL_JUDGE_PACKETS_UP_TO = 100_000  # splats; of more a few views judge, since one changes little


def without_falls(found: FoundStream, gauge: Gauge, request: Request) -> FoundStream:
    """A stream that is made, or one instead of it that falls less in the views of packets.

    Of more than `ALL_LOOK_UP_TO` splats, only if some prefix falls in two of the views that look
    for falls, and with a target in all views of packets, too.

    A packet that makes pictures worse stays where the whole would look worse for its bytes without
    it, or miss its target. Other prices are not tried with a target, nor one layer where layers
    were asked for, and nothing else where a stream is polished. With a target up to `MANY_ABOVE`
    splats may fall by `FALL_DB`, and another stream is tried only against a fall above
    `DEAR_FALL_DB`. It is not taken if it costs more than `_max_cost`.
    """
    if not found.is_by_views or found.tree.palette is not None:
        return found
    views, is_many = gauge.packets, found.tree.n_leaves > MANY_ABOVE
    all_look = found.tree.n_leaves <= ALL_LOOK_UP_TO
    if not all_look:
        if found.tree.n_leaves > ALL_JUDGE_PACKETS_UP_TO:
            views = views.fewer(N_JUDGING_FIRST)
        if not _may_fall(found, gauge.many, None if request.is_plain else views):
            return found
    least = PACKET_FALL_DB if request.is_plain or is_many else FALL_DB
    max_cost = _max_cost(request, all_look=all_look)
    first, fall = _with_least_fall(found, views, least)
    best, others = first, _others(found, request) if fall > least else []
    for k, of_other in enumerate(others):
        other = of_other()
        if fall <= _may_stay(k, other, request, is_many=is_many):
            break
        request.progress("try", k / len(others))
        try:
            other = other.made()
        except TargetMissedError:
            continue
        if max_cost < math.inf and _cost(other, first, views) > max_cost:
            if request.is_plain:
                continue
            break  # those after it cost more
        one, of_one = _with_least_fall(other, views, least)
        if of_one < fall and not (is_many and _looks_worse(one, best, views)):
            best, fall = one, of_one
    return best


def _max_cost(request: Request, *, all_look: bool) -> float:
    """By how many dB another stream may look worse for its bytes."""
    if not request.is_plain:
        return MAX_COST_DB
    return math.inf if all_look else MAX_COST_OF_PLAIN_DB


def _may_stay(k: int, other: FoundStream, request: Request, *, is_many: bool) -> float:
    """The deepest fall, dB, with which the k-th of the other streams is not made."""
    if not request.is_plain:
        return DEAR_FALL_DB
    if is_many:
        return FALL_DB if k < len(FINER_PRICES) else DEAR_FALL_DB
    return PACKET_FALL_DB if other.is_layered else FALL_DB


def _others(found: FoundStream, request: Request) -> list[Callable[[], FoundStream]]:
    """What gives streams that may be made instead, yet to be made."""
    if request.polish:
        return []
    factors = (*FINER_PRICES, *(OTHER_PRICES if found.tree.n_leaves <= MAX_ORDERED else ()))
    others: list[Callable[[], FoundStream]] = []
    if request.is_plain:
        others += [partial(found.at, factor) for factor in factors]
    if found.is_layered and request.layers is None:
        others.append(partial(found.holding, (), Layering(1)))
    if found.tree.n_levels == 1:  # no level is above the roots
        return others
    layering = found.layering if request.layers else Layering(1)
    others.append(partial(found.holding, (ALL_ABOVE_ROOTS,), layering))
    if layering.n == 1:
        others.append(found.at_once)
    return others


def _may_fall(found: FoundStream, views: Views, sure: Views | None = None) -> bool:
    """Whether some prefix of a stream that is made looks worse than another one, in two views.

    Those are looked at that end where packets of SH bands begin or end, and some between.

    Args:
        found: the stream.
        views: of which two judge.
        sure: that judge again where one falls; None: nothing does.
    """
    directory = read_directory(found.data)
    rows = rows_of(directory)
    is_core = directory.columns[rows] == CORE
    ends = np.flatnonzero(np.append(is_core[1:] != is_core[:-1], len(rows) > 0))
    if len(ends) < N_FIRST_PREFIXES[0]:
        ends = np.union1d(ends, _evenly(N_FIRST_PREFIXES[0], len(rows)))
    elif len(ends) > N_FIRST_PREFIXES[1]:
        ends = ends[_evenly(N_FIRST_PREFIXES[1], len(ends))]
    two = replace(views, cameras=views.cameras[::FIRST_VIEWS_EVERY], drawn=views.drawn)
    for pair in _falls(found, directory, rows[ends], two):
        if sure is None or any(True for _ in _falls(found, directory, pair, sure)):
            return True
    return False


def _falls(found: FoundStream, directory: Directory, rows: I64, views: Views) -> Iterator[I64]:
    """Of the prefixes that end with these packets, each that looks worse than one before.

    Two packets: that of the better prefix, then its own.
    """
    best, of_best = -math.inf, 0
    for k, leaves in enumerate(shown(found, directory, rows)):
        decibels = views.psnr(leaves)
        if decibels < best - NO_FALL_DB:
            yield rows[[of_best, k]]
        if decibels > best:
            best, of_best = decibels, k


def _looks_worse(one: FoundStream, other: FoundStream, views: Views) -> bool:
    """Whether the whole of a stream that is made looks worse than that of another one."""
    return _psnr_of(one, views) < _psnr_of(other, views) - DEAR_FALL_DB


def _cost(one: FoundStream, other: FoundStream, views: Views) -> float:
    """By how many dB the whole of a stream that is made looks worse than another for its bytes."""
    of_bytes = DB_PER_LOG_BYTES * math.log(len(one.data) / len(other.data))
    return of_bytes + _psnr_of(other, views) - _psnr_of(one, views)


def _psnr_of(found: FoundStream, views: Views) -> float:
    """Of the whole of a stream that is made, dB."""
    directory = read_directory(found.data)
    return views.psnr(next(shown(found, directory, rows_of(directory)[-1:])))


def _evenly(n: int, of: int) -> I64:
    """At most n of the numbers below `of`, with the first and the last."""
    return np.unique(np.linspace(0, of - 1, min(n, of)).astype(np.int64))


def _with_least_fall(
    found: FoundStream, views: Views, least: float = PACKET_FALL_DB
) -> tuple[FoundStream, float]:
    """Without its worst packets, and of few packets or splats with the last in another order.

    `least`: dB; a fall of no more may stay.
    """
    found, looks = _without_worst(found, views, least)
    if looks.fall > least and may_be_ordered(found):
        data, fall = ordered_by_views(
            found.data,
            found.prefixes,
            views,
            found.tree.shown_degree,
            looks.before,
            most=looks.fall,
        )
        if fall < looks.fall:
            return replace(found, stream=data), fall
    return found, looks.fall


def _without_worst(
    found: FoundStream, views: Views, least: float = PACKET_FALL_DB
) -> tuple[FoundStream, Looks]:
    """With packets in another order, or without those that look worse, and how the others look.

    Those without which the whole looks better go first; after them, of up to `MANY_ABOVE` splats,
    those of few bytes. Then another order is looked for. What falls in that, too, is left empty, as
    many packets at once as may be.
    """
    looks, n_bytes = Looks.of(found, views), len(found.data)
    assert looks is not None, "there is no bound"
    empty: frozenset[PacketId] = frozenset()
    refused: list[frozenset[PacketId]] = []
    without_order: Looks | None = None  # of which no better order was found
    n_orders, is_many = 0, found.tree.n_leaves > MANY_ABOVE
    for _ in range(MAX_TRIES_OF_MANY if is_many else MAX_TRIES):
        if looks.fall <= least:
            break
        small = () if is_many else (looks.small_worse, looks.small_until_good)
        some = _untried((looks.needless, *small), empty, refused)
        if some is None and n_orders < MAX_ORDERS:
            n_orders += 1
            ordered = None if looks is without_order else _in_order(found, looks, views)
            without_order = looks
            if ordered is not None:
                found, looks = ordered
                continue
        some = some or _untried((looks.worse, looks.worst), empty, refused)
        if some is None:
            break
        try:
            again = found.leaving_empty(some).made()
        except TargetMissedError:
            refused.append(some)
            continue
        is_larger = len(again.data) > MAX_TIMES_BYTES * n_bytes
        then = None
        saved = max(math.log(len(found.data) / len(again.data)), 0.0)
        if (
            not is_larger
            and _psnr_of(again, views) >= looks.whole - FALL_DB - DB_PER_LOG_BYTES * saved
        ):
            then = Looks.of(again, views, looks.fall)
        if then is None:
            refused.append(some)
        else:
            found, looks, empty = again, then, some
    return found, looks


def _untried(
    chosen: Iterable[frozenset[PacketId]],
    empty: frozenset[PacketId],
    refused: Collection[frozenset[PacketId]],
) -> frozenset[PacketId] | None:
    """The first of some sets of packets that was not refused, with those that are empty."""
    with_empty = (empty | some for some in chosen)
    return next((some for some in with_empty if some != empty and some not in refused), None)


def _in_order(found: FoundStream, looks: Looks, views: Views) -> tuple[FoundStream, Looks] | None:
    """With packets in an order that falls less, and how they look; None without any.

    Of up to `MANY_ABOVE` splats all packets from the first fall on, of which many states were drawn
    before; of more, those from each fall until it is made good.
    """
    falls, max_states, most = looks.recovered, MAX_AROUND, PACKET_FALL_DB
    if found.tree.n_leaves <= MANY_ABOVE:
        assert looks.first is not None, "something falls"
        falls, most = [looks.first], FALL_DB
        max_states = max(max_states, MAX_SPLATS_DRAWN // max(found.tree.n_leaves, 1))
    then = found
    for fall in falls:
        data, deepest = ordered_by_views(
            then.data,
            then.prefixes,
            views,
            found.tree.shown_degree,
            fall.before,
            fall.rows,
            max_states,
            most,
        )
        if deepest <= most:
            then = replace(found, stream=data)
    of_then = None if then is found else Looks.of(then, views, looks.fall)
    return None if of_then is None else (then, of_then)
