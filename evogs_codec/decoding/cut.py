"""Cuts: how many steps of each tile and component are applied (spec 3.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.format.directory import Directory
from evogs_codec.model.splats import F64, I64

__all__ = ["Cut"]


@dataclass(frozen=True, eq=False)
class Cut:
    """Steps applied: `steps` (n_tiles, columns) as `Components` has them; tiles may differ.

    `palette` is the number of steps of the palette, which belongs to no tile.
    """

    steps: I64
    palette: int = 0

    def __post_init__(self) -> None:
        steps = np.array(self.steps, np.int64)
        if steps.ndim != 2 or (steps < 0).any() or (steps > steps[:, :1]).any():
            raise ValueError("a cut has (tile, component) step counts, none above that of core")
        if self.palette < 0:
            raise ValueError(f"{self.palette} steps of a palette")
        steps.setflags(write=False)
        object.__setattr__(self, "steps", steps)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Cut):
            return NotImplemented
        return self.palette == other.palette and np.array_equal(self.steps, other.steps)

    def __hash__(self) -> int:
        return hash((self.steps.shape, self.steps.tobytes(), self.palette))

    def __repr__(self) -> str:
        n_tiles, n_components = self.steps.shape
        steps = ", ".join(_span(column) for column in self.steps.T)
        palette = f", palette {self.palette}" if self.palette else ""
        return f"Cut({n_tiles} tiles, {n_components} components: steps {steps}{palette})"

    @staticmethod
    def full(directory: Directory) -> Cut:
        """All steps in the file."""
        return Cut(directory.chain_lengths, len(directory.palette_packets))

    @staticmethod
    def of_level(directory: Directory, level: int) -> Cut:
        """Level `level` of every tile, and of the palette.

        Raises:
            ValueError: the stream has no such level.
        """
        if not 0 <= level < directory.n_levels:
            raise ValueError(f"level {level} is not one of 0..{directory.n_levels - 1}")
        packets = directory.packets
        in_level = (packets["component"] == 0) & (packets["level"] <= level)
        core = np.bincount(packets["tile"][in_level], minlength=len(directory.tiles))
        steps = np.minimum(directory.chain_lengths, core[:, None])
        of_palette = packets["level"][directory.palette_packets]
        return Cut(steps, int(np.count_nonzero(of_palette <= level)))

    @staticmethod
    def of_rows(directory: Directory, rows: I64) -> Cut:
        """The cut of these rows of the packet table; with a row it has those that it requires."""
        n_palette = int(np.isin(directory.palette_packets, rows).sum())
        return Cut(directory.packets_per_chain(rows), n_palette)

    @staticmethod
    def of_prefix(directory: Directory, n_bytes: int) -> Cut:
        """The largest cut of packets that end within the first `n_bytes` bytes of the file."""
        ends = directory.offsets + directory.packets["size"]
        return Cut.of_complete(directory, ends <= n_bytes)

    @staticmethod
    def of_complete(directory: Directory, complete: npt.NDArray[np.bool_]) -> Cut:
        """The largest cut of complete packets; one of size 0 is always complete (R-6.4-4)."""
        rows, steps = directory.packets, directory.chain_lengths.copy()
        is_missing = ~complete & (rows["size"] > 0)
        palette = directory.palette_packets
        n_palette = int(np.argmax(np.append(is_missing[palette], True)))
        is_missing |= directory.palette_required > n_palette
        is_missing[palette] = False
        missing = np.flatnonzero(is_missing)
        chain = rows["tile"][missing], directory.columns[missing]
        np.minimum.at(steps, chain, directory.steps[missing])
        return Cut(np.minimum(steps, steps[:, :1]), n_palette)

    def intersection(self, other: Cut) -> Cut:
        """What this cut and another one share."""
        return Cut(np.minimum(self.steps, other.steps), min(self.palette, other.palette))

    def contains(self, other: Cut) -> bool:
        """No step of the other cut is missing here."""
        same_shape = self.steps.shape == other.steps.shape
        is_within = same_shape and bool((other.steps <= self.steps).all())
        return is_within and other.palette <= self.palette

    def sh_degree(self, directory: Directory) -> int:
        """Highest SH band with a step in the cut; picks are of all bands."""
        bands = directory.components.highest_bands
        applied = np.flatnonzero((self.steps > 0).any(0)).tolist()
        return max((bands[column] for column in applied), default=0)

    def with_sh_degree(self, degree: int) -> Cut:
        """The same without the SH bands above `degree`; of a palette all, or nothing for 0."""
        steps = self.steps.copy()
        steps[:, degree + 1 :] = 0
        return Cut(steps, self.palette if degree else 0)

    def with_box(self, directory: Directory, box: Sequence[float]) -> Cut:
        """The same with only the tiles whose box meets `box` (x0 y0 z0 x1 y1 z1, scene units)."""
        steps, met = self.steps.copy(), tiles_meeting(directory, box)
        steps[~met] = 0
        return Cut(steps, self.palette if met.any() else 0)

    def packets(self, directory: Directory) -> npt.NDArray[np.bool_]:
        """(n_packets,) True for the packets of the cut.

        Raises:
            ValueError: the cut asks for steps that the file does not have.
        """
        if self.steps.shape != (len(directory.tiles), len(directory.components.of_tiles)):
            raise ValueError(f"the cut has shape {self.steps.shape}")
        palette = directory.palette_packets
        if (self.steps > directory.chain_lengths).any() or self.palette > len(palette):
            raise ValueError("the cut asks for steps that are not in the file")
        selected = np.zeros(len(directory.packets), bool)
        selected[palette[: self.palette]] = True
        of_tiles = directory.columns >= 0
        applied = self.steps[directory.packets["tile"][of_tiles], directory.columns[of_tiles]]
        selected[of_tiles] = directory.steps[of_tiles] < applied
        required = int(directory.palette_required[selected].max(initial=0))
        if self.palette < required:
            raise ValueError(f"picks of the cut require {required} packets of the palette")
        return selected


def _span(steps: I64) -> str:
    """The number of steps of a component, or the least and the most of all tiles."""
    if not len(steps):
        return "none"
    low, high = int(steps.min()), int(steps.max())
    return str(low) if low == high else f"{low}..{high}"


def tiles_meeting(directory: Directory, box: Sequence[float]) -> npt.NDArray[np.bool_]:
    """(n_tiles,) True where the box of a tile meets `box` (x0 y0 z0 x1 y1 z1, scene units)."""
    (low, high), corners = _tile_boxes(directory), _corners(box)
    met: npt.NDArray[np.bool_] = ((low <= corners[1]) & (high >= corners[0])).all(1)
    return met


def tiles_within(directory: Directory, box: Sequence[float]) -> npt.NDArray[np.bool_]:
    """(n_tiles,) True where the box of a tile is inside `box`, as of `tiles_meeting`."""
    (low, high), corners = _tile_boxes(directory), _corners(box)
    inside: npt.NDArray[np.bool_] = ((low >= corners[0]) & (high <= corners[1])).all(1)
    return inside


def scene_bounds(directory: Directory) -> tuple[F64, F64]:
    """(3,) and (3,) lowest and highest positions that splats may have, scene units.

    They are those of the tile table, so nothing is decoded. Zeros where there is no slot.
    """
    low, high = _tile_boxes(directory)
    has_slots = directory.tile_slots > 0
    if not has_slots.any():
        return np.zeros(3), np.zeros(3)
    return low[has_slots].min(0), high[has_slots].max(0)


def _tile_boxes(directory: Directory) -> tuple[F64, F64]:
    """(n_tiles, 3) lowest and highest positions, scene units."""
    scale = 2.0 ** -directory.grid_exponents[0]
    origin = directory.tiles["origin"]
    low, high = (origin + directory.tiles[end] for end in ("box_min", "box_max"))
    return low * scale, high * scale


def _corners(box: Sequence[float]) -> F64:
    """(2, 3) lowest and highest, whichever come first."""
    out: F64 = np.sort(np.asarray(box, np.float64).reshape(2, 3), axis=0)
    return out
