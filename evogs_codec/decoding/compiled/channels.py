"""The hot loops of decoding, compiled: the integers of `arithmetic` and `planes`, no temporaries.

Optional: without numba the codec uses numpy. A test holds the two to identical integers and faults.
`records` reads what the packets say of slots. Then channels do not know each other: all packets
are applied to one (or to the three of an SH coefficient) before the next, so that its slots stay in
cache; of a packet `CHUNK` records at a time, so that what lies between planes and slots stays in
the nearest one: psi in `changes`, adds and picks here, single values in `values`. Like `headers`
they know no faults: where a rule is broken they give up, and the numpy code finds out which.

Letters: A adds of one step; C channels that are turned together, 1 or 3.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.decoding.compiled.changes import apply_psi
from evogs_codec.decoding.compiled.headers import (
    EMPTY,
    MAX_LISTS,
    N_CORE,
    N_SIDES,
    Headers,
    bits_are_plain,
    read_headers,
)
from evogs_codec.decoding.compiled.plans import CHUNK, FIRST_SH, SH_GROUP, Channels, Plans, Tables
from evogs_codec.decoding.compiled.records import read_records, sibling_runs
from evogs_codec.decoding.compiled.values import (
    MAX_INT,
    entries,
    float_picks,
    float_rows,
    inverse_ycocg,
    picks,
    scale,
    unpack,
    unpack_signed,
    unzigzag,
)
from evogs_codec.format.packet_header import FLAG_OF_CHANGED
from evogs_codec.format.planes import MAX_SUM
from evogs_codec.model.arithmetic import MAX_X
from evogs_codec.model.components import PICKS
from evogs_codec.model.splats import I32

__all__ = [
    "MAX_LISTS",
    "Headers",
    "Plans",
    "Tables",
    "apply_packets",
    "entries",
    "float_picks",
    "float_rows",
    "inverse_ycocg",
    "read_headers",
    "sibling_runs",
    "unpack",
    "unzigzag",
]

_jit = jit()


@_jit
def apply_packets(
    headers: Headers,
    tables: Tables,
    plans: Plans,
    x: I32,
    live: npt.NDArray[np.bool_],
    born_from: I32,
    shown: I32,
) -> bool:
    """Apply packets of a tile to its slots (spec 7.4); False if one is not plainly legal.

    Args:
        headers: the packets.
        tables: tables of the stream and tile.
        plans: of core steps applied before, and room for those of these packets.
        x: (D, n) slots.
        live: (n,) whether a slot is.
        born_from: (n,) slot each slot was split from, -1 for adds.
        shown: (n,) picks of the slots, where there is a palette.
    """
    places = np.empty(len(live), np.int32)  # pages that no step of refines looks at are never made
    for k in range(len(headers.components)):
        if not bits_are_plain(headers, k):
            return False
        if headers.components[k] == 0 and not read_records(
            headers, k, tables, plans, live, born_from, places
        ):
            return False
    scratch, first = np.empty((6, CHUNK), np.int32), 0
    while first < len(x):
        count = 1 if first < FIRST_SH else 3
        if not _apply_channels(headers, tables, plans, first, x[first : first + count], scratch):
            return False
        first += count
    for k in range(len(headers.components)):
        if headers.components[k] == PICKS and not _apply_picks(headers, k, plans, born_from, shown):
            return False
    return True


@_jit
def _apply_channels(
    headers: Headers, tables: Tables, plans: Plans, first: int, rows: I32, scratch: I32
) -> bool:
    """All packets on the channels from `first` on, whose slots are `rows` (C, n)."""
    kind = _class_of(first)
    component = max(kind - SH_GROUP, 0)
    at = first - (11 + 3 * component * component if component else 0)  # in the component
    n_channels = 3 * (2 * component + 1) if component else N_CORE
    at_psi = at + (0 if component else N_SIDES)
    low, high = -np.int64(MAX_X), np.int64(MAX_X)
    if kind == 0:
        low, high = tables.box[first]
    channels = Channels(rows, kind, low, high, plans.bounds[first : first + len(rows)])
    for k in range(len(headers.components)):
        if headers.components[k] != component:
            continue
        n_adds, n_splits, n_refines, n_drops = headers.counts[k]
        if n_splits + n_refines and not apply_psi(
            headers, k, at_psi, tables, plans, channels, scratch
        ):
            return False
        if n_adds and not _apply_adds(
            headers, k, at_psi + n_channels, tables, plans, channels, scratch
        ):
            return False
        begin = plans.places[headers.steps[k], 3]
        for slot in plans.drops[begin : begin + n_drops]:
            rows[:, slot] = 0
    return True


@_jit
def _class_of(channel: int) -> int:
    """Spec 3.2."""
    if channel < FIRST_SH:
        return 0 if channel < 3 else 1 if channel < 7 else 2 if channel < 10 else 3
    return 4 if channel < 14 else 5 if channel < 23 else 6 if channel < 38 else 7


@_jit
def _apply_adds(
    headers: Headers,
    k: int,
    at: int,
    tables: Tables,
    plans: Plans,
    channels: Channels,
    scratch: I32,
) -> bool:
    """Adds of a packet; `at` is the first list of the channels."""
    n_adds, n_splits, _, _ = headers.counts[k]
    rows, kind, low, high, bounds = channels
    first, unit = plans.places[headers.steps[k], 0] + n_splits, tables.units[0, kind]
    q, sums = scratch[:3], np.zeros(3, np.int64)
    for begin in range(0, n_adds, CHUNK):
        n = min(CHUNK, n_adds - begin)
        for j in range(len(rows)):
            code, start = headers.codes[k, at + j], headers.starts[k, at + j]
            unpack_signed(code, headers.planes, start, n_adds, begin, n, q[j])
            if code & 64:
                for i in range(n):
                    sums[j] += q[j, i]
                    if sums[j] > MAX_SUM or sums[j] < -MAX_SUM:  # R-7.1-1
                        return False
                    q[j, i] = sums[j]
        if len(rows) == 3 and headers.flags[k] & 2:
            inverse_ycocg(q, n)
        for j in range(len(rows)):
            if scale(q[j], n, unit) < 0:
                return False
            least, most = np.int32(MAX_INT), np.int32(-MAX_INT)
            row = rows[j, first + begin : first + begin + n]
            for i in range(n):
                row[i] = q[j, i]
                least, most = min(least, q[j, i]), max(most, q[j, i])
            if least < low or most > high:
                return False
            bounds[j] = max(bounds[j], max(np.int64(most), -np.int64(least)))
    return True


@_jit
def _apply_picks(headers: Headers, k: int, plans: Plans, born_from: I32, shown: I32) -> bool:
    """The picks of a packet (spec 7.4); False if one is past the entries that it may name."""
    step = headers.steps[k]
    first, run, drop = plans.places[step, 0], plans.places[step, 1], plans.places[step, 3]
    end, end_of_runs, end_of_drops = (
        plans.places[step + 1, 0], plans.places[step + 1, 1], plans.places[step + 1, 3],
    )  # fmt: skip
    n_psi = headers.counts[k, 1] + headers.counts[k, 2] if headers.flags[k] & FLAG_OF_CHANGED else 0
    code, start = headers.codes[k, 0], headers.starts[k, 0]
    if headers.flags[k] == EMPTY:
        for slot in range(first, end):
            shown[slot] = shown[born_from[slot]] if born_from[slot] >= 0 else np.int32(0)
    elif not picks(
        code, headers.planes, start, plans.runs[:, run:end_of_runs], n_psi, first,
        headers.n_entries[k], shown, n_psi + end - first,
    ):  # fmt: skip
        return False
    for slot in plans.drops[drop:end_of_drops]:
        shown[slot] = 0
    return True
