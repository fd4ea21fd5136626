"""The benchmarks: size, accuracy, time and memory, beside what they are measured against.

Every time is the median of several turns taken one after the other by all contenders of a table, so
that a busy machine slows all of them, or processor time, where the table says so. Results:
`docs/figures/*.csv` and `docs/figures.md`, of which `--only` leaves the other tables as they are.
`extremes` is a page of its own, `docs/extremes.md`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from evogs_codec import SplatParams, read_ply, read_tree
from evogs_codec.render.demo_scene import make_scene
from tools.bench import pictures, raster, trained
from tools.bench.alone import alone
from tools.bench.before import before
from tools.bench.city import city
from tools.bench.decimate import decimate
from tools.bench.depth import depth
from tools.bench.extremes import page as extremes
from tools.bench.falls import falls
from tools.bench.inputs import inputs
from tools.bench.landscape import landscape
from tools.bench.large import large
from tools.bench.loss import Losses, scene_without_bands
from tools.bench.page import Rows, text_of, write
from tools.bench.parts import PARTS
from tools.bench.prefix import prefixes, rivals
from tools.bench.refine import refined
from tools.bench.refused import refused
from tools.bench.scale import scale
from tools.bench.small_targets import small_targets
from tools.bench.sog import published, sog
from tools.bench.subjects import Subject, subjects
from tools.bench.surface import tables as surface
from tools.bench.targets import targets
from tools.bench.worst import worst

OF_SUBJECTS = {
    *("rate", "sog", "surface", "prefix", "loss", "alone", "first", "stream"),
    *("decimate", "depth", "effort", "before", "targets", "refused"),
}
Measurement = tuple[str, str, Callable[[], Rows]]  # name, title, what measures it


def run(args: argparse.Namespace) -> int:
    """Measure what was asked for and write the page; returns the exit code."""
    tables: dict[str, tuple[str, str, Rows]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, title, measure in _measurements(args, Path(folder)):
            print(f"{name} ...", file=sys.stderr)
            tables[name] = (title, text_of(measure), measure())
    turned = f" --up={args.up}" if args.up != "z" else ""
    some = "" if args.only == PARTS else f" --only {' '.join(args.only)}"
    command = f"python -m tools.bench{some}{turned}" + "".join(
        f" --{key} {getattr(args, key).name}"
        for key in ("ply", "tree", "photos", "runs")
        if getattr(args, key)
    )
    command += " --before CHECKOUT" if args.before else ""
    command += f" --tries {args.tries}" if args.tries else ""
    command += f" --rows {' '.join(args.rows)}" if args.rows else ""
    command += " --splat-transform CMD" if args.splat_transform else ""
    if tables:
        write(args.out, command, tables, keep_others=bool(some))
    holds = "extremes" not in args.only or extremes.remake(args.out)
    return 0 if holds else 1


def _measurements(args: argparse.Namespace, folder: Path) -> Iterator[Measurement]:
    """What was asked for, in the order of the page."""
    if "raster" in args.only:  # first, while the process is small
        for name, (title, run) in raster.TABLES.items():
            yield name, title, run
    if {"scene", "levels", "inputs"} & set(args.only):
        splats = read_ply(args.ply) if args.ply else make_scene()
    if "scene" in args.only:
        from tools.bench import scene  # needs gsply, which nothing else does

        for name, (title, measure) in scene.TABLES.items():
            yield name, title, partial(measure, splats, folder)
    if "levels" in args.only:
        title = "Pictures of the levels, against the scene, over 24 views"
        yield "levels", title, partial(_levels, args, splats)
    if "refine" in args.only:
        title = "Refined levels, of streams with the preset scene, over 24 views"
        yield "refine", title, partial(refined, args.ply, args.up)
    if "tree" in args.only and args.tree:
        tree = read_tree(args.tree)
        for name, (title, of_tree) in trained.TABLES.items():
            yield name, title, partial(of_tree, tree)
        if args.photos:
            title = "Pictures of a trained tree, on photographs it was not trained on"
            yield "photographs", title, partial(pictures.photographs, tree, args.photos)
    if OF_SUBJECTS & set(args.only):
        yield from _of_subjects(args, folder)
    if "inputs" in args.only:
        title, name = (
            "Encoding from files of other programs",
            args.ply.stem if args.ply else "shipped",
        )
        yield "inputs", title, partial(inputs, name, splats, folder)
    if "falls" in args.only:
        yield "falls", "Falls from prefix to prefix, of odd scenes", falls
    if "small" in args.only:
        yield "small", "Encodes of small, odd scenes with a target", small_targets
    if "scale" in args.only:
        yield "scale", "Time and memory as scenes grow", partial(scale, folder)
    if "large" in args.only:
        yield "large", "Scenes that are encoded tile by tile", partial(large, folder)
    if "city" in args.only:
        yield "city", "An object of 5 cm in a kilometre of city", partial(city, folder)
    if "landscape" in args.only:
        yield "landscape", "An object in a landscape", landscape
    if "worst" in args.only:
        title = "Worst cases of 100,000 bytes"
        yield "worst", title, partial(worst, args.before, args.tries, args.rows)


def _of_subjects(args: argparse.Namespace, folder: Path) -> Iterator[Measurement]:
    """What takes trees and their pictures: of the scene, and of the tree if there is one."""
    of, command = tuple(subjects(args)), args.splat_transform
    shipped: tuple[Subject, ...] = ()
    if args.ply and (OF_SUBJECTS - {"sog", "first"}) & set(args.only):
        shipped = (Subject.of_scene("shipped", make_scene(), "z"),)
    if {"rate", "first"} & set(args.only):
        from tools.bench.first import first  # these need gsply
        from tools.bench.rate import rate
    if "rate" in args.only:
        yield "rate", "Size against pictures, over 24 views", partial(rate, (*shipped, *of), folder)
    if "sog" in args.only:
        if command:
            title = "Size against SOG, SH degree 0, over 24 views"
            yield "sog", title, partial(sog, of, command, folder)
        yield "published", "Figures of others, as published or measured before", published
    if "surface" in args.only:
        yield from surface.measurements((*shipped, *of), args.runs)
    if "prefix" in args.only:
        title = "Quality against bytes, at 20 cuts"
        yield "prefix", title, partial(prefixes, rivals((*shipped, *of), args.runs))
    if {"prefix", "loss"} & set(args.only):
        losses = Losses(lambda: (*shipped, scene_without_bands(), *of), folder)
        yield "loss", "What prefixes lose, over 24 views", losses.table
        yield "loss-curves", "Prefixes and dedicated streams, at 20 cuts", losses.curves
    if "alone" in args.only:
        title = "Levels and layers beside the splats alone"
        yield "alone", title, partial(alone, (*shipped, scene_without_bands(), *of))
    if "depth" in args.only:
        title = "Levels of small scenes"
        yield "depth", title, partial(depth, (*shipped, *of))
    if "first" in args.only:
        yield "first", "Time to the first picture", partial(first, of, folder)
    if "stream" in args.only:
        from tools.bench.moves import moves  # these need gsply
        from tools.bench.stream import Streams

        streams = Streams(lambda: (*shipped, *of), folder)
        yield "stream", "Streams over replayed connections", streams.table
        yield "stream-curves", "PSNR after seconds of replayed connections", streams.curves
        title = "Streams while the camera moves"
        yield "stream-moves", title, partial(moves, (*shipped, *of), folder)
    if "effort" in args.only:
        from tools.bench.effort import effort  # needs gsply

        scenes = [one for one in (*shipped, *of) if one.lifted is not None]
        yield "effort", "Efforts of the encoder", partial(effort, scenes, folder)
    if "before" in args.only and args.before:
        title = "Encoding beside an earlier checkout"
        yield "before", title, partial(before, (*shipped, *of), args.before, folder)
    if "targets" in args.only:
        yield "targets", "Encodes with a target", partial(targets, (*shipped, *of), folder)
    if "refused" in args.only:
        title = "Targets that cannot be met"
        yield "refused", title, partial(refused, (*shipped, scene_without_bands(), *of), folder)
    if "decimate" in args.only and command:
        title = "Coarse levels against decimation, over 24 views"
        yield "decimate", title, partial(decimate, (of[0], *shipped), command, folder)


def _levels(args: argparse.Namespace, splats: SplatParams) -> Rows:
    """Those of the shipped scene too, if another was named."""
    rows = pictures.levels(splats, args.ply.stem, args.up) if args.ply else []
    return rows + pictures.levels(make_scene(), "shipped", "z")
