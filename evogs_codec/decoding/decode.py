"""Decoding: a whole file, or what is there of one (spec 6, 7); `progressive` takes it in pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import TypeAlias

import numpy as np

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.decoding.byte_ranges import packet_ranges
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.float_view import FloatView, float_view
from evogs_codec.decoding.replay import replay_tiles
from evogs_codec.decoding.tile_state import TileState
from evogs_codec.format import layout
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.splats import SplatParams
from evogs_codec.stores.sources import Source, bytes_of, source_of

__all__ = ["Decoded", "decode", "decode_leaves", "decode_prefix", "replay"]


# A cut, or a function that makes it from the directory of the stream.
ChosenCut: TypeAlias = "Cut | Callable[[Directory], Cut]"


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded cut: `directory`, `cut`, and the state of each tile in integers."""

    directory: Directory
    cut: Cut
    tiles: tuple[TileState, ...]

    def __repr__(self) -> str:
        return f"Decoded({self.n_leaves} splats, {self.cut!r})"

    @property
    def n_leaves(self) -> int:
        """Live slots of all tiles."""
        return sum(int(np.count_nonzero(tile.live[: tile.n_slots])) for tile in self.tiles)

    @property
    def sh_degree(self) -> int:
        """Highest SH band with a step in the cut; the float view stops there."""
        return self.cut.sh_degree(self.directory)

    def leaves(self, *, sh_degree: int | None = None) -> SplatParams:
        """Float view (spec 7.6) of the live splats, tile by tile, in slot order.

        Args:
            sh_degree: degree of the result; by default the highest band of the cut.
        """
        degree = self.sh_degree if sh_degree is None else sh_degree
        return float_view(self.directory, self.tiles, degree)

    def dump(self) -> bytes:
        """The dump of spec 7.7."""
        out = BytesIO()
        for part in self.dump_parts():
            out.write(part)
        return out.getvalue()

    def dump_parts(self) -> Iterator[bytes | memoryview]:
        """The dump in parts no larger than a channel of a tile, to be written one by one."""
        directory = self.directory
        yield layout.build(
            layout.DUMP_HEADER,
            magic=b"EVGD",
            version=1,
            sh_degree=directory.sh_degree,
            grid_exponents=list(directory.grid_exponents),
            reserved=0,
            n_tiles=len(self.tiles),
        )
        for tile in self.tiles:
            yield from tile.dump_parts()


def decode(
    data: Source,
    cut: ChosenCut | None = None,
    *,
    level: int | None = None,
    directory: Directory | None = None,
    verify: bool = False,
    limits: Mapping[str, int] | None = None,
    progress: Progress | None = None,
) -> Decoded:
    """Decode a whole file.

    Args:
        data: all bytes of the file, its path, or its URL, of which the packets of the cut are
            fetched.
        cut: the cut, or a function that makes it from the directory; everything by default.
        level: instead of a cut, the cut of this level.
        directory: of the stream, if it was read before; no limits are then checked.
        verify: check the digests of states that the cut passes (R-5.7-3).
        limits: limits of this decoder by name (spec 8.3).
        progress: called with the stage "decode" and the part of the packets that is done, perhaps
            by several threads; for a URL with the stage "fetch" before.

    Raises:
        StreamError: the stream is not legal, or over the limits.
        OSError: the file cannot be read.
        TypeError: `data` is neither bytes nor a path, or `cut` is no cut.
        ValueError: the stream has no such cut.
    """
    source = source_of(data)
    directory = read_directory(source, limits) if directory is None else directory
    chosen = _chosen(directory, cut, level)
    view = source.having(packet_ranges(directory, chosen), progress or no_progress)
    return replay(directory, view, chosen, verify=verify, progress=_of_stage(progress))


def decode_prefix(data: Source, *, limits: Mapping[str, int] | None = None) -> Decoded:
    """Decode the complete packets of a truncated file (R-6.4-1).

    Args:
        data: its bytes from the first on, its path, or its URL.
        limits: limits of this decoder by name (spec 8.3).

    Raises:
        StreamError: as `decode`; E_TRUNCATED only if header or chunks are not complete.
        TypeError: `data` is neither bytes nor a path.
    """
    view = bytes_of(data)
    directory = read_directory(view, limits)
    return replay(directory, view, Cut.of_prefix(directory, len(view)))


def decode_leaves(
    data: Source,
    cut: ChosenCut | None = None,
    *,
    level: int | None = None,
    sh_degree: int | None = None,
    directory: Directory | None = None,
    verify: bool = False,
    limits: Mapping[str, int] | None = None,
    progress: Progress | None = None,
) -> SplatParams:
    """`decode(data, cut, ...).leaves(sh_degree=...)`, with one tile at a time in integers.

    Args:
        data: all bytes of the file, its path, or its URL, of which the packets of the cut are
            fetched.
        cut: the cut, or a function that makes it from the directory; everything by default.
        level: instead of a cut, the cut of this level.
        sh_degree: degree of the result; by default the highest band of the cut.
        directory: of the stream, if it was read before; no limits are then checked.
        verify: check the digests of states that the cut passes (R-5.7-3).
        limits: limits of this decoder by name (spec 8.3).
        progress: called with the stage "decode" and the part of the packets that is done, perhaps
            by several threads; for a URL with the stage "fetch" before.

    Raises:
        StreamError, OSError, TypeError, ValueError: as `decode`.
    """
    source = source_of(data)
    directory = read_directory(source, limits) if directory is None else directory
    cut = _chosen(directory, cut, level)
    view = source.having(packet_ranges(directory, cut), progress or no_progress)
    selected = cut.packets(directory)
    of_tiles = selected & (directory.columns >= 0)
    rows = directory.packets[of_tiles]
    ends = (directory.offsets[of_tiles] + rows["size"])[rows["size"] > 0]
    if int(ends.max(initial=0)) > len(view):
        # A table may promise any number of splats: this finds the fault before it pays for them.
        replay(directory, view, cut)
    born = rows["n_adds"].astype(np.int64) + rows["n_splits"] - rows["n_drops"]
    n_live = np.bincount(rows["tile"], born, len(directory.tiles)).astype(np.int64)
    degree = cut.sh_degree(directory) if sh_degree is None else sh_degree
    leaves = FloatView(directory, n_live, degree)
    report = _of_stage(progress)
    replay_tiles(directory, view, selected, leaves.write, verify=verify, progress=report)
    return leaves.splats()


def replay(
    directory: Directory,
    data: memoryview,
    cut: Cut,
    *,
    verify: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Decoded:
    """Apply the packets of a cut; faults as `decode`, first in file order."""
    selected = cut.packets(directory)
    tiles = replay_tiles(directory, data, selected, verify=verify, progress=progress)
    return Decoded(directory, cut, tuple(tiles))


def _chosen(directory: Directory, cut: object, level: int | None) -> Cut:
    """The cut that the arguments name."""
    if cut is not None and level is not None:
        raise ValueError("a cut and a level exclude each other")
    if level is not None:
        return Cut.of_level(directory, level)
    if cut is None:
        return Cut.full(directory)
    found = cut(directory) if callable(cut) else cut
    if isinstance(found, Cut):
        return found
    hint = f"decode(data, level={found})" if isinstance(found, int) else "see choose_cut"
    raise TypeError(f"expected a Cut, not {found!r}: {hint}")


def _of_stage(progress: Progress | None) -> Callable[[float], None] | None:
    return None if progress is None else partial(progress, "decode")
