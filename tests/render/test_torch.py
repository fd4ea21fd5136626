"""Pictures and gradients are those of plain torch with autograd, in float64."""

from importlib.util import find_spec

import numpy as np
import pytest

from evogs_codec.render import Options, draw, gradients
from tests.render import scenes
from tests.render.scenes import BACKGROUND
from tools.bench.raster_torch import FIELDS, render_torch, render_torch_gradients

# torch is looked for and not imported: that takes seconds, also of those who only collect tests.
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed"),
]


@pytest.mark.parametrize("options", [Options(), Options(antialiased=True), Options(alpha_max=0.6)])
def test_pictures_and_gradients_are_those_of_autograd(options):
    splats, camera = scenes.as_float64(scenes.ball(300, 6, size=0.1)), scenes.camera(50, 41)
    g = np.random.default_rng(0).normal(size=(41, 50, 3))
    drawing = draw(splats, camera, BACKGROUND, options=options, dtype=np.float64)
    image = render_torch(splats, camera, BACKGROUND, options, "float64")
    np.testing.assert_allclose(drawing.image, image, atol=1e-12)
    ours = gradients(drawing, splats, g)
    theirs = render_torch_gradients(splats, camera, BACKGROUND, options, g, "float64")
    for name in FIELDS:
        expected = theirs[name]
        error = np.abs(getattr(ours, name) - expected).max()
        assert error <= 1e-10 * np.abs(expected).max(), name
