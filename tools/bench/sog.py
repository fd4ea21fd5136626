"""Size against SOG files at equal pictures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from evogs_codec import EvolutionTree, Step, decode
from evogs_codec.model.components import component_slice
from evogs_codec.render.views import Views
from tools.bench.splat_transform import read_sog, write_sog
from tools.bench.subjects import Subject, aim_of

__all__ = ["published", "sog"]

Rows = list[dict[str, object]]
# Format, scene, SH degree, bytes a splat, what is known of its pictures, who says so.
PUBLISHED = (
    ("SOG", "skate park, 4 M splats", "", "10.5", "", "its authors"),
    ("SOG", "3.34 M splats", "3", "12.9 to 14.4", "", "LichtFeld-Studio, issue 1954"),
    ("SOG", "playbot", "2", "17.0", "the scene itself", "the file it was decoded from"),
    ("Streamed SOG, 7 levels", "playbot", "2", "35.2", "", "its converter"),
    ("L-GSC 1.0, level 0, 1, 2", "playbot", "2", "49.0, 33.5, 29.6", "", "its library, as built"),
    ("L-GSC 1.0, level 0, 1, 2", "biker", "0", "17.0, 12.9, 13.0", "", "its library, as built"),
    ("gsplat, PNG, 1 M", "Mip-NeRF 360", "3", "16.5", "-0.53 dB", "gsplat, pull request 309"),
    ("RAD, gzip; Zstandard 9", "18.3 M splats, a tree", "3", "35.6; 25.7", "", "Spark, issue 433"),
    ("HAC++, low; high", "Mip-NeRF 360", "", "12.8; 10.5", "27.60; 27.82 dB", "a survey"),
)


def sog(of: Iterable[Subject], command: str, folder: Path) -> Rows:
    """Streams with all levels, aimed at the PSNR of the SOG file of the same leaves.

    Of SH degree 0: to find the palette of the higher bands, splat-transform takes a processor more
    than 8 minutes for 40,000 splats.
    """
    rows: Rows = []
    for subject in of:
        tree = _without_bands(subject.tree)
        views = Views(tree.leaves(), subject.views.cameras)
        plain = Subject.of_tree(subject.name, tree, subject.settings, views)
        path = write_sog(command, tree.leaves(), folder / f"{subject.name}.sog")
        theirs, _ = plain.gauge(read_sog(command, path))
        data = aim_of(tree, subject.settings, plain.views).at_psnr(theirs)
        ours, _ = plain.gauge(decode(data).leaves(sh_degree=0))
        for name, n_bytes, decibels in (
            ("SOG", path.stat().st_size, theirs),
            (f"evogs --target-psnr {theirs:.2f}", len(data), ours),
        ):
            rows.append(
                {
                    "scene": subject.name,
                    "stream": name,
                    "bytes a splat": f"{n_bytes / tree.n_leaves:.2f}",
                    "PSNR, dB": f"{decibels:.2f}",
                    "to SOG": f"{n_bytes / path.stat().st_size:.2f}",
                }
            )
    return rows


def published() -> Rows:
    """Figures of others that no command here remakes.

    Published by those in the last column, or measured with their programs on another day. Scenes
    differ, and with them what a splat needs. The scene playbot was itself decoded from SOG: its SH
    are those of a palette, its scales and colours those of codebooks.
    """
    columns = ("format", "scene", "SH degree", "bytes a splat", "pictures", "who says so")
    return [dict(zip(columns, row, strict=True)) for row in PUBLISHED]


def _without_bands(tree: EvolutionTree) -> EvolutionTree:
    """The tree of SH degree 0."""
    core = component_slice(0)
    steps = tuple(
        Step(step.level, step.slots, step.kinds, step.psi[core], step.alpha, step.adds[core])
        for step in tree.steps
    )
    return EvolutionTree(0, steps)
