"""Falls: how much worse a prefix is than a shorter one, of scenes with odd statistics."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from evogs_codec import Cut, SplatParams, decode, encode_scene, read_directory
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.framing import background_for
from tools.bench.measure import seconds_text
from tools.bench.page import Rows

__all__ = ["fallen", "falls", "odd_scenes"]

N_SPLATS, SEED = 6_000, 3
OTHERS = ((2_000, 4), (1_500, 5), (25_000, 11))  # splats and seeds on which nothing was tuned
N_VIEWS, PIXELS = 24, 300
FEW_EVERY = 4  # of these views are the few
OF_WHITE = 0.5 / 0.28209479177387814  # SH of band 0


def falls() -> Rows:
    """Prefixes that end with a packet, of `evogs encode` without options.

    Each scene is the demo scene, of so many splats, changed in one way. A fall is from the best
    prefix to a longer one; "of core" looks at the packets of core alone. PSNR is over 24 views of
    300 pixels, or over 6 of them; white splats are before black. Seconds are those of the
    processor. The encoder was tuned on the scenes of 6,000 splats.
    """
    rows: Rows = []
    for n_splats, seed in ((N_SPLATS, SEED), *OTHERS):
        for name, splats in odd_scenes(n_splats, seed):
            start = time.process_time()
            data = encode_scene(splats)
            seconds = time.process_time() - start
            row = {"scene": name, "splats": len(splats), "bytes": len(data)}
            rows.append(row | fallen(data, splats) | {"encode, s": seconds_text(seconds)})
            print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows


def odd_scenes(n_splats: int = N_SPLATS, seed: int = SEED) -> Iterator[tuple[str, SplatParams]]:
    """By name, splats with odd statistics."""
    splats, rng = make_scene(n_splats, seed), np.random.default_rng(seed - SEED)
    logits, sizes = splats.opacity_logits, splats.log_scales
    large, small = rng.random(n_splats) < 0.02, rng.random(n_splats) < 0.4
    yield "as shipped", splats
    yield "all opaque", replace(splats, opacity_logits=_f32(np.full_like(logits, 8.0)))
    haze = rng.normal(-4.0, 0.3, logits.shape)
    yield "all haze", replace(splats, opacity_logits=_f32(haze))
    yield "huge splats", replace(splats, log_scales=_f32(sizes + 2))
    clump = rng.normal(0.0, 0.5, splats.means.shape)
    yield "one dense clump", replace(splats, means=_f32(clump))
    yield "SH degree 0", replace(splats, sh=splats.sh[:, :1])
    yield "far apart", replace(splats, means=_f32(splats.means * 5))
    yield "dots", replace(splats, log_scales=_f32(sizes - 2))
    mixed = np.where(large, -3.0, np.where(small, 8.0, logits))
    of_mixed = sizes + 3.0 * large[:, None] - 1.5 * small[:, None]
    yield "mixed", replace(splats, log_scales=_f32(of_mixed), opacity_logits=_f32(mixed))
    yield "all white", replace(splats, sh=_f32(np.full_like(splats.sh[:, :1], OF_WHITE)))
    yield "black plane", _black_plane(splats, rng)
    few = splats.take(np.arange(0, n_splats, 20))
    yield f"{len(few)} splats", few
    few = splats.take(np.arange(n_splats // 60))
    yield f"{len(few)} huge splats", replace(few, log_scales=_f32(few.log_scales + 3))


def _black_plane(splats: SplatParams, rng: np.random.Generator) -> SplatParams:
    """As many huge black ones: errors of coarse levels add up there."""
    n = len(splats)
    means = np.column_stack([rng.uniform(-5, 5, (n, 2)), np.zeros(n)])
    return replace(
        splats,
        means=_f32(means),
        log_scales=_f32(rng.normal(0.8, 0.3, (n, 3))),
        sh=_f32(np.full((n, 1, 3), -OF_WHITE)),
    )


def _f32(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
    return values.astype(np.float32)


def fallen(data: bytes, splats: SplatParams) -> dict[str, object]:
    """Deepest falls of a stream."""
    cameras = cameras_around(splats, "z", PIXELS, n=N_VIEWS)
    views = Views(splats, cameras, background=background_for(splats))
    directory = read_directory(data)
    is_core = directory.columns == 0
    shown = np.array([np.nan])
    best = np.full(2, -np.inf)  # of all views, and of a few
    deepest = {True: np.zeros(2), False: np.zeros(2)}
    rows = np.flatnonzero(directory.packets["size"] > 0)
    for row in rows.tolist():
        end = int(directory.offsets[row] + directory.packets["size"][row])
        leaves = decode(data, Cut.of_prefix(directory, end)).leaves(sh_degree=splats.sh_degree)
        each = views.psnr_of_each(leaves)
        shown = np.array([each.mean(), each[::FEW_EVERY].mean()])
        for kind in (True, False):
            if is_core[row] or not kind:
                deepest[kind] = np.maximum(deepest[kind], best - shown)
        best = np.maximum(best, shown)
    return {
        "PSNR, dB": f"{shown[0]:.2f}",
        "prefixes": len(rows),
        "deepest fall, dB": f"{deepest[False][0]:.2f}",
        "of core, dB": f"{deepest[True][0]:.2f}",
        "over 6 views, dB": f"{deepest[False][1]:.2f}",
    }
