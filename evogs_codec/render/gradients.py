"""Gradients of a loss to the parameters of the splats of a drawing (spec/rasterizer.md 7)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.render.blending import constants_of
from evogs_codec.render.blending_gradient import ENTRY, add_up, blend_gradient
from evogs_codec.render.blending_moments import WIDTH, blend_moments
from evogs_codec.render.compiled import n_threads
from evogs_codec.render.forward import Drawing
from evogs_codec.render.projection_gradient import project_gradient
from evogs_codec.render.projection_squares import project_squares
from evogs_codec.render.splats import Real, Splats

__all__ = ["Gradients", "add_squared_gradients", "gradients"]

_MAX_LIST = 1 << 24  # float32 counts exactly up to here


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients to N splats, of the type of the picture; zero to splats that were not drawn.

    Attributes:
        means, quats, log_scales, opacity_logits, sh: to the parameters, shaped like them.
        centers: (N, 2) to the centres on the screen, per pixel. The gradient "in NDC" of 3DGS
            densification is this times (W / 2, H / 2).
    """

    means: Real
    quats: Real
    log_scales: Real
    opacity_logits: Real
    sh: Real
    centers: Real


def gradients(drawing: Drawing, splats: Splats, image_gradient: Real) -> Gradients:
    """Gradients of a loss whose gradient to the picture is known.

    Args:
        drawing: what `draw` made of `splats`.
        splats: the same parameters.
        image_gradient: (H, W, 3).

    Raises:
        ValueError: the shapes do not fit, or one tile has more than 2^24 splats.
    """
    dtype = drawing.image.dtype
    to_records = _to_records(drawing, splats, image_gradient)
    out = Gradients(
        np.empty(splats.means.shape, dtype),
        np.empty(splats.quats.shape, dtype),
        np.empty(splats.log_scales.shape, dtype),
        np.empty(splats.opacity_logits.shape, dtype),
        np.empty(splats.sh.shape, dtype),
        to_records[:, :2].astype(dtype),
    )
    project_gradient(
        splats.means, splats.quats, splats.opacity_logits, splats.sh, drawing.active,
        drawing.camera.view(drawing.options), drawing.options.antialiased,
        drawing.tiles.records, drawing.status, to_records,
        out.means, out.quats, out.log_scales, out.opacity_logits, out.sh, n_threads(),
    )  # fmt: skip
    return out


def add_squared_gradients(
    totals: Sequence[Real], drawing: Drawing, splats: Splats, shown: Real | None = None
) -> None:
    """Add to totals, for each number of the splats, the mean squared derivative of the picture.

    The mean is over pixels and R G B. Of a moved splat, changes by its colour and by its place are
    squared apart.

    Args:
        totals: means, quats, log_scales, opacity_logits and sh, added to; shaped like those of
            `splats`, of the type of the picture.
        drawing: as of `gradients`.
        splats: as of `gradients`.
        shown: (H, W) how much of the picture is seen at each pixel; None: all of it.

    Raises:
        ValueError: as `gradients`.
    """
    _expect_drawn(drawing, splats)
    image = drawing.image
    if shown is not None and shown.shape != image.shape[:2]:
        raise ValueError(f"shown of shape {shown.shape}, {image.shape[:2]} expected")
    seen = np.ones(image.shape[:2]) if shown is None else shown
    moments = np.zeros((len(splats.means), WIDTH), image.dtype)
    _back_to_front(blend_moments, drawing, np.ascontiguousarray(seen, image.dtype), moments)
    means, quats, log_scales, opacity_logits, sh = totals
    project_squares(
        splats.means, splats.quats, splats.opacity_logits, splats.sh, drawing.active,
        drawing.camera.view(drawing.options), drawing.options.antialiased,
        drawing.tiles.records, drawing.status, moments, float(image.size),
        means, quats, log_scales, opacity_logits, sh, n_threads(),
    )  # fmt: skip


def _to_records(drawing: Drawing, splats: Splats, image_gradient: Real) -> Real:
    """(N, ENTRY) gradients to the records, float64.

    Raises:
        ValueError: as `gradients`.
    """
    if image_gradient.shape != drawing.image.shape:
        raise ValueError(
            f"gradient of shape {image_gradient.shape}, {drawing.image.shape} expected"
        )
    _expect_drawn(drawing, splats)
    to_records = np.zeros((len(splats.means), len(ENTRY)), np.float64)
    g = np.ascontiguousarray(image_gradient, drawing.image.dtype)
    _back_to_front(blend_gradient, drawing, g, to_records)
    return to_records


def _expect_drawn(drawing: Drawing, splats: Splats) -> None:
    if len(splats.means) != len(drawing.status):
        raise ValueError(f"{len(splats.means)} splats, the drawing is of {len(drawing.status)}")
    longest = drawing.tiles.counts.max(initial=0)
    if longest > _MAX_LIST:
        raise ValueError(f"a tile with {longest} splats, over {_MAX_LIST}")


def _back_to_front(
    kernel: Callable[..., None], drawing: Drawing, of_pixels: Real, totals: Real
) -> None:
    """Add what a kernel finds for the entries of all lists to the (N, ...) totals of the splats."""
    tiles, dtype = drawing.tiles, drawing.image.dtype
    background = np.ascontiguousarray(np.broadcast_to(drawing.background, drawing.image.shape))
    constants = constants_of(drawing.options, dtype)
    for chunk in [drawing.chunk] if drawing.chunk else tiles.chunks():
        rows = np.empty((len(chunk.entries), totals.shape[1]), dtype)
        kernel(
            chunk.first, tiles.columns, chunk.offsets, chunk.entries, chunk.order,
            tiles.records, tiles.rows, background, constants,
            of_pixels, drawing.transmittance, drawing.last, rows, n_threads(),
        )  # fmt: skip
        add_up(chunk.offsets, chunk.block_ends, chunk.entries, rows, totals)
