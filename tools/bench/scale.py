"""Time and memory of lifting, encoding and decoding as scenes grow, a process for each.

A scene of n splats is copies of the procedural one side by side, every splat moved and recoloured a
little: neighbours, sizes and colours are those of a scene, and no two copies are the same.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from evogs_codec import SplatParams
from evogs_codec.model.channels import n_channels
from evogs_codec.render.demo_scene import make_scene
from tools.bench.measure import cost
from tools.bench.page import Rows

__all__ = ["scale", "tiled"]

SIZES = (100_000, 1_000_000, 10_000_000)  # splats
COPY = 40_000  # splats
SH_DEGREE = 1
MOVED, RECOLOURED = 0.1, 0.01  # standard deviations: in those of a splat, in SH 0
IMPORTS = (
    "import evogs_codec.cli.commands, evogs_codec.decoding.compiled.channels, tools.bench.scale"
)
LIFT = "tree = evogs_codec.lift(splats, 5)"
ENCODE = "data = evogs_codec.encode(tree, evogs_codec.PRESETS['scene'])"
DECODE = "leaves = evogs_codec.decode_leaves(data)"


def scale(folder: Path) -> Rows:
    """Lifting, encoding and decoding to float arrays, of more and more splats.

    Copies of the procedural scene at SH degree 1, five levels, preset `scene`. Memory is the peak
    above a process that only imports what it needs, the input of the stage included; from 50,000
    splats on decoding loads compiled loops, about 50 MiB and 0.2 s. Seconds are those of the
    processor, of all threads together: a busy machine changes them least.
    """
    base = cost("", IMPORTS).peak
    rows: Rows = []

    def measure(stage: str, n: int, code: str, before: str, after: str = "") -> None:
        print(f"{stage} {n}", file=sys.stderr)
        found = cost(code, f"{IMPORTS}\n{before}", after)
        above = found.peak - base
        rows.append(
            {
                "stage": stage,
                "splats": n,
                "processor s": f"{found.processor:.2f}",
                "us a splat": f"{1e6 * found.processor / n:.2f}",
                "peak MiB": f"{above / 2**20:.0f}",
                "bytes a splat": f"{above / n:.0f}",
                "to the float arrays": f"{above / (4 * n_channels(SH_DEGREE) * n):.2f}",
            }
        )

    tree, stream = (str(folder / f"scale.{end}") for end in ("tree.npz", "evogs"))
    for n in SIZES:
        made = f"splats = tools.bench.scale.tiled({n})"
        measure("lift", n, LIFT, made, f"evogs_codec.write_tree({tree!r}, tree)")
        read = f"tree = evogs_codec.read_tree({tree!r})"
        measure("encode", n, ENCODE, read, f"open({stream!r}, 'wb').write(data)")
        measure("decode", n, DECODE, f"data = open({stream!r}, 'rb').read()")
    return rows


def tiled(n: int) -> SplatParams:
    """The splats of copies of the procedural scene, on a square grid."""
    source, rng = make_scene(COPY), np.random.default_rng(0)
    n_copies = -(-n // COPY)
    side = int(np.ceil(np.sqrt(n_copies)))
    low, high = np.percentile(source.means, (1, 99), axis=0)
    copy, row = np.divmod(np.arange(n), COPY)  # of each splat
    splats = source.take(row)
    radius = np.exp(splats.log_scales.mean(axis=1, keepdims=True))
    cell = np.stack([copy // side, copy % side, 0 * copy], axis=1) * (high - low)
    moved = splats.means + cell + MOVED * radius * rng.standard_normal((n, 3))
    sh = splats.sh[:, : (SH_DEGREE + 1) ** 2].copy()
    sh[:, 0] += RECOLOURED * rng.standard_normal((n, 3)).astype(np.float32)
    return SplatParams(
        moved.astype(np.float32), splats.quats, splats.log_scales, splats.opacity_logits, sh
    )
