"""A trained tree: bytes per leaf of the presets, and the bound of near-lossless coding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from evogs_codec import PRESETS, EvolutionTree, decode, encode, read_directory
from evogs_codec.decoding.cut import Cut
from evogs_codec.editing.byte_stats import ALPHA_NAMES, bytes_by_group
from evogs_codec.encoding.arrange import arrange
from evogs_codec.model.channels import CLASS_NAMES, GROUP_CHANNELS, GROUPS

__all__ = ["TABLES"]

Rows = list[dict[str, object]]
PARTS = {
    "slots": ("slots",),
    "kinds": ("kinds",),
    "alpha": ALPHA_NAMES,
    **{name: (name,) for name in CLASS_NAMES},
}


def presets(tree: EvolutionTree) -> Rows:
    """Bytes per leaf, in all and per group, of each preset."""
    raw = sum(step.psi.nbytes + step.alpha.nbytes + step.adds.nbytes for step in tree.steps)
    rows: Rows = []
    for name in ("trained", "paper", "near-lossless"):
        data = memoryview(encode(tree, PRESETS[name]))
        found = bytes_by_group(read_directory(data), data)
        n = tree.n_leaves
        parts = {part: sum(found[name].n_bytes for name in of) for part, of in PARTS.items()}
        rows.append(
            {
                "preset": name,
                "bytes a leaf": f"{len(data) / n:.2f}",
                "raw float32 to it": f"{raw / len(data):.1f}",
                **{part: f"{n_bytes / n:.2f}" for part, n_bytes in parts.items() if n_bytes},
            }
        )
    return rows


def replay(tree: EvolutionTree) -> Rows:
    """Largest error at each level of near-lossless coding, in grid units; the bound is 1."""
    data = encode(tree, PRESETS["near-lossless"])
    directory = read_directory(data)
    tiles = [tile for tile in arrange(tree) if tile.steps]
    rows: Rows = []
    for level in range(tree.n_levels):
        state = decode(data, Cut.of_level(directory, level))
        row: dict[str, object] = {"level": level, "leaves": state.n_leaves}
        for group, part in zip(GROUPS, GROUP_CHANNELS, strict=True):
            unit = 2.0 ** -directory.grid_exponents[GROUPS.index(group)]
            worst = 0.0
            for number, tile in enumerate(tiles):
                last, live = np.zeros((0, 0)), np.zeros(0, bool)
                for step, values in zip(tile.steps, tile.states(), strict=True):
                    if step.level > level:
                        break
                    last, live = values.values.copy(), values.live.copy()
                x = state.tiles[number].channels()[part].astype(np.float64)
                if group == "position":
                    x = x + directory.tiles[number]["origin"][:, None]
                worst = max(worst, float(np.abs(x - last[part] / unit)[:, live].max()))
            row[group] = f"{worst:.3f}"
        rows.append(row)
    return rows


TABLES: dict[str, tuple[str, Callable[[EvolutionTree], Rows]]] = {
    "trained": ("A trained tree: bytes a leaf", presets),
    "replay": ("A trained tree, near-lossless: largest error in grid units", replay),
}
