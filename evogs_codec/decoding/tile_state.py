"""The state of a tile: slots in integers, changed in place by packets (spec 7).

Letters: D channels, n slots, S splits of a step.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from evogs_codec.common.buffers import Scratch
from evogs_codec.decoding.palette_state import PaletteState, unpack_picks
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import layout
from evogs_codec.format.directory import Directory
from evogs_codec.format.packet_header import Counts
from evogs_codec.format.unpack import Deltas, Packet, Values, check_kinds, unpack
from evogs_codec.model.arithmetic import MAX_X, AlphaTable, RangeError, StepPlan, apply_channel
from evogs_codec.model.channels import SH_GROUP
from evogs_codec.model.components import CORE, PICKS, component_classes, component_slice
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import I32

__all__ = ["TileState"]

Scalar = TypeVar("Scalar", bound=np.generic)

N_AXES = 3  # channels of the position


class TileState:
    """Slots of one tile after some of its packets.

    Attributes:
        x: (D, capacity) int32 on the grids of the groups; with a palette only the 14 of core.
        live: (capacity,) bool.
        born_from: (capacity,) int32 slot each slot was split from, -1 for adds.
        n_applied: steps applied per component.
        palette: of the stream, if it has one; others fill it before what picks show is asked.
        picks: (capacity,) int32 of each slot, where there is a palette.
    """

    def __init__(
        self,
        directory: Directory,
        tile: int,
        capacity: int,
        palette: PaletteState | None = None,
        scratch: Scratch | None = None,
    ) -> None:
        """An empty state with room for `capacity` slots, in memory of its own or in `scratch`."""
        self.directory = directory
        self.tile = tile
        self.palette = palette
        take = scratch.take if scratch else np.empty
        self.x = take((directory.components.n_stored, capacity), np.int32)
        self.live = take((capacity,), np.bool_)
        self.live[:] = False
        self.born_from = take((capacity,), np.int32)
        self.born_from[:] = -1
        self.picks = take((0 if palette is None else capacity,), np.int32)
        self.n_applied = dict.fromkeys(directory.components.of_tiles, 0)
        self._n_after: list[int] = []  # slots after each core step
        self._plans: list[StepPlan] = []
        self._levels: list[int] = []
        self._counts: list[Counts] = []
        self._sh_alpha: list[npt.NDArray[np.integer] | None] = []
        self._digests: dict[int, bytes] = {}  # of components that did not change since

    @property
    def n_slots(self) -> int:
        """Slots made so far, empty ones included."""
        return self._n_after[-1] if self._n_after else 0

    def band_slots(self, component: int) -> int:
        """Slots of a component: as many as core had after the component's last step."""
        n = self.n_applied[component]
        return self._n_after[n - 1] if n else 0

    def set_applied(self, n_applied: dict[int, int], n_after: list[int]) -> None:
        """Say that the slots were changed by others, and will not be by `apply` any more.

        Args:
            n_applied: steps of each component.
            n_after: slots after each core step.
        """
        self.n_applied, self._n_after = n_applied, n_after

    def apply(self, packet: int, body: memoryview) -> None:
        """Apply the next packet of a chain, whose CRC-32 is right.

        Raises:
            StreamError: the packet breaks a rule; the state is as before (spec 6.4).
        """
        row = self.directory.packets[packet]
        offset = int(self.directory.offsets[packet])
        component = int(row["component"])
        try:
            if component == CORE:
                counts = self.directory.counts(packet)
                self._apply_core(unpack(body, 0, counts, offset), counts, int(row["level"]), offset)
            elif component == PICKS:
                n_entries = int(self.directory.entries_required[packet])
                self._apply_picks(body, n_entries, offset)
            else:
                self._apply_band(component, body, offset)
        except RangeError as error:
            raise StreamError(Fault.E_RANGE, str(error), offset) from None
        self.n_applied[component] += 1
        plan = self._plans[self.n_applied[component] - 1]
        if len(body) or plan.n_after > plan.n_before or len(plan.drops):
            self._digests.pop(component, None)

    def _apply_core(self, packet: Packet, counts: Counts, level: int, offset: int) -> None:
        n_before, slots = self.n_slots, packet.slots
        if len(slots) and (int(slots[-1]) >= n_before or not self.live[slots].all()):  # R-7.2-1
            raise StreamError(Fault.E_SLOT, "a record names a slot that is not live", offset)
        check_kinds(packet.kinds, counts, offset)
        plan = StepPlan.of(slots, packet.kinds, n_before, packet.adds.n)
        self.reserve(plan.n_after)
        tables = self.directory.alpha_tables[level]
        for table, indices in zip(tables, packet.alpha, strict=True):
            if indices is not None and int(indices.max()) >= len(table.entries):  # R-7.2-3
                raise StreamError(Fault.E_INDEX, "an alpha index is past its table", offset)
        self._apply_channels(CORE, plan, level, packet.psi, packet.adds, packet.alpha)
        new = slice(n_before, plan.n_after)
        self.live[new] = True
        if plan.n_splits:
            self.born_from[n_before : n_before + plan.n_splits] = plan.split_slots
        self.live[plan.drops] = False
        self._plans.append(plan)
        self._n_after.append(plan.n_after)
        self._levels.append(level)
        self._counts.append(counts)
        self._sh_alpha.append(packet.alpha[SH_GROUP])

    def reserve(self, n: int) -> None:
        """Make room for n slots, with more to spare: growing costs a copy."""
        if n > len(self.live):
            capacity = min(2 * n, int(self.directory.tile_slots[self.tile]))
            n_before, self.x = len(self.live), _grown(self.x, capacity)
            self.live, self.born_from = (
                _grown(self.live, capacity),
                _grown(self.born_from, capacity),
            )
            self.live[n_before:], self.born_from[n_before:] = False, -1
            if self.palette is not None:
                self.picks = _grown(self.picks, capacity)

    def _apply_band(self, component: int, body: memoryview, offset: int) -> None:
        step = self.n_applied[component]
        plan, level = self._plans[step], self._levels[step]
        packet = unpack(body, component, self._counts[step], offset)
        alpha = (None,) * SH_GROUP + (self._sh_alpha[step],)
        self._apply_channels(component, plan, level, packet.psi, packet.adds, alpha)

    def _apply_picks(self, body: memoryview, n_entries: int, offset: int) -> None:
        plan = self._plans[self.n_applied[PICKS]]
        counts = self._counts[self.n_applied[PICKS]]
        changed, new = unpack_picks(body, counts, n_entries, offset)
        if new is None:  # C2s take the picks of their parents, adds none
            parents = self.born_from[plan.n_before : plan.n_after]
            new = np.where(parents >= 0, self.picks[parents], np.int32(0))
        if changed is not None:
            self.picks[plan.targets] = changed
        self.picks[plan.n_before : plan.n_after] = new
        self.picks[plan.drops] = 0

    def _apply_channels(
        self,
        component: int,
        plan: StepPlan,
        level: int,
        psi: Values,
        adds: Values,
        alpha: tuple[npt.NDArray[np.integer] | None, ...],
    ) -> None:
        """Spec 7.4 for the channels of a component; on an error slots are as before."""
        part, classes = component_slice(component), component_classes(component)
        tables = self.directory.alpha_tables[level]
        of_psi, of_adds = self.directory.quantisers[1 + level], self.directory.quantisers[0]
        alphas = [_alpha_of(table, indices) for table, indices in zip(tables, alpha, strict=True)]
        rows = self.x[part]
        siblings = Siblings.of(plan.target_slots, self.born_from) if psi.of_siblings.any() else None
        psi_deltas, add_deltas = Deltas(psi, siblings), Deltas(adds)
        n_written = 0
        try:
            for channel, (x, (kind, group)) in enumerate(zip(rows, classes, strict=True)):
                a, shift = alphas[group]
                delta = psi_deltas.delta(channel, of_psi[kind])
                new = add_deltas.delta(channel, of_adds[kind])
                low, high = self._range(part.start + channel)
                apply_channel(x, plan, delta, a, shift, new, low=low, high=high)
                n_written += 1
        except (RangeError, StreamError):
            undo = Deltas(psi, siblings)
            for channel, (kind, _) in enumerate(classes[:n_written]):
                delta = undo.delta(channel, of_psi[kind])
                if delta is not None:
                    rows[channel, plan.targets] -= delta
            raise
        rows[:, plan.drops] = 0

    def _range(self, channel: int) -> tuple[int, int]:
        """The least and the largest number of a channel (R-7.3-3, R-7.3-4)."""
        if channel >= N_AXES:
            return -MAX_X, MAX_X
        row = self.directory.tiles[self.tile]
        return int(row["box_min"][channel]), int(row["box_max"][channel])

    def shown(self, component: int) -> I32 | None:
        """Slots whose SH the slots show (spec 7.5); -1 for none; None if each shows its own."""
        n, n_band = self.n_slots, self.band_slots(component)
        if n == n_band:
            return None
        if n_band == 0:
            return np.full(n, -1, np.int32)
        slots = np.arange(n, dtype=np.int32)
        # A slot is split from one that was there before the step, so one pass in order is enough.
        for step in range(self.n_applied[component], self.n_applied[0]):
            new = slice(self._n_after[step - 1] if step else 0, self._n_after[step])
            parents = self.born_from[new]
            slots[new] = np.where(parents >= 0, slots[parents], np.int32(-1))
        return slots

    def shown_picks(self) -> I32:
        """(n,) the picks that the slots show, whether live or not."""
        slots = self.shown(PICKS)
        if slots is None:
            return self.picks[: self.n_slots]
        picks: I32 = np.where(slots >= 0, self.picks[slots], np.int32(0))
        return picks

    def channels(self) -> I32:
        """(D, n) integers as shown, 0 in empty slots."""
        rows = list(self.shown_rows())
        return np.stack(rows) if rows else np.empty((0, self.n_slots), np.int32)

    def shown_rows(self) -> Iterator[I32]:
        """The D rows of `channels`, one at a time; a view of the state where that is the same."""
        n = self.n_slots
        live = self.live[:n]
        all_live = bool(live.all())
        for component in self.directory.components.of_tiles:
            for row in self._rows_of(component):
                yield row if all_live else np.where(live, row, np.int32(0))

    def _rows_of(self, component: int) -> Iterator[I32]:
        """The rows of a component as shown, whether slots are live or not."""
        if component == PICKS:
            assert self.palette is not None
            picks = self.shown_picks()
            yield from (row[picks] for row in self.palette.x)
            return
        slots = self.shown(component) if component else None
        for row in self.x[component_slice(component)]:
            if slots is None:
                yield row[: self.n_slots]
            else:
                yield np.where(slots >= 0, row[slots], np.int32(0))

    def digest(self, component: int) -> bytes:
        """SHA-256 of the state of a component (spec 7.7)."""
        if component not in self._digests:
            self._digests[component] = self._digest(component)
        return self._digests[component]

    def _digest(self, component: int) -> bytes:
        n = self.band_slots(component)
        digest = hashlib.sha256(n.to_bytes(4, "little"))
        if component == 0:
            digest.update(self.live[:n].astype(np.uint8).data)
            digest.update(self.born_from[:n].astype("<i4", copy=False).data)
        if component == PICKS:
            assert self.palette is not None
            picks = self.picks[:n]
            rows = (row[picks] for row in self.palette.x)
        else:
            rows = (row[:n] for row in self.x[component_slice(component)])
        for row in rows:
            digest.update(np.ascontiguousarray(row, "<i4").data)
        return digest.digest()

    def dump(self) -> bytes:
        """The dump tile of spec 7.7 with what follows it."""
        return b"".join(self.dump_parts())

    def dump_parts(self) -> Iterator[bytes | memoryview]:
        """The dump tile of spec 7.7 with what follows it, in parts no larger than a channel."""
        row = self.directory.tiles[self.tile]
        yield layout.build(
            layout.DUMP_TILE, origin=[int(o) for o in row["origin"]], n_slots=self.n_slots
        )
        yield self.live[: self.n_slots].view(np.uint8).data
        for channel in self.shown_rows():
            yield np.ascontiguousarray(channel, "<i4").data


def _grown(array: npt.NDArray[Scalar], capacity: int) -> npt.NDArray[Scalar]:
    """A copy with room for `capacity` slots, those behind the old ones of any content."""
    grown = np.empty((*array.shape[:-1], capacity), array.dtype)
    grown[..., : array.shape[-1]] = array
    return grown


def _alpha_of(table: AlphaTable, indices: npt.NDArray[np.integer] | None) -> tuple[I32 | int, int]:
    """(a per split or one for all, K)."""
    if indices is None:
        return table.entries[0], table.shift
    return np.array(table.entries, np.int32)[indices], table.shift
