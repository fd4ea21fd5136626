"""`python -m tools.bench`: size, accuracy, time and memory, beside what they are measured against.

Every time is the median of several turns taken one after the other by all contenders of a row, in
one process, so that a busy machine slows all of them. Results: `docs/figures/*.csv` and
`docs/figures.md`.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import sys
import tempfile
from pathlib import Path

from evogs_codec import read_ply, read_tree
from tools.bench import pictures, scene, trained
from tools.scene import make_scene

ROOT = Path(__file__).resolve().parent.parent.parent
Rows = list[dict[str, object]]


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
    args = parser.parse_args()
    tables: dict[str, tuple[str, Rows]] = {}
    with tempfile.TemporaryDirectory() as folder:
        splats = read_ply(args.ply) if args.ply else make_scene()
        for name, (title, run) in scene.TABLES.items():
            print(f"{name} ...", file=sys.stderr)
            tables[name] = (title, run(splats, Path(folder)))
    title = "Pictures of the levels, against the scene, over 24 views"
    tables["levels"] = (title, pictures.levels(splats, args.up))
    if args.tree:
        tree = read_tree(args.tree)
        for name, (title, measure) in trained.TABLES.items():
            print(f"{name} ...", file=sys.stderr)
            tables[name] = (title, measure(tree))
        if args.photos:
            title = "Pictures of a trained tree, on photographs it was not trained on"
            tables["photographs"] = (title, pictures.photographs(tree, args.photos))
    turned = f" --up={args.up}" if args.up != "z" else ""
    command = f"python -m tools.bench{turned}" + "".join(
        f" --{key} {path.name}"
        for key, path in (("ply", args.ply), ("tree", args.tree), ("photos", args.photos))
        if path
    )
    write(args.out, command, tables)
    return 0


def write(out: Path, command: str, tables: dict[str, tuple[str, Rows]]) -> None:
    """One CSV file per table, and a page with all of them."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    page = ["# Figures", "", f"Made by `{command}` on {machine()}.", ""]
    for name, (title, rows) in tables.items():
        with (out / "figures" / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        page += [f"## {title}", "", *markdown(rows), ""]
    (out / "figures.md").write_text("\n".join(page[:-1]) + "\n", encoding="utf-8")


def markdown(rows: Rows) -> list[str]:
    """Lines of a table."""
    head = list(rows[0])
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(str(row[key]) for key in head) + " |" for row in rows]


def machine() -> str:
    """Processor and cores, without the name of the machine."""
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        model = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), model)
    return f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}"


if __name__ == "__main__":
    sys.exit(main())
