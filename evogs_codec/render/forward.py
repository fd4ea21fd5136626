"""Pictures of splats, and the gradients of pictures (spec/rasterizer.md).

`render` gives the picture, `render_counted` also says what was left out. `draw` keeps what
`gradients` needs to turn the gradient of a loss to the picture into gradients to the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render.activated import Activated, Buffers, active_of
from evogs_codec.render.activation import ACTIVE
from evogs_codec.render.blending import blend, constants_of
from evogs_codec.render.camera import Camera
from evogs_codec.render.compiled import n_threads
from evogs_codec.render.options import DEFAULT, Options
from evogs_codec.render.splats import Real, Splats
from evogs_codec.render.tiles import Chunk, Tiles, depth_order

__all__ = ["Colour", "Counts", "Drawing", "Splats", "draw", "prepare", "render", "render_counted"]

BLOCK = 1 << 16  # splats of one view that are activated together: what follows from them is large
Colour = Sequence[float] | Real


@dataclass(frozen=True)
class Counts:
    """What became of N splats: n_drawn + n_invisible + n_non_finite = N.

    Attributes:
        n_drawn: those whose box meets the picture.
        n_invisible: those too near, off the picture, between pixels, or too faint.
        n_non_finite: those with a parameter, or a footprint, that is not a finite number.
        n_intersections: pairs of a drawn splat and a tile that it meets.
    """

    n_drawn: int
    n_invisible: int
    n_non_finite: int
    n_intersections: int


@dataclass(frozen=True, eq=False)
class Drawing:
    """A picture and how it came about.

    Attributes:
        camera, options: what was asked for.
        background: (3,), or a picture (H, W, 3).
        image: (H, W, 3).
        transmittance: (H, W) of the background.
        active: of the splats, `Activated.active`; of no splat where no gradients are asked for.
        status: (N,) `projection.DRAWN`, `INVISIBLE` or `NON_FINITE`.
        last: (H, W) position of each pixel's last splat in the list of its tile, -1 if none.
        tiles: the lists.
        chunk: all lists, where they fit one chunk.
    """

    camera: Camera
    options: Options
    background: Real
    image: Real
    transmittance: Real
    active: npt.NDArray[np.float64]
    status: npt.NDArray[np.uint8]
    last: npt.NDArray[np.int32]
    tiles: Tiles
    chunk: Chunk | None

    @property
    def counts(self) -> Counts:
        """What became of the splats."""
        n = np.bincount(self.status, minlength=3)
        return Counts(
            int(n[p.DRAWN]), int(n[p.INVISIBLE]), int(n[p.NON_FINITE]), self.tiles.n_intersections
        )


def render(
    splats: Splats,
    camera: Camera,
    background: Colour = (0.0, 0.0, 0.0),
    *,
    options: Options = DEFAULT,
    dtype: npt.DTypeLike = np.float32,
) -> Real:
    """(H, W, 3) picture, linear in the colours, not clamped above; float32 or float64.

    The background is a colour, or itself a picture (H, W, 3).
    """
    return _draw(splats, camera, background, options, dtype, keep=False).image


def render_counted(
    splats: Splats,
    camera: Camera,
    background: Colour = (0.0, 0.0, 0.0),
    *,
    options: Options = DEFAULT,
    dtype: npt.DTypeLike = np.float32,
) -> tuple[Real, Counts]:
    """The picture of `render`, and what became of the splats."""
    drawing = _draw(splats, camera, background, options, dtype, keep=False)
    return drawing.image, drawing.counts


def draw(
    splats: Splats,
    camera: Camera,
    background: Colour = (0.0, 0.0, 0.0),
    *,
    options: Options = DEFAULT,
    dtype: npt.DTypeLike = np.float32,
) -> Drawing:
    """The picture of `render`, with what `gradients` needs."""
    return _draw(splats, camera, background, options, dtype, keep=True)


def _draw(
    splats: Splats,
    camera: Camera,
    background: Colour,
    options: Options,
    dtype: npt.DTypeLike,
    *,
    keep: bool,
) -> Drawing:
    if keep and not isinstance(splats, Activated):
        splats = Activated.of(splats)
    tiles, status = prepare(splats, camera, options)
    height, width = camera.height, camera.width
    image = np.empty((height, width, 3), dtype)
    behind = np.asarray(background, dtype)
    is_picture = behind.ndim > 1
    colour = np.zeros(3, dtype) if is_picture else behind
    kept = (height, width) if keep or is_picture else (0, 0)
    transmittance, last = np.empty(kept, dtype), np.empty(kept, np.int32)
    chunk = None
    n_chunks = 0
    for chunk in tiles.chunks():
        n_chunks += 1
        blend(
            chunk.first, tiles.columns, chunk.offsets, chunk.entries, chunk.order,
            tiles.records, tiles.rows, colour, constants_of(options, dtype),
            image, transmittance, last, n_threads(),
        )  # fmt: skip
    if is_picture:
        image += transmittance[..., None] * behind
    active = splats.active if isinstance(splats, Activated) else np.empty((0, ACTIVE))
    kept_chunk = chunk if keep and n_chunks == 1 else None
    return Drawing(
        camera, options, behind, image, transmittance, active, status, last, tiles, kept_chunk
    )


def prepare(
    splats: Splats, camera: Camera, options: Options
) -> tuple[Tiles, npt.NDArray[np.uint8]]:
    """Project, sort and count: all that comes before pixels; and the status of each splat."""
    n = len(splats.means)
    buffers = splats.buffers if isinstance(splats, Activated) else Buffers.of(n)
    size = max(n, 1) if isinstance(splats, Activated) else BLOCK
    for begin in range(0, n, size):
        part = slice(begin, begin + size)
        p.project(
            splats.means[part], active_of(splats, part), splats.sh[part],
            camera.view(options), options.antialiased, camera.width, camera.height,
            buffers.records[part], buffers.rows[part], buffers.spans[part], buffers.depths[part],
            buffers.status[part], n_threads(),
        )  # fmt: skip
    order = depth_order(buffers.depths, buffers.status)
    tiles = Tiles.of(
        buffers.records, buffers.rows, buffers.spans, order, camera.width, camera.height
    )
    if tiles.n_intersections > options.max_intersections:
        raise ValueError(
            f"{tiles.n_intersections} pairs of a splat and a tile, over max_intersections = "
            f"{options.max_intersections}: are the scales of the scene right?"
        )
    return tiles, buffers.status
