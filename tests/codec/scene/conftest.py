"""A stream that is by views, for tests of what is done with it."""

import numpy as np
import pytest

from evogs_codec import PRESETS, TargetEncoder, lift
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import choose

PRICE = 1e-11


@pytest.fixture(scope="module")
def layered():
    """600 splats in two layers, judged by four small views."""
    pytest.importorskip("numba", reason="the rasterizer is compiled")
    from evogs_codec.render import Views, cameras_around

    splats = make_scene(600)
    views = Views(splats, cameras_around(splats, "z", 60, n=4))
    aim = TargetEncoder(lift(splats, 3), PRESETS["scene"], views, layers=2)
    return choose._at_price([aim], PRICE).made()


class Shown(list[float]):
    """PSNR of each view; `where` stands for the splats without their SH."""

    def __init__(self, psnr, where=0.0):
        super().__init__(psnr)
        self.means = self.quats = self.log_scales = self.opacity_logits = np.array([where])
