"""Gradients of pictures and of the loss: against plain torch in float64, and differences."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from evogs_codec.render import Camera
from reference_trainer.models.autograd import photometric_loss, render
from reference_trainer.models.tensors import SplatTensors
from tests.trainer import tiny

CAMERA = Camera.look_at((0, -4, 1), (0, 0, 0), width=20, height=16, fov_x=0.7)
NAMES = SplatTensors._fields


def tensors(n=6, seed=0):
    """Splats of middling opacity, so that no pixel stops early and none is near 1/255."""
    splats = SplatTensors.of(tiny.random_splats(np.random.default_rng(seed), n))
    splats = splats._replace(
        log_scales=splats.log_scales + 1.5, opacity_logits=splats.opacity_logits * 0.2 - 0.5
    )
    return SplatTensors(*(x.double().requires_grad_() for x in splats))


def plain_render(splats, camera, background):
    """(H, W, 3) by the formulas, every splat at every pixel."""
    rotation, translation = (torch.tensor(x) for x in (camera.rotation, camera.translation))
    eye = splats.means @ rotation.T + translation
    x, y, z = eye.T
    w, i, j, k = functional.normalize(splats.quats, dim=1).T
    turn = torch.stack(
        [
            1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j),
            2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i),
            2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j),
        ], -1,
    ).reshape(-1, 3, 3)  # fmt: skip
    zero = torch.zeros_like(x)
    jacobian = torch.stack(
        [camera.fx / z, zero, -camera.fx * x / z**2, zero, camera.fy / z, -camera.fy * y / z**2],
        -1,
    ).reshape(-1, 2, 3)
    root = jacobian @ rotation @ turn * splats.log_scales.exp()[:, None, :]
    covariance = root @ root.transpose(1, 2) + 0.3 * torch.eye(2)
    conic = torch.linalg.inv(covariance)
    centers = torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1)
    direction = functional.normalize(splats.means - torch.tensor(camera.position), dim=1)
    dx, dy, dz = direction.T
    c0, c1 = 0.28209479177387814, 0.4886025119029199
    basis = torch.stack([c0 + zero, -c1 * dy, c1 * dz, -c1 * dx], -1)
    colours = (basis[:, :, None] * splats.sh).sum(1).add(0.5).clamp(min=0)
    grid_y, grid_x = torch.meshgrid(
        torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij"
    )
    pixels = torch.stack([grid_x, grid_y], -1).double()
    image, through = torch.zeros(camera.height, camera.width, 3).double(), torch.ones(())
    for s in torch.argsort(z.detach(), stable=True):
        d = pixels - centers[s]
        sigma = 0.5 * torch.einsum("hwi,ij,hwj->hw", d, conic[s], d)
        alpha = (splats.opacity_logits[s].sigmoid() * torch.exp(-sigma)).clamp(max=0.99)
        alpha = torch.where(alpha < 1 / 255, 0.0, alpha)
        image = image + (alpha * through)[..., None] * colours[s]
        through = through * (1 - alpha)
    return image + through[..., None] * torch.tensor(background, dtype=torch.float64)


def test_the_picture_and_its_gradients_are_those_of_the_formulas():
    background = (0.2, 0.5, 0.9)
    ours, theirs = tensors(), tensors()
    weights = torch.sin(torch.arange(16 * 20 * 3).double()).reshape(16, 20, 3)
    image = render(*ours, camera=CAMERA, background=background)
    plain = plain_render(theirs, CAMERA, background)
    torch.testing.assert_close(image, plain, rtol=0, atol=1e-9)
    (image * weights).sum().backward()
    (plain * weights).sum().backward()
    for name, one, other in zip(NAMES, ours, theirs, strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-6, atol=1e-8, msg=name)


def test_gradients_are_differences():
    splats = tensors()
    weights = torch.cos(torch.arange(16 * 20 * 3).double()).reshape(16, 20, 3)

    def loss():
        return (render(*splats, camera=CAMERA) * weights).sum()

    loss().backward()
    rng, step = np.random.default_rng(3), 1e-6
    for x in splats:
        flat, grad = x.detach().reshape(-1), x.grad.reshape(-1)
        i = int(rng.integers(len(flat)))
        with torch.no_grad():
            flat[i] += step
            above = loss()
            flat[i] -= 2 * step
            below = loss()
            flat[i] += step
        assert float((above - below) / (2 * step)) == pytest.approx(float(grad[i]), rel=1e-4)


def test_screen_gets_the_gradient_to_the_centres():
    splats = tensors()
    screen = torch.zeros((6, 2), dtype=torch.float64, requires_grad=True)
    render(*splats, camera=CAMERA, screen=screen).sum().backward()
    assert screen.grad is not None
    assert screen.grad.shape == (6, 2)
    assert screen.grad.abs().sum() > 0


def test_the_loss_is_l1_and_ssim_with_their_gradients():
    rng = np.random.default_rng(2)
    image = torch.from_numpy(rng.random((14, 17, 3))).requires_grad_()
    photograph = torch.from_numpy(rng.random((14, 17, 3)))
    assert torch.autograd.gradcheck(
        lambda x: photometric_loss(x, photograph, 0.2), image, eps=1e-6, atol=1e-7
    )
    only_l1 = photometric_loss(image, photograph, 0.0)
    torch.testing.assert_close(only_l1, (image - photograph).abs().mean())
    assert float(photometric_loss(photograph.clone(), photograph)) == pytest.approx(0, abs=1e-12)


def test_constants_need_no_gradients():
    splats = SplatTensors(*(x.detach() for x in tensors()))
    assert not render(*splats, camera=CAMERA).requires_grad
    sh = splats.sh.requires_grad_()
    render(*splats, camera=CAMERA).sum().backward()
    assert sh.grad is not None
    assert sh.grad.abs().sum() > 0
