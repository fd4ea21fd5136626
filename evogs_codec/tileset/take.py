"""What of a tileset is decoded for a box or a number of splats, and no more of it fetched.

Tiles are replaced by their children, those with the largest errors first, while the splats stay
within the number. Then of each content that level is taken that still fits.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.decoding.byte_ranges import byte_ranges
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.errors import Fault, InputError, StreamError
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.stores.sources import ByteSource
from evogs_codec.tileset.boxes import Box
from evogs_codec.tileset.read import Tile, Tileset

__all__ = ["Taken", "chosen_tiles", "take"]

MOVED_OF_SIZE = 0.1  # of the size of its splats may float32 move one


@dataclass(frozen=True, eq=False)
class Taken:
    """Splats of a tileset.

    Attributes:
        splats: all of them.
        origin: (3,) from where their positions are, in the scene; 0 if float32 keeps them so.
        info: what the first content says.
        n_files: of contents.
        n_bytes: of these and of JSON that were needed.
    """

    splats: SplatParams
    origin: F64
    info: SceneInfo
    n_files: int
    n_bytes: int


@dataclass
class _Part:
    tile: Tile
    source: ByteSource
    directory: Directory
    cuts: list[Cut]  # by level
    counts: list[int]  # splats of these
    level: int

    @property
    def n(self) -> int:
        return self.counts[self.level]


def take(
    tileset: Tileset,
    *,
    box: Sequence[float] | None = None,
    max_splats: int | None = None,
    sh_degree: int | None = None,
    progress: Progress | None = None,
) -> Taken:
    """Decode what of a tileset meets a box, with so many splats at most.

    Args:
        tileset: what is read.
        box: x0 y0 z0 x1 y1 z1 in coordinates of the scene; None: all.
        max_splats: at most; None: all.
        sh_degree: no SH bands above this one.
        progress: called with a stage and the part of it that is done.

    Raises:
        InputError: nothing is in the box, so few splats show nothing, or a content is no stream or
            damaged.
        OSError: a file cannot be read.
    """
    report = progress or no_progress
    wanted = None if box is None else _box(box)
    parts = [
        _opened(tileset, tile, wanted, sh_degree)
        for tile in chosen_tiles(tileset, wanted, max_splats)
    ]
    parts = [part for part in parts if part.counts[-1]]
    if not parts:
        raise InputError(f"{tileset.place}: no splat is in the box")
    if max_splats is not None:
        _fit(parts, max_splats, tileset)
    degree = max(part.directory.sh_degree for part in parts)
    degree = degree if sh_degree is None else min(degree, sh_degree)
    found, n_bytes = [], tileset.n_json
    for number, part in enumerate(parts):
        cut = part.cuts[part.level]
        try:
            leaves = decode_leaves(part.source, cut, sh_degree=degree, directory=part.directory)
        except StreamError as error:
            at = tileset.place.path_of(str(part.tile.name))
            raise InputError(f"{at}: {error}") from error
        found.append(leaves)
        n_bytes += part.directory.data_offset
        n_bytes += sum(size for _, size in byte_ranges(part.directory, cut))
        report("decode", (number + 1) / len(parts))
    splats, origin = _joined(parts, found)
    info = parts[0].directory.info
    return Taken(splats, origin, info, len(parts), n_bytes)


def chosen_tiles(tileset: Tileset, box: Box | None, max_splats: int | None) -> list[Tile]:
    """The tiles whose contents show what meets the box, none of them below another.

    The splats are those that the tileset says, before a level of each content is chosen. A tile
    whose children are too many stays, and its content is taken in part if that is too much.
    """
    order = 0

    def entry(tile: Tile) -> tuple[float, int, Tile]:
        nonlocal order
        order += 1
        return -tile.error, order, tile

    tileset.load(tileset.root)
    heap = [entry(tileset.root)] if box is None or box.meets(tileset.root.box_in_scene) else []
    chosen: list[Tile] = []
    total = sum(tile.n_splats or 0 for _, _, tile in heap)
    while heap:
        tile = heapq.heappop(heap)[2]
        below = tileset.children(tile)
        for child in below:
            tileset.load(child)
        below = [one for one in below if box is None or box.meets(one.box_in_scene)]
        more = sum(child.n_splats or 0 for child in below) - (tile.n_splats or 0)
        fits = max_splats is None or tile.name is None or total + more <= max_splats
        if tile.children and fits:
            total += more
            for child in below:
                heapq.heappush(heap, entry(child))
        elif tile.name is not None:
            chosen.append(tile)
    return sorted(chosen, key=lambda tile: str(tile.name))


def _opened(tileset: Tileset, tile: Tile, box: Box | None, sh_degree: int | None) -> _Part:
    name = str(tile.name)
    source = tileset.place.open(name)
    try:
        directory = read_directory(source)
    except StreamError as error:
        said = "is no stream" if error.fault is Fault.E_SIGNATURE else str(error)
        raise InputError(f"{tileset.place.path_of(name)}: {said}") from error
    cuts = [Cut.of_level(directory, level) for level in range(directory.n_levels)]
    if sh_degree is not None:
        cuts = [cut.with_sh_degree(min(sh_degree, directory.sh_degree)) for cut in cuts]
    if box is not None:
        here = box.moved(-tile.origin)
        cuts = [cut.with_box(directory, (*here.low, *here.high)) for cut in cuts]
    counts = [_count(directory, cut) for cut in cuts]
    return _Part(tile, source, directory, cuts, counts, len(cuts) - 1)


def _count(directory: Directory, cut: Cut) -> int:
    """Splats of a cut."""
    rows = directory.packets[cut.packets(directory) & (directory.packets["component"] == 0)]
    return int(
        sum(int(rows[name].sum()) for name in ("n_adds", "n_splits")) - rows["n_drops"].sum()
    )


def _fit(parts: list[_Part], most: int, tileset: Tileset) -> None:
    """Lower levels, always of the content that has the most splats, until all fit."""
    total = sum(part.n for part in parts)
    heap = [(-part.n, number) for number, part in enumerate(parts)]
    heapq.heapify(heap)
    while total > most and heap:
        _, number = heapq.heappop(heap)
        part = parts[number]
        if part.level:
            total -= part.n
            part.level -= 1
            total += part.n
            heapq.heappush(heap, (-part.n, number))
    if total > most:
        raise InputError(f"{tileset.place}: the coarsest level has {total:,} splats already")


def _joined(parts: list[_Part], found: list[SplatParams]) -> tuple[SplatParams, F64]:
    """All splats, and from where their positions are."""
    origins = np.array([part.tile.origin for part in parts])
    furthest = max(
        float(np.abs(splats.means + origin).max(initial=0))
        for splats, origin in zip(found, origins, strict=True)
    )
    sizes = [np.median(s.log_scales.mean(axis=1)) for s in found if len(s)]
    size = float(np.exp(np.clip(min(sizes, default=0.0), -80, 80)))
    middle = np.zeros(3)
    if float(np.spacing(np.float32(min(furthest, 1e38)))) / 2 > MOVED_OF_SIZE * size:
        middle = np.rint(origins.mean(axis=0))
    rows = []
    for splats, origin in zip(found, origins, strict=True):
        channels = splats.channels()
        channels[0:3] = (splats.means.astype(np.float64) + (origin - middle)).T
        rows.append(channels)
    return SplatParams.from_channels(np.concatenate(rows, axis=1)), middle


def _box(box: Sequence[float]) -> Box:
    low, high = np.sort(np.asarray(box, np.float64).reshape(2, 3), axis=0)
    return Box.of(low, high)
