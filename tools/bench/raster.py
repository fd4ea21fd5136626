"""The rasterizer: time of its stages, of the calls a trainer makes, against torch; its memory.

100,000 random ellipsoids of SH degree 3 on 800 x 800 pixels, unless a table says otherwise. All
contenders of a table take turns in one process. torch is optional.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams
from evogs_codec.model.splats import F32
from evogs_codec.render import Camera, Options, draw, gradients, orbit, render, ssim_gradient
from evogs_codec.render import projection as p
from evogs_codec.render.activation import ACTIVE, activate
from evogs_codec.render.blending import blend, constants_of
from evogs_codec.render.blending_gradient import ENTRY, add_up, blend_gradient
from evogs_codec.render.compiled import n_threads
from evogs_codec.render.projection_gradient import project_gradient
from evogs_codec.render.spans import SPAN
from evogs_codec.render.splats import Real
from evogs_codec.render.tiles import Tiles, depth_order
from tools.bench.measure import peak_memory, take_turns
from tools.bench.raster_torch import render_torch, render_torch_gradients

__all__ = ["TABLES", "Scene", "draw_often"]

Rows = list[dict[str, object]]
Result = TypeVar("Result")

N_SPLATS, SIZE = 100_000, 800
TURNS, TORCH_TURNS = 15, 3
# Pixels to a side, splats and turns of what a trainer repeats ten thousands of times.
CALLS = ((16, 20, 1000), (50, 2_000, 300), (100, 5_000, 200), (200, 20_000, 60), (400, 100_000, 20))
FORWARD = ("activate", "project", "sort", "count", "fill", "blend")
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


def stages() -> Rows:
    """Every stage of a drawing and its gradients."""
    scene = Scene.of(N_SPLATS, SIZE)
    turns = [_one_turn(scene) for _ in range(TURNS + 1)][1:]
    median = {name: float(np.median([turn[name] for turn in turns])) for name in turns[0]}
    forward = sum(median[name] for name in FORWARD)
    return [
        {
            "stage": name,
            "ms": f"{1000 * seconds:.1f}",
            "least ms": f"{1000 * min(turn[name] for turn in turns):.1f}",
            "to forward": f"{seconds / forward:.2f}",
        }
        for name, seconds in median.items()
    ]


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
    spans, active = np.empty((n, SPAN), np.int16), np.empty((n, ACTIVE))
    timed(
        "activate",
        lambda: activate(s.quats, s.log_scales, s.opacity_logits, active, threads),
    )
    timed(
        "project",
        lambda: p.project(
            s.means,
            active,
            s.sh,
            view,
            False,
            *shape[::-1],
            records,
            rows,
            spans,
            depths,
            status,
            threads,
        ),
    )
    order = timed("sort", lambda: depth_order(depths, status))
    tiles = timed("count", lambda: Tiles.of(records, rows, spans, order, *shape[::-1]))
    (chunk,) = timed("fill", lambda: list(tiles.chunks()))
    lists = (chunk.first, tiles.columns, chunk.offsets, chunk.entries, chunk.order, records, rows)
    constants = constants_of(OPTIONS, np.float32)
    image, t = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
    last = np.empty(shape, np.int32)
    timed("blend", lambda: blend(*lists, color, constants, image, t, last, threads))
    entries = np.empty((len(chunk.entries), len(ENTRY)), np.float32)
    g = scene.image_gradient
    timed(
        "blend, backwards",
        lambda: blend_gradient(*lists, color, constants, g, t, last, entries, threads),
    )
    sums = np.zeros((n, len(ENTRY)))
    timed("add up", lambda: add_up(chunk.offsets, chunk.block_ends, chunk.entries, entries, sums))
    g_means, g_quats, g_scales, g_logits, g_sh = (np.empty_like(array) for array in arrays)
    timed(
        "project, backwards",
        lambda: project_gradient(
            s.means, s.quats, s.opacity_logits, s.sh, active, view, False, records, status, sums,
            g_means, g_quats, g_scales, g_logits, g_sh, threads,
        ),
    )  # fmt: skip
    timed("SSIM and its gradient", lambda: ssim_gradient(image, image[::-1].copy()))
    return seconds


def against_torch() -> Rows:
    """Ours and torch's turns alternate; the ratios are of medians and of the least times."""
    scene = Scene.of(N_SPLATS, SIZE)
    arguments = (scene.splats, scene.camera, BLACK, OPTIONS)
    return [
        _against(
            "forward",
            lambda: render(scene.splats, scene.camera),
            lambda: render_torch(*arguments),
        ),
        _against(
            "forward and backward",
            lambda: _draw_and_gradients(scene),
            lambda: render_torch_gradients(*arguments, scene.image_gradient),
        ),
    ]


def _against(
    name: str, ours: Callable[[], object], theirs: Callable[[], object]
) -> dict[str, object]:
    ours()
    has_torch = importlib.util.find_spec("torch") is not None
    if has_torch:
        theirs()
    times: list[float] = []
    torch_times: list[float] = []
    for _ in range(TORCH_TURNS):
        times += [_seconds(ours) for _ in range(TURNS // TORCH_TURNS)]
        torch_times += [_seconds(theirs)] if has_torch else []
    median = float(np.median(times))
    row: dict[str, object] = {"what": name, "ms": f"{1000 * median:.1f}"}
    if has_torch:
        row["torch, ms"] = f"{1000 * float(np.median(torch_times)):.0f}"
        row["torch to ours"] = f"{float(np.median(torch_times)) / median:.1f}"
        row["least to least"] = f"{min(torch_times) / min(times):.1f}"
    else:
        row["torch, ms"] = "torch is not installed"
    return row


def calls() -> Rows:
    """Drawing, SSIM and all gradients, as often and as small as in training."""
    rows: Rows = []
    for size, n, turns in CALLS:
        scene = Scene.of(n, size)
        target = render(scene.splats, scene.camera)[::-1].copy()
        seconds = take_turns(
            {
                "forward": partial(render, scene.splats, scene.camera),
                "all": partial(_train_once, scene, target),
            },
            turns,
        )
        rows.append(
            {
                "pixels": f"{size} x {size}",
                "splats": n,
                "forward, ms": f"{1000 * seconds['forward']:.2f}",
                "forward, SSIM, backward, ms": f"{1000 * seconds['all']:.2f}",
            }
        )
    return rows


def memory() -> Rows:
    """Peak memory of processes of their own that draw and differentiate few times or many."""
    base, _ = peak_memory("import tools.bench.raster")
    rows: Rows = []
    for turns in (1, 5, 50):
        peak, _ = peak_memory(f"from tools.bench.raster import draw_often\ndraw_often({turns})")
        rows.append(
            {
                "pictures and gradients": turns,
                "peak MiB": f"{peak / 2**20:.0f}",
                "above imports, MiB": f"{(peak - base) / 2**20:.0f}",
            }
        )
    return rows


def draw_often(turns: int) -> None:
    """What `memory` measures."""
    scene = Scene.of(N_SPLATS, SIZE)
    for _ in range(turns):
        _draw_and_gradients(scene)


def _draw_and_gradients(scene: Scene) -> object:
    return gradients(draw(scene.splats, scene.camera), scene.splats, scene.image_gradient)


def _train_once(scene: Scene, target: Real) -> object:
    drawing = draw(scene.splats, scene.camera)
    _, image_gradient = ssim_gradient(drawing.image, target)
    return gradients(drawing, scene.splats, image_gradient)


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


_OF = f"{N_SPLATS:,} splats, {SIZE} x {SIZE} pixels"
TABLES: dict[str, tuple[str, Callable[[], Rows]]] = {
    "raster": (f"Rasterizer: time of every stage, {_OF}", stages),
    "raster-torch": (f"Rasterizer, to the same in vectorised torch, {_OF}", against_torch),
    "raster-calls": ("Rasterizer: time of a call", calls),
    "raster-memory": (f"Rasterizer: memory, {_OF}", memory),
}
