"""Coarse levels against decimation: as many splats, merged with and without a tree to keep."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from evogs_codec import Cut, decode, read_directory, write_ply
from evogs_codec.cli.options import DEFAULT_ITERATIONS
from reference_trainer.distil.refining import refine
from tools.bench.free_parents import free_levels
from tools.bench.splat_transform import decimated
from tools.bench.subjects import Subject

__all__ = ["decimate"]

Rows = list[dict[str, object]]


def decimate(of: Sequence[Subject], command: str, folder: Path) -> Rows:
    """PSNR of the levels of a lifted scene and of splat-transform's decimation to as many splats.

    Over 24 views of the scene. Decimation merges pairs too, but each of its files stands alone.
    Free parents are our pairs with parents that no tree can keep: what decimation has beyond them
    is its choice of pairs. Refined levels are those of `evogs lift --refine`, which descends on
    other views. The last columns are what our levels have more.
    """
    return [row for subject in of for row in _levels(subject, command, folder)]


def _levels(subject: Subject, command: str, folder: Path) -> Iterator[dict[str, object]]:
    """Every level but the last."""
    ply = folder / f"{subject.name}.decimate.ply"
    write_ply(ply, subject.views.scene)
    tree, data = subject.tree, subject.stream
    directory = read_directory(data)
    free = free_levels(tree)
    better = refine(tree, None, subject.up, DEFAULT_ITERATIONS, lambda *_: None)
    shown = subject.shared(better) or better
    for level in range(tree.n_levels - 1):
        lifted = subject.best.leaves(level)
        theirs = decimated(command, ply, len(lifted))
        found = {
            "decoded": decode(data, Cut.of_level(directory, level)).leaves(),
            "lifted": lifted,
            "refined": shown.leaves(level),
            "free parents": free[level],
            "decimation": theirs,
        }
        decibels = {name: subject.gauge(splats)[0] for name, splats in found.items()}
        over = {name: decibels[name] - decibels["decimation"] for name in ("lifted", "refined")}
        yield {
            "scene": subject.name,
            "level": level,
            "splats": len(lifted),
            "decimated": len(theirs),
            **{f"{name}, dB": f"{value:.2f}" for name, value in decibels.items()},
            **{f"{name} over decimation, dB": f"{more:+.2f}" for name, more in over.items()},
        }
