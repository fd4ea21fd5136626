"""Curves of PSNR against coded bytes: trees in integers, layers at several prices of a bit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from evogs_codec import (
    PRESETS,
    Cut,
    EvolutionTree,
    decode,
    encode,
    extract,
    read_directory,
)
from evogs_codec.render import cameras_around
from evogs_codec.render.viewpoints import SIZE
from evogs_codec.render.views import Views as EncodingViews
from reference_trainer.config import Config, Integers
from reference_trainer.queue import Job
from tools.bench.coded.bd_rate import Curve, at_worst, bd_rate
from tools.bench.paper.runs import TITLES, Run, Views
from tools.bench.subjects import aim_of

__all__ = ["coded_levels", "curve_jobs", "curve_of", "distances", "streams"]

ERRORS = (36.0, 40.0, 44.0, 48.0)  # about the dB of a stream against its tree in floats
Rows = list[dict[str, Any]]


def curve_jobs(config: Config, methods: Sequence[str], distortions: Sequence[float]) -> list[Job]:
    """A shared level 0; of trees a run for each distortion, of all others one in floats."""
    floats = replace(config, integers=Integers())
    first = replace(floats, iterations=config.iterations[:1], max_splats=config.max_splats[:1])
    found = [Job("level0", replace(first, method="mono"), config.n_levels, shares=False)]
    for method in methods:
        if method.startswith("evogs"):
            for distortion in distortions:
                integers = replace(config.integers, distortion=distortion)
                own = replace(config, method=method, integers=integers)
                found.append(Job(f"coded-{method}-{distortion:g}", own, config.n_levels, True))
        else:
            own, shares = replace(floats, method=method), method == "lapis"
            found.append(Job(f"coded-{method}", own, config.n_levels, shares))
    return found


def streams(tree: EvolutionTree) -> Iterator[tuple[str, bytes]]:
    """Streams of a tree by the names of their points: its integers, or several prices of a bit."""
    if tree.quanta:
        yield "integers", encode(tree)
        return
    leaves = tree.leaves()
    views = EncodingViews(leaves, cameras_around(leaves, "z", SIZE))
    aim = aim_of(tree, PRESETS["trained"], views)
    n = sum(step.psi.size + step.adds.size for step in tree.steps)
    for decibels in ERRORS:
        # An error of D takes n / 2 log2(1 / D) bits: what a bit saves is D / n, nearly.
        yield f"{decibels:g} dB", aim.at_price(10 ** (-decibels / 10) / max(n, 1))


def coded_levels(views: Views, run: Run) -> Rows:
    """A row for every stream of a run and level: bytes up to that level, PSNR, splats."""
    rows: Rows = []
    for point, data in streams(run.tree()):
        directory = read_directory(data)
        for level in range(len(views.pyramid)):
            cut = Cut.of_level(directory, min(level, directory.n_levels - 1))
            leaves = decode(data, cut).leaves(sh_degree=directory.sh_degree)
            rows.append(
                {
                    "point": point,
                    "level": level,
                    "bytes": len(extract(data, cut)),
                    "psnr": views.psnr(leaves, level),
                    "splats": len(leaves),
                }
            )
    return rows


def distances(rows: Rows, of: str, rivals: Iterable[Sequence[str]]) -> Rows:
    """BD-rates of a method against rivals, each several methods of which the best counts.

    A row for each rival, with two columns for every level above 0: the BD-rate, and bytes at the
    PSNR where they compare worst. None where curves share no PSNR or do not rise.
    """
    levels = sorted({row["level"] for row in rows} - {0})
    out: Rows = []
    for names in rivals:
        found: dict[str, Any] = {
            "method": TITLES[of],
            "against": " or ".join(TITLES[name] for name in names),
        }
        for level in levels:
            curves = [curve_of(rows, method, level) for method in (of, *names)]
            mean, worst = f"L{level} BD-rate, %", f"L{level} at worst, %"
            found |= {mean: None, worst: None}
            with suppress(ValueError):
                found |= {mean: bd_rate(*curves), worst: at_worst(*curves)}
        out.append(found)
    return out


def curve_of(rows: Rows, method: str, level: int) -> Curve:
    """Bytes and PSNR of a method at a level."""
    return [
        (row["bytes"], row["psnr"])
        for row in rows
        if (row["method"], row["level"]) == (method, level)
    ]
