"""The float view of decoded integers (spec 7.6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from evogs_codec.common.buffers import empty
from evogs_codec.common.parallel import parallel_map
from evogs_codec.decoding.compiled.dispatch import loaded_kernels
from evogs_codec.decoding.tile_state import TileState
from evogs_codec.format.directory import Directory
from evogs_codec.model.channels import CORE_SH, GROUP_CHANNELS
from evogs_codec.model.components import PICKS, component_slice
from evogs_codec.model.splats import F32, I32, I64, SplatParams

__all__ = ["FloatView", "float_picks", "float_rows", "float_view", "n_moved_by_float32"]

BLOCK = 4096  # splats that are gathered or transposed at a time: their channels stay in cache


def float_view(directory: Directory, tiles: Sequence[TileState], sh_degree: int) -> SplatParams:
    """binary32 of (O + X) * 2**-G, rounded once (R-7.6-1), of the live slots."""
    n_live = np.array([int(np.count_nonzero(t.live[: t.n_slots])) for t in tiles], np.int64)
    leaves = FloatView(directory, n_live, sh_degree)
    for _ in parallel_map(leaves.write, tiles, n_splats=int(n_live.sum())):
        pass
    return leaves.splats()


def n_moved_by_float32(directory: Directory, splats: SplatParams) -> int:
    """How many splats of a stream binary32 moves by over a tenth of their mean size, at most.

    Args:
        directory: of the stream.
        splats: its float view.
    """
    if not len(splats):
        return 0
    spacing = np.spacing(np.abs(splats.means).max(axis=1)).astype(np.float64)
    is_rounded = spacing > 2.0 ** -directory.grid_exponents[0]
    return splats.n_moved(np.where(is_rounded, 0.5 * spacing, 0.0))


class FloatView:
    """Arrays of splats that tiles are written to, each to its place, in any order."""

    def __init__(self, directory: Directory, n_live: I64, sh_degree: int) -> None:
        """Room for `n_live` splats of each tile, of a degree that may differ from the stream's."""
        self.directory = directory
        self.sh_degree = sh_degree
        self.ends = np.cumsum(n_live)
        n = int(n_live.sum())
        n_sh = 3 * (min(sh_degree, directory.sh_degree) + 1) ** 2
        self.groups = [empty((n, size), np.float32) for size in (3, 4, 3, 1, n_sh)]

    def write(self, tile: TileState) -> None:
        """Put the live splats of a tile in their place."""
        live = tile.live[: tile.n_slots]
        shown = {component: tile.shown(component) for component in self._components()}
        n_live = int(np.count_nonzero(live))
        at = int(self.ends[tile.tile]) - n_live
        # Slots that are gathered are gathered in blocks, so that no copy of the state is made.
        as_stored = n_live == len(live) and all(slots is None for slots in shown.values())
        size = max(len(live), 1) if as_stored else BLOCK
        for begin in range(0, len(live), size):
            slots: slice | I64 = slice(begin, min(begin + size, len(live)))
            if n_live < len(live) and not live[slots].all():
                slots = begin + np.flatnonzero(live[slots])
            at += self._write_slots(tile, slots, shown, at)

    def _components(self) -> list[int]:
        """Those of a tile that the view shows: of SH bands, none above its degree."""
        components = self.directory.components
        bands = zip(components.of_tiles, components.lowest_bands, strict=True)
        return [component for component, lowest in bands if lowest <= self.sh_degree]

    def _write_slots(
        self, tile: TileState, slots: slice | I64, shown: dict[int, I32 | None], at: int
    ) -> int:
        """Put some slots of a tile from row `at` on; `shown` by component. Returns how many."""
        # The packets may just have loaded them; for a view alone it would not pay.
        kernels = loaded_kernels(len(self.groups[0]))
        write_rows = getattr(kernels, "float_rows", float_rows)
        write_picks = getattr(kernels, "float_picks", float_picks)
        x = self._gathered(tile, slots, shown)
        origins = np.zeros(len(x), np.int64)
        origins[0:3] = self.directory.tiles[tile.tile]["origin"]
        n = int(x.shape[1])
        for exponent, part, out in zip(
            self.directory.grid_exponents, GROUP_CHANNELS, self.groups, strict=True
        ):
            channels = slice(part.start, part.start + out.shape[1])
            to = out[at : at + n]
            if channels.stop > len(x):
                assert tile.palette is not None
                picks = _shown_picks(tile, slots, shown[PICKS])
                write_picks(x[CORE_SH], 2.0**-exponent, picks, tile.palette.rows(), to)
                continue
            write_rows(x[channels], origins[channels], 2.0**-exponent, to)
        return n

    def _gathered(self, tile: TileState, slots: slice | I64, shown: dict[int, I32 | None]) -> I32:
        """The integers of some slots as shown, a view of the state where that is the same."""
        if PICKS in shown:
            return tile.x[:, slots]
        if all(sources is None for sources in shown.values()):
            return tile.x[: component_slice(max(shown)).stop, slots]
        n = len(tile.live[slots])
        parts = []
        for component, sources in shown.items():
            rows = tile.x[component_slice(component)]
            if sources is None:
                parts.append(rows[:, slots])
            elif not tile.band_slots(component):
                parts.append(np.zeros((len(rows), n), np.int32))
            else:
                source = sources[slots]
                parts.append(np.where(source >= 0, rows[:, source], np.int32(0)))
        return np.concatenate(parts)

    def splats(self) -> SplatParams:
        """What was written, read-only."""
        means, quats, log_scales, opacity_logits, sh = self.groups
        n, n_coefficients = len(means), (self.sh_degree + 1) ** 2
        missing = 3 * n_coefficients - sh.shape[1]  # of bands above those of the stream
        if missing:
            sh = np.concatenate([sh, np.zeros((n, missing), np.float32)], 1)
        return SplatParams(
            means, quats, log_scales, opacity_logits[:, 0], sh.reshape(n, n_coefficients, 3)
        )


def _shown_picks(tile: TileState, slots: slice | I64, sources: I32 | None) -> I32:
    """The picks that these slots show; `sources` as of `TileState.shown`."""
    if sources is None:
        return tile.picks[: tile.n_slots][slots]
    source = sources[slots]
    picks: I32 = np.where(source >= 0, tile.picks[source], np.int32(0))
    return picks


def float_picks(
    x: I32, scale: float, picks: I32, rows: npt.NDArray[np.signedinteger], out: F32
) -> None:
    """out[:, :3] = x * scale, of SH band 0; out[i, 3:] = rows[picks[i]] * scale, blockwise.

    `rows` may have more columns. Powers of 2 scale exactly: rounding is of integers, once.
    """
    n = out.shape[1] - len(x)
    float_rows(x, np.zeros(len(x), np.int64), scale, out[:, : len(x)])
    for at in range(0, len(out), BLOCK):
        part = rows[picks[at : at + BLOCK], :n].astype(np.float32)
        out[at : at + BLOCK, len(x) :] = part * np.float32(scale)


def float_rows(x: I32, origins: I64, scale: float, out: F32) -> None:
    """out[i, c] = binary32((origins[c] + x[c, i]) * scale), blockwise.

    |O + X| is below 2**53, so binary64 holds it and the cast is the only rounding. Without origins
    the cast of X is: `scale` is a power of 2.
    """
    if not origins[: out.shape[1]].any():
        for at in range(0, len(out), BLOCK):
            to = out[at : at + BLOCK]
            to[:] = x[:, at : at + BLOCK].T
            to *= np.float32(scale)
        return
    for at in range(0, len(out), BLOCK):
        part = x[:, at : at + BLOCK] + origins[:, None]
        out[at : at + BLOCK] = (part * scale).T
