"""Checking a tileset: its tiles against each other, and against what their contents hold."""

from __future__ import annotations

from dataclasses import dataclass, field

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.decoding.decode import decode
from evogs_codec.errors import InputError, StreamError
from evogs_codec.format.directory import read_directory
from evogs_codec.tileset.boxes import Box, covered
from evogs_codec.tileset.read import Tile, Tileset

__all__ = ["Checked", "check_tileset"]

SLACK = 1e-9  # of the diagonal of a box: what sums of float64 may be off
MAX_PROBLEMS = 100
STREAM = ".evogs"


@dataclass
class Checked:
    """What was found.

    Attributes:
        problems: a line each, at most 100.
        n_files, n_splats, n_leaf_splats, n_bytes, n_digests: of the contents.
    """

    problems: list[str] = field(default_factory=list)
    n_files: int = 0
    n_splats: int = 0
    n_leaf_splats: int = 0
    n_bytes: int = 0
    n_digests: int = 0


def check_tileset(tileset: Tileset, progress: Progress | None = None) -> Checked:
    """Read all files of a tileset, and say what is wrong.

    Boxes are inside those of parents, errors do not grow downwards, every stream has digests that
    match, and what it covers is inside the box of its tile. Of files of other formats only the
    length is looked at.

    Raises:
        InputError: the JSON is no tileset that is known.
        OSError: a file cannot be read.
    """
    out, report = Checked(), progress or no_progress
    tiles = list(tileset.all())
    for number, tile in enumerate(tiles):
        if len(out.problems) >= MAX_PROBLEMS:
            break
        _check_family(tile, out)
        if tile.name is None and not tile.children:
            out.problems.append("a tile has neither content nor children")
        elif tile.name is not None:
            _check_content(tileset, tile, out)
        report("validate", (number + 1) / len(tiles))
    return out


def _check_family(tile: Tile, out: Checked) -> None:
    mine = tile.box
    slack = SLACK * mine.diagonal
    wide = Box(
        (mine.low[0] - slack, mine.low[1] - slack, mine.low[2] - slack),
        (mine.high[0] + slack, mine.high[1] + slack, mine.high[2] + slack),
    )
    for child in tile.children:
        if not wide.holds(child.box.moved(child.origin - tile.origin)):
            out.problems.append(f"{child.name}: its box is not inside that of its parent")
        if child.error > tile.error:
            out.problems.append(f"{child.name}: its geometric error is above that of its parent")


def _check_content(tileset: Tileset, tile: Tile, out: Checked) -> None:
    name = str(tile.name)
    if not name.endswith(STREAM):
        _check_other(tileset, tile, out)
        return
    try:
        source = tileset.place.open(name)
        directory = read_directory(source)
        found = decode(source, verify=True, directory=directory)
    except (InputError, StreamError, OSError) as error:
        out.problems.append(f"{name}: {error}")
        return
    out.n_files += 1
    out.n_bytes += source.size
    out.n_splats += found.n_leaves
    out.n_leaf_splats += 0 if tile.children else found.n_leaves
    out.n_digests += len(directory.digests)
    if tile.n_splats not in (None, found.n_leaves) or tile.n_bytes not in (None, source.size):
        out.problems.append(f"{name}: has other splats or bytes than the tileset says")
    if found.n_leaves and not tile.box.holds(covered(found.leaves(sh_degree=0))):
        out.problems.append(f"{name}: its splats cover more than the box of its tile")


def _check_other(tileset: Tileset, tile: Tile, out: Checked) -> None:
    """A content of another format: whether it is there, and as long as it should be."""
    name = str(tile.name)
    try:
        size = tileset.place.open(name).size
    except (InputError, OSError) as error:
        out.problems.append(f"{name}: {error}")
        return
    out.n_files += 1
    out.n_bytes += size
    out.n_splats += tile.n_splats or 0
    out.n_leaf_splats += 0 if tile.children else tile.n_splats or 0
    if tile.n_bytes not in (None, size):
        out.problems.append(f"{name}: has other bytes than the tileset says")
