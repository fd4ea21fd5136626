"""The rasterizer: a definition (spec/rasterizer.md), an oracle that reads like it, fast kernels."""

from conformance.rasterizer.camera import Camera, load_cameras, orbit, save_cameras
from conformance.rasterizer.gradients import Gradients, gradients
from conformance.rasterizer.metrics import psnr, ssim, ssim_gradient
from conformance.rasterizer.options import Options
from conformance.rasterizer.render import Counts, Drawing, draw, render, render_counted

__all__ = [
    "Camera",
    "Counts",
    "Drawing",
    "Gradients",
    "Options",
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
]
