"""`python -m tools.bench`: size, accuracy, time and memory, beside what they are measured against.

Every time is the median of several turns taken one after the other by all contenders of a row, in
one process, so that a busy machine slows all of them. Results: `docs/figures/*.csv` and
`docs/figures.md`, of which `--only` leaves the other tables as they are. `extremes` is a page of
its own, `docs/extremes.md`.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from evogs_codec import SplatParams, read_ply, read_tree
from reference_trainer.hardware import machine
from tools.bench import pictures, raster, trained
from tools.bench.entropy import tables as entropy
from tools.extremes import page as extremes
from tools.scene import make_scene

ROOT = Path(__file__).resolve().parent.parent.parent
Rows = list[dict[str, object]]
Measurement = tuple[str, str, Callable[[], Rows]]  # name, title, what measures it
PARTS = ("raster", "scene", "rate", "levels", "tree", "entropy", "extremes")


def main() -> int:
    """Run the benchmarks that were asked for; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n")[0],
        epilog="example: python -m tools.bench --ply scene.ply --tree lego.tree.npz --photos lego",
    )
    parser.add_argument("--ply", type=Path, help="a scene (default: the one of tools.scene)")
    parser.add_argument("--tree", type=Path, help="a trained .tree.npz (default: none)")
    parser.add_argument("--photos", type=Path, help="NeRF-synthetic folder of the tree")
    parser.add_argument("--up", default="z", help="up axis of the scene, as -y (default: z)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the results")
    parser.add_argument("--only", choices=PARTS, nargs="+", default=PARTS, help="some tables")
    args = parser.parse_args()
    tables: dict[str, tuple[str, Rows]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, title, measure in _measurements(args, Path(folder)):
            print(f"{name} ...", file=sys.stderr)
            tables[name] = (title, measure())
    turned = f" --up={args.up}" if args.up != "z" else ""
    some = "" if args.only == PARTS else f" --only {' '.join(args.only)}"
    command = f"python -m tools.bench{some}{turned}" + "".join(
        f" --{key} {path.name}"
        for key, path in (("ply", args.ply), ("tree", args.tree), ("photos", args.photos))
        if path
    )
    if tables:
        write(args.out, command, tables, keep_others=bool(some))
    holds = "extremes" not in args.only or extremes.remake(args.out)
    return 0 if holds else 1


def _measurements(args: argparse.Namespace, folder: Path) -> Iterator[Measurement]:
    """What was asked for, in the order of the page."""
    if "raster" in args.only:  # first, while the process is small
        for name, (title, run) in raster.TABLES.items():
            yield name, title, run
    if {"scene", "levels", "rate"} & set(args.only):
        splats = read_ply(args.ply) if args.ply else make_scene()
    if "scene" in args.only:
        from tools.bench import scene  # needs gsply, which nothing else does

        for name, (title, measure) in scene.TABLES.items():
            yield name, title, partial(measure, splats, folder)
    if "rate" in args.only:
        from tools.bench import rate

        name = args.ply.stem if args.ply else "shipped"
        title = "Size against pictures, over 24 views"
        yield "rate", title, partial(rate.rate, splats, name, args.up, folder)
    if "levels" in args.only:
        title = "Pictures of the levels, against the scene, over 24 views"
        yield "levels", title, partial(_levels, args, splats)
    if "tree" in args.only and args.tree:
        tree = read_tree(args.tree)
        for name, (title, of_tree) in trained.TABLES.items():
            yield name, title, partial(of_tree, tree)
        if args.photos:
            title = "Pictures of a trained tree, on photographs it was not trained on"
            yield "photographs", title, partial(pictures.photographs, tree, args.photos)
    if "entropy" in args.only:
        for name, (title, of_samples) in entropy.TABLES.items():
            yield name, title, partial(of_samples, entropy.samples(args.ply, args.tree))


def _levels(args: argparse.Namespace, splats: SplatParams) -> Rows:
    """Those of the shipped scene too, if another was named."""
    rows = pictures.levels(splats, args.ply.stem, args.up) if args.ply else []
    return rows + pictures.levels(make_scene(), "shipped", "z")


def write(
    out: Path, command: str, tables: dict[str, tuple[str, Rows]], *, keep_others: bool
) -> None:
    """One CSV file per table, and a page with all of them."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    path = out / "figures.md"
    made = f"Made by `{command}` on {machine()}."
    head, sections = _read_page(path) if keep_others else (f"# Figures\n\n{made}", {})
    for name, (title, rows) in tables.items():
        with (out / "figures" / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        lines = ([made, ""] if keep_others else []) + markdown(rows)
        sections[title] = "\n".join(lines)
    body = [f"## {title}\n\n{text}" for title, text in sections.items()]
    path.write_text("\n\n".join([head, *body]) + "\n", encoding="utf-8")


def _read_page(path: Path) -> tuple[str, dict[str, str]]:
    """What stands before the first section, and the text below each title."""
    head, *sections = path.read_text(encoding="utf-8").split("\n## ")
    titled = (section.split("\n", 1) for section in sections)
    return head.strip(), {title: text.strip() for title, text in titled}


def markdown(rows: Rows) -> list[str]:
    """Lines of a table."""
    head = list(rows[0])
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(str(row[key]) for key in head) + " |" for row in rows]


if __name__ == "__main__":
    sys.exit(main())
