"""Which targets can be reached, from few splats: what is far beyond them is refused at once.

Few splats, some of the scene, are encoded at both ends of what a search may try. Those of a scene
without a tree are lifted alone: a target out of reach costs no lift of all splats.

Letters: N splats of the scene, D channels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.common.morton import morton_order
from evogs_codec.encoding.arrange import leaf_order
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.out_of_reach import TargetMissedError, psnr_reached
from evogs_codec.encoding.replayed import leaves_of
from evogs_codec.encoding.sketch import families, part_of
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.encoding.write import write
from evogs_codec.format.directory import read_directory
from evogs_codec.lifting.lift import largest_leaf_errors, lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.channels import GROUPS, n_channels
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.splats import F32, I64, SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["CHECKED_FROM", "SURE_BYTES_OF_SPLAT", "FewSplats", "is_surely_in_reach"]

CHECKED_FROM = 8_000  # splats; of fewer no target is checked first, since each try is quick
N_SAMPLED = 6_000  # splats, whose ends stand for those of all
CHUNK = 256  # neighbours that are among them together
# Views of the few, and of all: so many that this many splats are drawn. If a third of the most put
# a target well inside the range, no more are drawn.
N_VIEWS, MAX_VIEWS, MAX_DRAWN = 4, 24, 2_000_000
# Targets that can be reached for sure: dB, bytes of a splat from this on, and of each of its
# numbers up to this.
SURE_PSNR, SURE_BYTES_OF_SPLAT, SURE_BYTES_OF_NUMBER = (30.0, 60.0), 2.5, 0.75
# dB, likewise, where positions can be so exact: within this part of the size of half of the splats.
# Scenes of all kinds reach 90 dB then.
SURE_PSNR_IF_EXACT, EXACT_OF_SIZE = 80.0, 0.01
FINEST_OF_EXTENT = 2.0**-24  # of the extent: positions are no integers of more bits
# What a target may be beyond an end of the few and yet be tried: dB, times the bytes, times the
# error.
ROOM_DB, ROOM_TIMES_BYTES, ROOM_TIMES_ERROR = 6.0, 2.0, 4.0


@dataclass(frozen=True, eq=False)
class FewSplats:
    """Some splats of a scene.

    Attributes:
        scene: all its splats.
        trees: of some, with the same leaves: those that the scene may be encoded as.
        leaf_error: (5,) of the trees (`EncodeTask`).
    """

    scene: SplatParams
    trees: Sequence[EvolutionTree]
    leaf_error: tuple[float, ...] = (0.0,) * len(GROUPS)

    @staticmethod
    def of_scene(
        splats: SplatParams, n_levels: int, request: Request, *, palette: bool = True
    ) -> FewSplats:
        """Of splats, which are lifted; in a palette, too, where they share their SH and may."""
        some = splats.take(_spread(splats))
        lifted = lift_with_order(some, n_levels, n_neighbours=request.effort.n_neighbours)
        shared = with_palette(lifted, some) if palette else None
        trees = [shared, lifted.tree] if shared else [lifted.tree]
        return FewSplats(splats, trees, largest_leaf_errors(trees[0], some, lifted.leaf_of))

    @staticmethod
    def of_tree(tree: EvolutionTree) -> FewSplats:
        """Of the leaves of a tree."""
        (is_in,) = families([tree], N_SAMPLED / tree.n_leaves)
        return FewSplats(tree.shared_leaves(), [part_of(tree, is_in)])

    def expect_in_reach(self, request: Request) -> bool:
        """Refuse a target far beyond what streams of the scene reach.

        Args:
            request: with a target that is not `is_surely_in_reach`.

        Returns:
            Whether the target is so far within that range that it can be met for sure.

        Raises:
            TargetMissedError: it is; the ends that it names are estimates.
        """
        if request.errors:
            self._expect_errors(request)
        elif not request.why_no_views:
            ends = [_Ends(self.scene, some, request) for some in self.trees]
            if request.target_psnr is not None:
                return _expect_psnr(ends, request.target_psnr)
            if request.target_bytes is not None:
                return _expect_bytes(ends, request.target_bytes)
        return False

    def _expect_errors(self, request: Request) -> None:
        missed: list[TargetMissedError] = []
        for some in self.trees:
            try:
                TargetEncoder(some, request.settings, leaf_error=self.leaf_error).within(
                    request.errors
                )
            except TargetMissedError as error:
                missed.append(error)
        if len(missed) == len(self.trees):
            nearest = min(missed, key=lambda error: error.by)
            if nearest.by > ROOM_TIMES_ERROR:
                raise nearest


class _Ends:
    """Streams of few splats at the ends of the range of prices, and what the scene has there."""

    def __init__(self, scene: SplatParams, some: EvolutionTree, request: Request) -> None:
        self.scene, self.some, self.request = scene, some, request
        self._trees: dict[float, CodedTree] = {}
        self._psnr: dict[tuple[float, int], float] = {}

    @cached_property
    def _encoder(self) -> TargetEncoder:
        views = self.request.views(self.some.shared_leaves(), N_VIEWS)
        layers = self.request.n_layers(self.some.n_levels)
        return TargetEncoder(self.some, self.request.settings, views, layers=layers, by_leaves=True)

    def _coded(self, price: float) -> CodedTree:
        if price not in self._trees:
            self._trees[price] = self._encoder.prepared.coded(price)
        return self._trees[price]

    def psnr(self, price: float, most_views: int) -> float:
        """Of the scene, dB, about."""
        n_views = min(max(MAX_DRAWN // len(self.scene), N_VIEWS), most_views)
        views = self.request.views_of_scene(self.scene)
        assert views is not None, "there are views"
        views = views.fewer(n_views)
        key = price, len(views.cameras)
        if key not in self._psnr:
            self._psnr[key] = self._drawn(price, views)
        return self._psnr[key]

    def _drawn(self, price: float, views: Views) -> float:
        """`psnr` by these views.

        Each splat errs as that one of the few does which has the same rank by size. Small errors
        let splats swap and cross thresholds. A few pixels then have most of the error, which
        pictures of few splats seldom show.
        """
        right = _unit(self.some.shared_leaves().channels())[:, leaf_order(self.some)]
        leaves = leaves_of(self._coded(price), self.scene.sh_degree)
        off = _unit(leaves.channels()) - right
        moved = _unit(self.scene.channels())
        n, n_some = moved.shape[1], right.shape[1]
        alike = np.empty(n, np.int64)
        alike[np.argsort(_size(moved))] = np.argsort(_size(right))[np.arange(n) * n_some // n]
        moved += off[:, alike]
        return views.psnr(SplatParams.from_channels(moved))

    def n_bytes(self, price: float) -> float:
        """Of the stream of the scene, about."""
        data = write(self._coded(price), zstd_level=1, digests=False)
        body = int(read_directory(data).packets["size"].sum())
        return len(data) - body + body * len(self.scene) / self.some.n_leaves


def is_surely_in_reach(request: Request, scene: SplatParams) -> bool:
    """Whether a target of a scene can be met; no picture is drawn."""
    n = len(scene)
    if request.target_psnr is not None:
        low, high = SURE_PSNR
        wanted = request.target_psnr
        return low <= wanted <= high or (high < wanted <= SURE_PSNR_IF_EXACT and _is_exact(scene))
    if request.target_bytes is not None:
        most = SURE_BYTES_OF_NUMBER * n_channels(scene.sh_degree) * n
        return SURE_BYTES_OF_SPLAT * n <= request.target_bytes <= most
    return False


def _is_exact(scene: SplatParams) -> bool:
    """Whether positions can be `EXACT_OF_SIZE`."""
    if not len(scene):
        return False
    means = scene.means.astype(np.float64)
    furthest = np.float32(np.abs(means).max())
    unit = max(float(np.spacing(furthest)), FINEST_OF_EXTENT * float(np.ptp(means, axis=0).max()))
    # Of sizes the logarithm: some have no float.
    return math.log(unit / EXACT_OF_SIZE) <= float(
        np.median(scene.log_scales.mean(1, dtype=np.float64))
    )


def _expect_psnr(ends: Sequence[_Ends], wanted: float) -> bool:
    """Whether a PSNR is in reach for sure; raises if it is far out of it."""

    def most(n_views: int) -> float:
        return max(one.psnr(PRICES[0], n_views) for one in ends)

    def least(n_views: int) -> float:
        return min(one.psnr(PRICES[1], n_views) for one in ends)

    def off(n_views: int) -> float:
        return wanted - most(n_views) if wanted > SURE_PSNR[1] else least(n_views) - wanted

    found = off(MAX_VIEWS // 3)
    if found >= -ROOM_DB:
        found = off(MAX_VIEWS)
    if found > ROOM_DB:
        reached = psnr_reached(least(MAX_VIEWS), most(MAX_VIEWS), "about ")
        raise TargetMissedError(f"{wanted:g} dB cannot be met: {reached}", found)
    return found < -ROOM_DB


def _expect_bytes(ends: Sequence[_Ends], wanted: int) -> bool:
    """Whether a number of bytes is in reach for sure; raises if it is far out of it."""

    @cache
    def most() -> float:
        return max(one.n_bytes(PRICES[0]) for one in ends)

    @cache
    def least() -> float:
        return min(one.n_bytes(PRICES[1]) for one in ends)

    is_low = wanted < SURE_BYTES_OF_SPLAT * len(ends[0].scene)
    times = least() / wanted if is_low else wanted / most()
    if times > ROOM_TIMES_BYTES:
        reached = f"about {_rounded(least()):,} to {_rounded(most()):,} bytes can be reached"
        said = f"{wanted:,} bytes cannot be met: {reached}"
        raise TargetMissedError(said, max(least() - wanted, wanted - most()))
    return times < 1 / ROOM_TIMES_BYTES


def _spread(splats: SplatParams) -> I64:
    """Rows of about `N_SAMPLED` splats all over a scene, and of those with extremes of channels.

    The grids of a stream follow from the extremes.
    """
    order = morton_order(splats.means.T)
    n_chunks = -(-len(order) // CHUNK)
    chunks = np.arange(n_chunks)[:: max(n_chunks * CHUNK // N_SAMPLED, 1)]
    rows = [order[at * CHUNK : (at + 1) * CHUNK] for at in chunks]
    channels = splats.channels()
    return np.unique(np.concatenate([*rows, channels.argmin(axis=1), channels.argmax(axis=1)]))


def _size(channels: F32) -> F32:
    """(N,) logarithm of the product of the scales of splats (D, N)."""
    size: F32 = channels[7:10].sum(axis=0)
    return size


def _unit(channels: F32) -> F32:
    """Splats (D, N) with quaternions of length 1."""
    length = np.sqrt(np.square(channels[3:7]).sum(axis=0))
    channels[3:7] /= np.where(length > 0, length, 1)
    return channels


def _rounded(n: float) -> int:
    """To two digits."""
    unit = 10.0 ** max(math.floor(math.log10(max(n, 1))) - 1, 0)
    return int(round(n / unit) * unit)
