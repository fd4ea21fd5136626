"""Splats that are activated once give the pictures and gradients that they give each time."""

import numpy as np

from evogs_codec.render import cameras_around, draw, gradients, render
from evogs_codec.render.activated import Activated
from evogs_codec.render.demo_scene import make_scene

SPLATS = make_scene(300)
CAMERAS = cameras_around(SPLATS, "z", 48, n=3)


def test_views_of_activated_splats_are_the_same():
    ready = Activated.of(SPLATS)
    for camera in CAMERAS:
        assert np.array_equal(render(ready, camera), render(SPLATS, camera))


def test_gradients_of_activated_splats_are_the_same():
    ready = Activated.of(SPLATS)
    for camera in CAMERAS:
        g = np.random.default_rng(0).normal(size=(48, 48, 3)).astype(np.float32)
        found = gradients(draw(ready, camera), ready, g)
        expected = gradients(draw(SPLATS, camera), SPLATS, g)
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh", "centers"):
            assert np.array_equal(getattr(found, name), getattr(expected, name))
