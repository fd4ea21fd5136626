"""`python -m tools.bench.raster`: time and memory of the rasterizer, and of torch in the same run.

800 x 800 pixels, 100,000 random ellipsoids of SH degree 3. Times are medians; torch, which is
optional, takes turns with ours.
"""

from __future__ import annotations

import argparse
import importlib.util
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from conformance.rasterizer import Camera, Options, draw, gradients, orbit, render, ssim_gradient
from conformance.rasterizer import projection as p
from conformance.rasterizer.blending import blend
from conformance.rasterizer.blending_gradient import ENTRY, add_up, blend_gradient
from conformance.rasterizer.compiled import n_threads
from conformance.rasterizer.projection_gradient import project_gradient
from conformance.rasterizer.tiles import Tiles, depth_order
from evogs_codec import SplatParams
from evogs_codec.splats import F32
from tools.bench.raster_torch import render_torch, render_torch_gradients

__all__ = ["Scene", "compare", "memory", "stages"]

Result = TypeVar("Result")

OPTIONS = Options()
BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """Splats, a camera and the gradient of a loss to the picture."""

    splats: SplatParams
    camera: Camera
    image_gradient: F32

    @staticmethod
    def of(n: int, size: int, seed: int = 0) -> Scene:
        """N random ellipsoids in a shell, seen whole; their sizes keep the picture as full."""
        rng = np.random.default_rng(seed)
        directions = rng.normal(size=(n, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        falling = 0.3 / (1 + np.arange(16))[:, None]
        splats = SplatParams(
            means=f32(directions * (0.6 + 0.4 * rng.random((n, 1)))),
            quats=f32(rng.normal(size=(n, 4))),
            log_scales=f32(np.log(0.012 * (5e4 / n) ** 0.5) + 0.5 * rng.normal(size=(n, 3))),
            opacity_logits=f32(1.5 * rng.normal(size=n)),
            sh=f32(falling * rng.normal(size=(n, 16, 3))),
        )
        (camera,) = orbit(1, radius=3, width=size, height=size, fov_x=0.69)
        return Scene(splats, camera, f32(rng.normal(size=(size, size, 3))))


def f32(values: npt.ArrayLike) -> F32:
    """The numbers in float32."""
    return np.asarray(values, np.float32)


def stages(scene: Scene, turns: int) -> dict[str, float]:
    """Median seconds of every stage of a drawing and its gradients."""
    times = [_one_turn(scene) for _ in range(turns + 1)][1:]
    return {name: float(np.median([t[name] for t in times])) for name in times[0]}


def _one_turn(scene: Scene) -> dict[str, float]:
    s, camera = scene.splats, scene.camera
    arrays = (s.means, s.quats, s.log_scales, s.opacity_logits, s.sh)
    n, view, color = len(s), camera.view(OPTIONS), np.zeros(3, np.float32)
    shape, threads = (camera.height, camera.width), n_threads()
    seconds: dict[str, float] = {}

    def timed(name: str, run: Callable[[], Result]) -> Result:
        start = time.perf_counter()
        result = run()
        seconds[name] = time.perf_counter() - start
        return result

    records, depths = np.empty((n, p.FIELDS)), np.empty(n)
    rows, status = np.empty((n, 2), np.int32), np.empty(n, np.uint8)
    timed(
        "project",
        lambda: p.project(
            *arrays, view, False, *shape[::-1], records, rows, depths, status, threads
        ),
    )
    order = timed("sort", lambda: depth_order(depths, status))
    tiles = timed("count", lambda: Tiles.of(records, rows, order, *shape[::-1]))
    (chunk,) = timed("fill", lambda: list(tiles.chunks()))
    lists = (chunk.first, tiles.columns, chunk.offsets, chunk.entries, chunk.order, records, rows)
    image, t = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
    last = np.empty(shape, np.int32)
    timed("blend", lambda: blend(*lists, color, OPTIONS.alpha_max, image, t, last, threads))
    entries = np.empty((len(chunk.entries), len(ENTRY)), np.float32)
    g = scene.image_gradient
    timed(
        "blend, backwards",
        lambda: blend_gradient(*lists, color, OPTIONS.alpha_max, g, t, last, entries, threads),
    )
    sums = np.zeros((n, len(ENTRY)))
    timed("add up", lambda: add_up(chunk.offsets, chunk.block_ends, chunk.entries, entries, sums))
    g_means, g_quats, g_scales, g_logits, g_sh = (np.empty_like(array) for array in arrays)
    timed(
        "project, backwards",
        lambda: project_gradient(
            *arrays, view, False, records, status, sums,
            g_means, g_quats, g_scales, g_logits, g_sh, threads,
        ),
    )  # fmt: skip
    timed("SSIM and its gradient", lambda: ssim_gradient(image, image[::-1].copy()))
    return seconds


def _forward(scene: Scene) -> object:
    return render(scene.splats, scene.camera)


def _both(scene: Scene) -> object:
    drawing = draw(scene.splats, scene.camera)
    return gradients(drawing, scene.splats, scene.image_gradient)


def compare(scene: Scene, turns: int, torch_turns: int) -> dict[str, tuple[float, float | None]]:
    """Median seconds of ours and of torch's (None without torch), forward and with gradients."""
    arguments = (scene.splats, scene.camera, BLACK, OPTIONS)
    contenders: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
        "forward": (lambda: _forward(scene), lambda: render_torch(*arguments)),
        "forward and backward": (
            lambda: _both(scene),
            lambda: render_torch_gradients(*arguments, scene.image_gradient),
        ),
    }
    has_torch = importlib.util.find_spec("torch") is not None
    results: dict[str, tuple[float, float | None]] = {}
    tiny = Scene.of(100, 32)
    for name, (ours, theirs) in contenders.items():
        ours()
        if has_torch:
            render_torch(tiny.splats, tiny.camera, BLACK, OPTIONS)
        # Turns of both alternate, so that a busy machine slows both.
        times: list[float] = []
        torch_times: list[float] = []
        for _ in range(torch_turns):
            times += [_seconds(ours) for _ in range(-(-turns // torch_turns))]
            torch_times += [_seconds(theirs)] if has_torch else []
        results[name] = (
            float(np.median(times)),
            float(np.median(torch_times)) if torch_times else None,
        )
    return results


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def memory(scene: Scene, turns: int) -> tuple[float, float]:
    """MB of resident memory at their highest, after the first turns and after all of them."""
    peaks = []
    for turn in range(turns):
        _both(scene)
        if turn in (4, turns - 1):
            peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return peaks[0], peaks[-1]


def main() -> int:
    """Print all tables; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--splats", type=int, default=100_000)
    parser.add_argument("--size", type=int, default=800)
    parser.add_argument("--turns", type=int, default=9)
    parser.add_argument("--torch-turns", type=int, default=1)
    args = parser.parse_args()
    scene = Scene.of(args.splats, args.size)
    drawing = draw(scene.splats, scene.camera)
    print(f"{args.splats} splats, {args.size} x {args.size} pixels, {n_threads()} threads")
    print(drawing.counts)
    for name, seconds in stages(scene, args.turns).items():
        print(f"{name:24s}{seconds * 1e3:9.1f} ms")
    before, after = memory(scene, 50)
    print(f"peak memory after 5 and 50 turns: {before:.0f} MB, {after:.0f} MB")
    for name, (ours, theirs) in compare(scene, args.turns, args.torch_turns).items():
        against = (
            "no torch to compare with"
            if theirs is None
            else f"torch {theirs * 1e3:9.1f} ms, ratio {theirs / ours:.1f}"
        )
        print(f"{name:24s}{ours * 1e3:9.1f} ms, {against}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
