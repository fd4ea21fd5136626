"""What a stream leaves out, and what that changes as far as the stream says so (`evogs info`).

Packets that were cut off leave the error hints of those before them (spec 5.6). What an encoder
rounded to zero, or did not have, leaves no trace: nothing is guessed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from evogs_codec.decoding.replay import packet_body
from evogs_codec.format.directory import UNKNOWN_ERROR, Directory
from evogs_codec.format.packet_header import Counts, read_packet_header
from evogs_codec.format.unpack import unpack
from evogs_codec.model.arithmetic import SYMMETRIC
from evogs_codec.model.channels import CLASS_NAMES, GROUPS, N_GROUPS, channel_class
from evogs_codec.model.components import CORE, PALETTE, PICKS, component_channels, component_slice
from evogs_codec.model.splats import I64

__all__ = ["Omission", "omissions"]

CUT_OFF, NOTHING, UNUSED = "cut off", "no refinement is stored", "entries are not used"
ALL_ONE = "all are 1"


@dataclass(frozen=True)
class Omission:
    """Something that a stream could hold and does not.

    Attributes:
        part: what it is of.
        reason: how it comes that it is not there.
        levels: where.
        change: root mean square of what it would change, in the units of the part; None: unknown.
    """

    part: str
    reason: str
    levels: tuple[int, ...]
    change: float | None


def omissions(directory: Directory, data: memoryview) -> list[Omission]:
    """What a whole stream leaves out.

    Raises:
        StreamError: a packet is not legal.
    """
    return [
        *_cut_off(directory),
        *_not_stored(directory, data),
        *_all_one(directory),
        *_unused(directory, data),
    ]


def _cut_off(directory: Directory) -> Iterator[Omission]:
    """Steps after the last of the core, and steps that SH bands do not have."""
    rows, chains = directory.packets, directory.chain_lengths
    core = rows["component"] == 0
    for column, component in enumerate(directory.components.of_tiles):
        missing = core & (directory.steps >= chains[rows["tile"], column])
        change = _change(directory, component, chains[:, column])
        if component == CORE and change:
            last = int(rows["level"][core].max())
            yield Omission("position", CUT_OFF, tuple(range(last, directory.n_levels)), change)
        if missing.any():
            levels = tuple(np.unique(rows["level"][missing]).tolist())
            part = "picks" if component == PICKS else CLASS_NAMES[4 + component]
            yield Omission(part, CUT_OFF, levels, change)


def _change(directory: Directory, component: int, chains: I64) -> float | None:
    """Root mean square over tiles of the error hints of the last packets of a component."""
    rows = directory.packets
    last = (rows["component"] == component) & (directory.steps == chains[rows["tile"]] - 1)
    hints = rows["error"][last].astype(np.float64)
    if (chains == 0).any() or (hints == UNKNOWN_ERROR).any():
        return None
    grid = 2.0 ** -directory.grid_exponents[0 if component == 0 else N_GROUPS - 1]
    return float(np.sqrt(np.square(hints).mean())) * grid if len(hints) else 0.0


def _not_stored(directory: Directory, data: memoryview) -> Iterator[Omission]:
    """Classes of which no refinement of a level is other than 0."""
    refined: dict[tuple[str, int], bool] = defaultdict(bool)
    for packet, component, level, counts in _packets(directory):
        first = component_slice(component).start
        names = [
            CLASS_NAMES[channel_class(first + k)] for k in range(component_channels(component))
        ]
        body = packet_body(directory, data, packet)
        stored = [False] * len(names)
        if len(body):
            offset = int(directory.offsets[packet])
            head = read_packet_header(body, component, counts, offset)
            stored = [coding.n_planes > 0 for coding in head.codings[head.first :]]
        for name, is_stored in zip(names, stored, strict=False):
            if counts.n_psi:
                refined[name, level] |= is_stored
    for name in CLASS_NAMES:
        levels = tuple(sorted(k for (one, k), some in refined.items() if one == name and not some))
        if levels:
            yield Omission(name, NOTHING, levels, 0.0)


def _all_one(directory: Directory) -> Iterator[Omission]:
    """Alphas that are 1 at every split of a level, without an index or an entry."""
    rows = directory.packets
    split = np.unique(rows["level"][(rows["component"] == CORE) & (rows["n_splits"] > 0)])
    for group, name in enumerate(GROUPS):
        tables = {k: directory.alpha.get((k, group), SYMMETRIC).values for k in split.tolist()}
        levels = tuple(k for k, values in tables.items() if (values == 1).all())
        if levels:
            yield Omission(f"alpha of {name}", ALL_ONE, levels, 0.0)


def _unused(directory: Directory, data: memoryview) -> Iterator[Omission]:
    """Entries of alpha tables that no split names."""
    used: dict[tuple[int, int], set[int]] = defaultdict(set)
    for packet, component, level, counts in _packets(directory):
        if component or not counts.n_splits:
            continue
        offset = int(directory.offsets[packet])
        found = unpack(packet_body(directory, data, packet), 0, counts, offset)
        for group, indices in enumerate(found.alpha):
            used[level, group] |= {0} if indices is None else set(np.unique(indices).tolist())
    for group, name in enumerate(GROUPS):
        sizes = {k: len(t.entries) for (k, g), t in directory.alpha.items() if g == group}
        levels = tuple(k for k, size in sorted(sizes.items()) if len(used[k, group]) < size)
        n = sum(sizes[k] - len(used[k, group]) for k in levels)
        if levels:
            yield Omission(
                f"alpha of {name}", f"{n} of {sum(sizes.values())} {UNUSED}", levels, 0.0
            )


def _packets(directory: Directory) -> Iterator[tuple[int, int, int, Counts]]:
    """Number, component, level and record counts of each packet with records."""
    rows = directory.packets
    core: dict[tuple[int, int], tuple[int, Counts]] = {}
    for packet, row in enumerate(rows):
        key = int(row["tile"]), int(directory.steps[packet])
        if int(row["component"]) == 0:
            core[key] = int(row["level"]), directory.counts(packet)
        elif int(row["component"]) in (PICKS, PALETTE):  # nothing of them is refined
            continue
        yield packet, int(row["component"]), *core[key]
