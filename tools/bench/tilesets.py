"""Tilesets beside one file: bytes, seconds, and what a picture of a region needs.

python -m tools.bench.tilesets --splats 1000000 --per-file 65536
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from evogs_codec import choose_cut, read_directory, write_ply
from evogs_codec.decoding.byte_ranges import byte_ranges
from evogs_codec.tileset import Place, Tileset, TilesetOptions, take
from tools.bench.large import together
from tools.bench.page import Rows, markdown
from tools.bench.scale import tiled

__all__ = ["main", "tilesets"]

REGION = (0.0, 0.0, 0.0, 2.0, 2.0, 2.0)  # in one of the copies of which the scene is made
FAR_SPLATS, NEAR_SPLATS = 20_000, 50_000  # splats of a picture


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.tilesets",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--splats", type=int, default=300_000)
    parser.add_argument("--per-file", type=int, nargs="+", default=[TilesetOptions.per_file])
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print("\n".join(markdown(tilesets(Path(folder), args.splats, args.per_file))))


def tilesets(folder: Path, n_splats: int, per_file: list[int]) -> Rows:
    """A row for one file, and one for a tileset with so many splats in a file.

    All in one process with one thread. `first`: bytes for a picture of everything with at most
    20,000 splats; `region`: for all splats of a box; `region, 50,000`: for at most so many.
    """
    scene = folder / "scene.ply"
    write_ply(scene, tiled(n_splats))
    out = folder / "scene.evogs"
    command = [sys.executable, "-m", "evogs"]
    serial = ["--engine", "serial"]
    took = together([*command, "encode", str(scene), str(out), *serial], folder / "none")
    rows: Rows = [{"": "one file", "files": 1} | _of_one(out, took.processor, n_splats)]
    for n in per_file:
        made = folder / f"{n}"
        options = ["--per-file", str(n), *serial]
        took = together([*command, "tileset", str(scene), str(made), *options], folder / "none")
        rows.append({"": f"tileset, {n:,} a file"} | _of_many(made, took.processor, n_splats))
    return rows


def _of_one(path: Path, seconds: float, n_splats: int) -> dict[str, object]:
    directory = read_directory(path)

    def n_bytes(**asked: object) -> int:
        cut = choose_cut(directory, **asked)  # type: ignore[arg-type]
        return directory.data_offset + sum(size for _, size in byte_ranges(directory, cut))

    return _row(
        path.stat().st_size,
        seconds,
        n_splats,
        n_bytes(level=0),
        n_bytes(box=REGION),
        n_bytes(box=REGION, level=3),
    )


def _of_many(folder: Path, seconds: float, n_splats: int) -> dict[str, object]:
    with Place(folder) as place:
        tileset = Tileset(place)
        n_files = sum(tile.name is not None for tile in tileset.all())
        first, region, less = (
            take(tileset, box=box, max_splats=most).n_bytes
            for box, most in ((None, FAR_SPLATS), (REGION, None), (REGION, NEAR_SPLATS))
        )
    n_bytes = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {"files": n_files} | _row(n_bytes, seconds, n_splats, first, region, less)


def _row(
    n_bytes: int, seconds: float, n_splats: int, first: int, region: int, less: int
) -> dict[str, object]:
    return {
        "bytes": f"{n_bytes:,}",
        "bytes a splat": f"{n_bytes / n_splats:.2f}",
        "processor s": f"{seconds:.0f}",
        "first": f"{first:,}",
        "region": f"{region:,}",
        f"region, {NEAR_SPLATS:,}": f"{less:,}",
    }


if __name__ == "__main__":
    main()
