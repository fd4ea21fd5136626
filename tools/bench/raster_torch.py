"""The rasterizer's definition in vectorised torch: what it is measured against, and tested with.

All pixels of a tile at once, gradients by autograd, tile after tile, so that memory stays flat. Any
float type. torch is no dependency of this package: the functions fail without it.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.render import Camera, Options
from evogs_codec.render.forward import Colour
from evogs_codec.render.options import ALPHA_MIN, T_MIN
from evogs_codec.render.splats import Splats

__all__ = ["FIELDS", "render_torch", "render_torch_gradients"]

Array = npt.NDArray[Any]

Module: TypeAlias = Any
Tensor: TypeAlias = Any  # of torch, which is not there when types are checked
FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
SIDE = 16


def render_torch(
    splats: Splats, camera: Camera, background: Colour, options: Options, dtype: str = "float32"
) -> Array:
    """(H, W, 3) picture."""
    torch = _torch()
    with torch.no_grad():
        _, screen, boxes = _prepare(splats, camera, options, dtype)
        image = torch.empty((camera.height, camera.width, 3), dtype=screen.dtype)
        colour = torch.tensor(background, dtype=screen.dtype)
        for where, x, y, rows in _tiles(camera, boxes):
            image[where] = _blend(screen[rows], x, y, colour, options)
    result: Array = image.numpy()
    return result


def render_torch_gradients(
    splats: Splats,
    camera: Camera,
    background: Colour,
    options: Options,
    image_gradient: Array,
    dtype: str = "float32",
) -> dict[str, Array]:
    """Gradients to the parameters, drawing included."""
    torch = _torch()
    parameters, screen, boxes = _prepare(splats, camera, options, dtype)
    g = torch.tensor(image_gradient, dtype=screen.dtype)
    colour = torch.tensor(background, dtype=screen.dtype)
    values, to_screen = screen.detach(), torch.zeros_like(screen)
    for where, x, y, rows in _tiles(camera, boxes):
        if len(rows):
            part = values[rows].requires_grad_()
            _blend(part, x, y, colour, options).backward(g[where])
            to_screen.index_add_(0, rows, part.grad)
    screen.backward(to_screen)
    return {name: parameters[name].grad.numpy() for name in FIELDS}


def _torch() -> Module:
    return importlib.import_module("torch")


def _prepare(
    splats: Splats, camera: Camera, options: Options, dtype: str
) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """Parameters; (M, 9) splats on the screen, front to back; their (M, 4) boxes in pixels."""
    torch = _torch()
    real = getattr(torch, dtype)
    parameters = {
        name: torch.tensor(np.array(getattr(splats, name)), dtype=real, requires_grad=True)
        for name in FIELDS
    }
    rotation = torch.tensor(camera.rotation, dtype=real)
    seen = parameters["means"] @ rotation.T + torch.tensor(camera.translation, dtype=real)
    rows = torch.nonzero(seen[:, 2] > options.near)[:, 0]
    rows = rows[torch.argsort(seen[rows, 2], stable=True)]
    p = {name: value[rows] for name, value in parameters.items()}
    x, y, z = seen[rows].unbind(1)

    margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    left, right = (
        -camera.cx / camera.fx - margin_x,
        (camera.width - camera.cx) / camera.fx + margin_x,
    )
    top, bottom = (
        -camera.cy / camera.fy - margin_y,
        (camera.height - camera.cy) / camera.fy + margin_y,
    )
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([camera.fx / z, zero, -camera.fx * (x / z).clamp(left, right) / z], 1),
            torch.stack([zero, camera.fy / z, -camera.fy * (y / z).clamp(top, bottom) / z], 1),
        ],
        1,
    )
    axes = _rotations(torch, p["quats"]) * p["log_scales"].exp()[:, None, :]
    u, v = (jacobian @ rotation @ axes).unbind(1)
    flat = torch.linalg.cross(u, v).square().sum(1)
    e = options.dilation
    xx, xy, yy = (u * u).sum(1) + e, (u * v).sum(1), (v * v).sum(1) + e
    det = flat + e * (xx + yy - 2 * e) + e * e
    opacity = torch.sigmoid(p["opacity_logits"])
    if options.antialiased:
        opacity = opacity * (flat / det).sqrt()
    eye = torch.tensor(camera.position, dtype=real)
    direction = torch.nn.functional.normalize(p["means"] - eye, dim=1)
    k = p["sh"].shape[1]
    colour = torch.einsum("nk,nkc->nc", _basis(torch, direction)[:, :k], p["sh"]) + 0.5
    center_x, center_y = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    screen = torch.cat(
        [
            torch.stack([center_x, center_y, yy / det, 1 / yy, xy / yy, opacity], 1),
            colour.clamp_min(0),
        ],
        1,
    )
    with torch.no_grad():
        reach = 2 * torch.log(opacity.clamp_min(ALPHA_MIN) / ALPHA_MIN) * (1 + 1e-4)
        hx, hy = (reach * xx).sqrt(), (reach * yy).sqrt()
        boxes = torch.stack([center_x - hx, center_x + hx, center_y - hy, center_y + hy], 1)
        boxes[opacity < ALPHA_MIN] = -math.inf
    return parameters, screen, boxes


def _rotations(torch: Module, quats: Tensor) -> Tensor:
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(entries, 1).reshape(-1, 3, 3)


def _basis(torch: Module, direction: Tensor) -> Tensor:
    x, y, z = direction.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    functions = [
        0.28209479177387814 * torch.ones_like(x),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return torch.stack(functions, 1)


def _tiles(
    camera: Camera, boxes: Tensor
) -> Iterator[tuple[tuple[slice, slice], Tensor, Tensor, Tensor]]:
    """For every tile: its place, its pixel centres, the splats whose boxes meet it."""
    torch = _torch()
    for top in range(0, camera.height, SIDE):
        bottom = min(top + SIDE, camera.height)
        in_row = torch.nonzero((boxes[:, 3] >= top) & (boxes[:, 2] <= bottom))[:, 0]
        row_boxes = boxes[in_row]
        for left in range(0, camera.width, SIDE):
            right = min(left + SIDE, camera.width)
            inside = (row_boxes[:, 1] >= left) & (row_boxes[:, 0] <= right)
            x = torch.arange(left, right, dtype=boxes.dtype) + 0.5
            y = torch.arange(top, bottom, dtype=boxes.dtype) + 0.5
            yield (slice(top, bottom), slice(left, right)), x, y, in_row[inside]


def _blend(screen: Tensor, x: Tensor, y: Tensor, background: Tensor, options: Options) -> Tensor:
    """(h, w, 3) pixels of one tile from its splats, front to back."""
    torch = _torch()
    center_x, center_y, a, c, slope, opacity = screen[:, :6].unbind(1)
    dy = y[:, None, None] - center_y
    across = x[None, :, None] - center_x - slope * dy
    # Clamped where it no longer matters: denormal numbers are slow.
    sigma = 0.5 * (across * across * a + dy * dy * c)
    alpha = opacity * torch.exp(-sigma.clamp_max(20))
    alpha = torch.where(alpha < ALPHA_MIN, 0.0, alpha.clamp_max(options.alpha_max))
    after = torch.log1p(-alpha).cumsum(2).clamp_min(-15).exp()
    takes = after >= T_MIN  # never true again once it is false
    left = torch.cat([torch.ones((len(y), len(x), 1), dtype=after.dtype), after], 2)
    colour = torch.where(takes, alpha * left[:, :, :-1], 0.0) @ screen[:, 6:]
    # What the last splat that was taken left.
    return colour + torch.gather(left, 2, takes.sum(2, keepdim=True)) * background
