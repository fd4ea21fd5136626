"""Splats of files, block by block: a binary `.ply` is never in memory as a whole.

Letters: n splats of a block.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from evogs_codec.errors import InputError
from evogs_codec.io.finite import finite_opacities
from evogs_codec.io.interchange import ply_comments
from evogs_codec.io.interchange.scene_files import read_scene, scene_format
from evogs_codec.io.ply import PlyBlocks
from evogs_codec.model.channels import n_channels
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, SplatParams

__all__ = ["Block", "SplatFiles"]

BLOCK = 1 << 17  # splats


@dataclass(frozen=True, eq=False)
class Block:
    """Some splats.

    Attributes:
        means: (n, 3) float64 positions, as exact as the file has them.
        splats: n splats, whose positions are `means` in float32.
    """

    means: F64
    splats: SplatParams

    def rows(self, origins: F64) -> F32:
        """(n, D) numbers of each splat by channel, positions from `origins` (n, 3)."""
        rows = np.ascontiguousarray(self.splats.channels().T)
        rows[:, 0:3] = self.means - origins
        return rows


@dataclass
class SplatFiles:
    """The splats of some files, all of one SH degree.

    Attributes:
        paths: of scenes that `read_scene` reads.
        drop_invalid: leave out splats with a NaN or an infinite number, and count them.
        n_invalid: of these; known when all blocks have been read.
        n_opaque: splats with an infinite opacity, likewise; a finite one that renders the same is
            taken.
    """

    paths: Sequence[Path]
    drop_invalid: bool = False
    n_invalid: int = 0
    n_opaque: int = 0

    @cached_property
    def sh_degree(self) -> int:
        """Of all files.

        Raises:
            InputError: it differs.
        """
        degrees = {path: self._degree(path) for path in self.paths}
        first, *others = degrees
        for path in others:
            if degrees[path] != degrees[first]:
                raise InputError(
                    f"{path}: has SH degree {degrees[path]}, {first} has {degrees[first]}: scenes"
                    " that become one have the same; `evogs edit` joins others into one .ply"
                )
        return degrees[first]

    @cached_property
    def info(self) -> SceneInfo:
        """What the first file says of the scene."""
        path = self.paths[0]
        blocks = self._ply(path)
        return read_scene(path).info if blocks is None else ply_comments.info_of(blocks.comments)

    @property
    def n_channels(self) -> int:
        """D, of a splat."""
        return n_channels(self.sh_degree)

    @cached_property
    def n_declared(self) -> int:
        """Splats that the files declare, those that are dropped among them."""
        return sum(self._count(path) for path in self.paths)

    def blocks(self) -> Iterator[Block]:
        """All splats whose numbers are finite, in the order of the files.

        Raises:
            InputError: a file cannot be read, or a splat is not finite and is not to be dropped.
        """
        self.n_invalid = self.n_opaque = 0
        for path in self.paths:
            for block in self._blocks_of(path):
                yield self._cleaned(path, block)

    def _cleaned(self, path: Path, block: Block) -> Block:
        splats, n_opaque = finite_opacities(block.splats)
        self.n_opaque += n_opaque
        finite = splats.finite()
        if finite.all():
            return Block(block.means, splats)
        self.n_invalid += int((~finite).sum())
        if not self.drop_invalid:
            raise InputError(
                f"{path}: splats have a NaN or an infinite number: use --drop-invalid to leave"
                " them out"
            )
        return Block(block.means[finite], splats.take(finite))

    def _blocks_of(self, path: Path) -> Iterator[Block]:
        ply = self._ply(path)
        if ply is not None:
            for at in range(0, ply.n, BLOCK):
                yield Block(*ply.read(at, at + BLOCK))
            return
        splats = read_scene(path).splats
        for at in range(0, len(splats), BLOCK):
            some = splats.take(slice(at, at + BLOCK))
            yield Block(some.means.astype(np.float64), some)

    def _count(self, path: Path) -> int:
        ply = self._ply(path)
        return len(read_scene(path).splats) if ply is None else ply.n

    def _degree(self, path: Path) -> int:
        ply = self._ply(path)
        return read_scene(path).splats.sh_degree if ply is None else ply.sh_degree

    def _ply(self, path: Path) -> PlyBlocks | None:
        """The rows of a `.ply` that can be read from anywhere; None of any other file."""
        return PlyBlocks.of(path) if scene_format(path) == "ply" else None
