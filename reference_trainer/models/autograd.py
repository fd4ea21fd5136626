"""The kernels of `evogs_codec.render` as torch functions: pictures, and a loss.

This is all one needs to train splats on a processor:

    splats = [x.requires_grad_() for x in (means, quats, log_scales, opacity_logits, sh)]
    image = render(*splats, camera=camera, background=(1, 1, 1))       # (H, W, 3)
    photometric_loss(image, photograph).backward()

Parameters are those before activation, float32 or float64, on the processor; `Camera` and `Options`
are the rasterizer's. Pictures and gradients are the same bits for any number of threads.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from evogs_codec.render import Camera, Options, draw, gradients, ssim_gradient
from evogs_codec.render.options import DEFAULT

__all__ = ["photometric_loss", "render"]

Colour: TypeAlias = tuple[float, float, float]
Context: TypeAlias = Any  # torch gives it no type
Argument: TypeAlias = Any


def render(
    means: Tensor,
    quats: Tensor,
    log_scales: Tensor,
    opacity_logits: Tensor,
    sh: Tensor,
    *,
    camera: Camera,
    background: Colour = (0.0, 0.0, 0.0),
    options: Options = DEFAULT,
    screen: Tensor | None = None,
) -> Tensor:
    """The picture of N splats, differentiable in all their parameters.

    Args:
        means: (N, 3) positions in the world.
        quats: (N, 4) w x y z, of any length.
        log_scales: (N, 3) natural logarithms of the standard deviations.
        opacity_logits: (N,).
        sh: (N, K, 3) spherical harmonics, K = (degree + 1)**2 for a degree of 0..3.
        camera: pinhole, world to camera, x right, y down, z forward.
        background: colour behind the splats.
        options: near plane, largest alpha, dilation, antialiasing.
        screen: (N, 2) zeros that ask for a gradient: theirs is that to the centres of the splats
            on the screen, per pixel, as densification wants it. Their values are not looked at.

    Returns:
        (H, W, 3), of the type of the parameters, not clamped above.
    """
    image: Tensor = _Render.apply(  # type: ignore[no-untyped-call]
        means, quats, log_scales, opacity_logits, sh, screen, camera, background, options
    )
    return image


def photometric_loss(image: Tensor, photograph: Tensor, ssim_weight: float = 0.2) -> Tensor:
    """(1 - w) mean |image - photograph| + w (1 - SSIM), of two (H, W, 3) pictures.

    Differentiable in `image`, once.
    """
    loss: Tensor = _Loss.apply(image, photograph, ssim_weight)  # type: ignore[no-untyped-call]
    return loss


class _Arrays(NamedTuple):
    """What the rasterizer calls splats."""

    means: Any
    quats: Any
    log_scales: Any
    opacity_logits: Any
    sh: Any


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Context, *args: Argument) -> Tensor:
        *tensors, _, camera, background, options = args
        splats = _Arrays(*(np.ascontiguousarray(x.detach().numpy()) for x in tensors))
        drawing = draw(splats, camera, background, options=options, dtype=splats.means.dtype)
        ctx.splats, ctx.drawing = splats, drawing
        return torch.from_numpy(drawing.image)

    @staticmethod
    def backward(ctx: Context, *grads: Tensor) -> tuple[Tensor | None, ...]:
        g = gradients(ctx.drawing, ctx.splats, grads[0].numpy())
        found = (g.means, g.quats, g.log_scales, g.opacity_logits, g.sh, g.centers)
        wanted = ctx.needs_input_grad
        return (
            *(torch.from_numpy(x) if wanted[i] else None for i, x in enumerate(found)),
            *(None, None, None),
        )


class _Loss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Context, *args: Argument) -> Tensor:
        image, photograph, weight = args
        a, b = image.detach().numpy(), photograph.detach().numpy()
        similarity, gradient = ssim_gradient(a, b)
        difference = a - b
        gradient *= -weight
        gradient += np.sign(difference) * a.dtype.type((1.0 - weight) / a.size)
        ctx.gradient = torch.from_numpy(gradient)
        mean = float(np.abs(difference).mean(dtype=np.float64))
        value = (1.0 - weight) * mean + weight * (1.0 - similarity)
        return torch.tensor(value, dtype=image.dtype)

    @staticmethod
    def backward(ctx: Context, *grads: Tensor) -> tuple[Tensor | None, ...]:
        gradient: Tensor = ctx.gradient
        return gradient * grads[0], None, None
