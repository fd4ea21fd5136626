"""`docs/extremes.md`: its tables between their marks, the text around them left as it is."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

from reference_trainer.runtime.hardware import machine
from tools.bench.extremes import codec, integers, lifted, rasterizer, training
from tools.bench.extremes.row import Row

__all__ = ["PAGE", "TABLES", "remake"]

PAGE = Path(__file__).resolve().parent.parent.parent.parent / "docs" / "extremes.md"
Part = tuple[Callable[[int], Iterator[Row]], int]  # what makes rows, and its count
TABLES: dict[str, tuple[Part, ...]] = {
    "encoder": ((codec.scenes, 300), (codec.grids, 64), (lifted.shapes, 300)),
    "records": ((codec.chains, 64), (codec.products, 2)),
    "targets": ((codec.targets, 100),),
    "decoder": ((integers.chains_at_limits, 64), (integers.float_view, 200)),
    "projections": ((rasterizer.projections, 300),),
    "pictures": (
        (rasterizer.pictures, 100),
        (rasterizer.piles, 100_000),
        (rasterizer.piles, 10_000_000),
        (rasterizer.rims, 1000),
        (rasterizer.large_pictures, 8192),
    ),
    "training": ((training.starts, 40),),
}
NEEDS_TORCH = {"training"}


def remake(folder: Path) -> bool:
    """Measure everything and write the page to `folder`; False if a bound is broken."""
    text = PAGE.read_text(encoding="utf-8")
    holds = True
    for name, parts in TABLES.items():
        if name in NEEDS_TORCH and find_spec("torch") is None:
            print(f"extremes: {name}: left as it is, since there is no torch", file=sys.stderr)
            continue
        rows: list[Row] = []
        for make, n in parts:
            print(f"extremes: {name}, {make.__name__} ...", file=sys.stderr)
            rows += list(make(n))
        holds = holds and all(row.holds for row in rows)
        text = _replaced(text, name, "\n".join(_markdown(rows)))
    made = f"Made by `python -m tools.bench --only extremes` on {machine()}."
    folder.mkdir(parents=True, exist_ok=True)
    (folder / PAGE.name).write_text(_replaced(text, "made", made), encoding="utf-8")
    return holds


def _replaced(text: str, name: str, table: str) -> str:
    begin, end = f"<!-- table {name} -->", f"<!-- end {name} -->"
    pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    changed, n = pattern.subn(lambda _: f"{begin}\n{table}\n{end}", text)
    if n != 1:
        raise ValueError(f"the page has {n} tables {name}, expected one")
    return changed


def _markdown(rows: list[Row]) -> Iterator[str]:
    cells = [row.cells() for row in rows]
    yield "| " + " | ".join(cells[0]) + " |"
    yield "|" + "---|" * len(cells[0])
    for row in cells:
        yield "| " + " | ".join(str(cell).replace("|", "\\|") for cell in row.values()) + " |"
