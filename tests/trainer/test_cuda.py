"""The backend on CUDA gives the pictures and gradients of the one on the processor."""

from importlib.util import find_spec

import numpy as np
import pytest
import torch

from evogs_codec.render import Camera
from reference_trainer.models.backends import backend_for, cuda
from reference_trainer.models.tensors import SplatTensors
from tests.trainer import tiny

CAMERA = Camera.look_at((0, -4, 1), (0, 0, 0), width=48, height=40, fov_x=0.7)


def test_a_missing_device_is_refused():
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(ValueError, match="torch finds no CUDA device"):
        backend_for("cuda")


def test_the_loss_is_that_of_the_processor(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(cuda, "find_spec", lambda name: name)
    rng = np.random.default_rng(0)
    photograph, picture = rng.random((2, 30, 40, 3), np.float32)
    found = []
    for backend in (backend_for("cpu"), cuda.Cuda("cpu")):
        image = torch.tensor(picture, requires_grad=True)
        loss = backend.loss(image, backend.photograph(photograph), 0.3)
        loss.backward()
        found.append((loss.detach(), image.grad))
    torch.testing.assert_close(found[0], found[1], rtol=1e-4, atol=1e-7)


@pytest.mark.gpu
@pytest.mark.skipif(
    not torch.cuda.is_available() or find_spec("gsplat") is None, reason="needs CUDA and gsplat"
)
def test_backends_agree():
    found = []
    splats = tiny.random_splats(np.random.default_rng(0), 50)
    photograph = np.full((40, 48, 3), 0.4, np.float32)
    for device in ("cpu", "cuda"):
        backend = backend_for(device)
        tensors = SplatTensors.of(splats, device).trainable()
        screen = backend.screen(tensors)
        image = backend.render(tensors, CAMERA, tiny.WHITE, screen)
        backend.loss(image, backend.photograph(photograph), 0.2).backward()
        grads = [x.grad for x in (*tensors, screen)]
        found.append([image.detach().cpu(), *(g.cpu() for g in grads if g is not None)])
    assert len(found[0]) == len(found[1]) == 7
    # gsplat lets alpha reach 0.999, ours 0.99; elsewhere they differ by rounding.
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=2e-2, atol=2e-3)
