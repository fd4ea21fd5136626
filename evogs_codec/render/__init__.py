"""The rasterizer: a definition (spec/rasterizer.md), an oracle that reads like it, fast kernels."""

from evogs_codec.render.camera import Camera, orbit, save_cameras
from evogs_codec.render.camera_files import load_cameras
from evogs_codec.render.forward import Counts, Drawing, draw, render, render_counted
from evogs_codec.render.gradients import Gradients, gradients
from evogs_codec.render.metrics import psnr, ssim, ssim_gradient
from evogs_codec.render.options import Options
from evogs_codec.render.up import Up, up_of, up_of_cameras
from evogs_codec.render.viewpoints import (
    camera_rings,
    cameras_all_around,
    cameras_around,
    weighing_cameras,
)
from evogs_codec.render.views import Views

__all__ = [
    "Camera",
    "Counts",
    "Drawing",
    "Gradients",
    "Options",
    "Up",
    "Views",
    "camera_rings",
    "cameras_all_around",
    "cameras_around",
    "draw",
    "gradients",
    "load_cameras",
    "orbit",
    "psnr",
    "render",
    "render_counted",
    "save_cameras",
    "ssim",
    "ssim_gradient",
    "up_of",
    "up_of_cameras",
    "weighing_cameras",
]
