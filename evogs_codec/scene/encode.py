"""A whole encode in one call: what `evogs encode` does, as functions.

splats -> lift -> with a palette, or without -> to an accuracy or a target -> the smallest stream
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from evogs_codec.common.progress import Progress
from evogs_codec.encoding.arrange import leaf_order
from evogs_codec.encoding.encode import expect_tree
from evogs_codec.encoding.grids import expect_near
from evogs_codec.encoding.settings import SCENE_PRESET, TREE_PRESET, Settings
from evogs_codec.errors import InputError
from evogs_codec.format.write_directory import MAX_LEVELS
from evogs_codec.io.finite import bounded_opacities
from evogs_codec.lifting.lift import (
    N_LEVELS,
    Lifted,
    default_levels,
    largest_leaf_errors,
    lift_with_order,
)
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import I64, SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.choose import at_tree_psnr, best_stream, warn_of_preset
from evogs_codec.scene.falls.steady import steady
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.reach import CHECKED_FROM, FewSplats, is_surely_in_reach
from evogs_codec.scene.request import MaxError, Request, SceneOptions, TreeOptions

if TYPE_CHECKING:
    from typing import Unpack

    from evogs_codec.render import Camera
    from evogs_codec.render.up import Direction

__all__ = [
    "EncodedScene",
    "encode_scene",
    "encode_scene_with_order",
    "encode_tree",
    "encode_tree_with_order",
]


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """A stream, and where its splats come from.

    Attributes:
        data: the stream.
        tree: what was encoded, with a palette where that is smaller.
        n_tiles: as it was asked for.
        leaf_of: (N,) the index of the splat given, or of the leaf of the tree given, that each leaf
            of `tree` is.
        orders: per tile, the number that each slot has where the tree is arranged plainly; None,
            of a tile or of all, where it has the same.
    """

    data: bytes
    tree: EvolutionTree
    n_tiles: int | None
    leaf_of: I64
    orders: Sequence[I64 | None] | None = None

    @cached_property
    def leaf_order(self) -> I64:
        """(N,) the index of the input splat that each splat of `decode(data).leaves()` is."""
        return self.leaf_of[leaf_order(self.tree, self.n_tiles, self.orders)]

    def __repr__(self) -> str:
        return f"EncodedScene({len(self.data)} bytes, {len(self.leaf_of)} splats)"


def encode_scene(
    splats: SplatParams,
    *,
    levels: int | None = None,
    preset: str | Settings | None = None,
    palette: Literal["auto", "never"] = "auto",
    target_psnr: float | None = None,
    target_bytes: int | None = None,
    max_error: MaxError | None = None,
    layers: int | None = None,
    polish: int = 0,
    improve: Callable[[EvolutionTree], EvolutionTree] | None = None,
    cameras: Sequence[Camera] | None = None,
    up: Direction | None = None,
    n_tiles: int | None = None,
    effort: str | int | None = None,
    info: SceneInfo | None = None,
    progress: Progress | None = None,
) -> bytes:
    """The stream of splats, as `evogs encode scene.ply` makes it.

    Args:
        splats: N splats, all finite (`drop_non_finite`).
        levels: of the tree that is built under them, 1 to 64; by default 5, or fewer of less than
            20,000 splats (`default_levels`), unless they are to be improved.
        preset: a name in `PRESETS` or settings: fixed steps. No target goes with it. By default
            rendered views decide how exact each number is, at a fixed price of a bit; "scene" where
            nothing can be rendered.
        palette: "auto" stores SH above band 0 once where splats share them, if that is smaller;
            "never" stores them splat by splat.
        target_psnr: dB of rendered views against the splats; the smallest stream that has it.
        target_bytes: the best stream of at most this many bytes.
        max_error: no number of a splat is further off: one for all groups, in the units of each
            group, or one per name of a group (position, rotation, scale, opacity, sh).
        layers: of precision, 1 to 8: all splats come at coarse steps first, then refinements of
            them, so that prefixes look better. By default 2, or 3 where a target PSNR is far
            above that of coarse splats; 1 with a preset or `max_error`.
        polish: with `target_psnr` or `target_bytes`, iterations of gradient descent that move the
            integers of the last level.
        improve: is given the lifted tree and returns one with better coarse levels, for instance
            by `reference_trainer.distil`; its leaves and their order must stay.
        cameras: of the views; by default 24 around the splats. With `polish` every 5th judges. An
            empty sequence: nothing is rendered, and estimates put packets in order.
        up: what is up in the default views: x, y or z, perhaps with a minus, or a vector; by
            default the `up_axis` of `info`, or else what the splats show, or else z.
        n_tiles: tiles wanted; by default 1 below about 200,000 splats.
        effort: "fast", "default" or "best" (`EFFORTS`), or the default with a Zstandard level of
            1..22. "fast" measures no PSNR of levels.
        info: metadata; its text gets a `generator` if it has none.
        progress: called with a stage and the part of it that is done.

    Raises:
        TypeError: `splats` are none.
        TargetMissedError: no stream meets the target.
        NotRepresentableError: values too large for any grid of the format.
        InputError: a target needs views and there are none: numba is missing, or all splats are.
        ValueError: an option is out of range or does not go with another.
    """
    return encode_scene_with_order(
        splats,
        levels=levels,
        preset=preset,
        palette=palette,
        target_psnr=target_psnr,
        target_bytes=target_bytes,
        max_error=max_error,
        layers=layers,
        polish=polish,
        improve=improve,
        cameras=cameras,
        up=up,
        n_tiles=n_tiles,
        effort=effort,
        info=info,
        progress=progress,
    ).data


def encode_scene_with_order(splats: SplatParams, **options: Unpack[SceneOptions]) -> EncodedScene:
    """`encode_scene`, with the order of the splats in the stream.

    Args:
        splats: N splats, all finite.
        options: as of `encode_scene`, which says what is raised.
    """
    _expect_splats(splats)
    levels, palette = options.pop("levels", None), options.pop("palette", "auto")
    improve = options.pop("improve", None)
    if levels is None:
        levels = default_levels(len(splats)) if improve is None else N_LEVELS
    if levels not in range(1, MAX_LEVELS + 1):
        raise ValueError(f"levels is {levels}, expected 1..{MAX_LEVELS}")
    if palette not in ("auto", "never"):
        raise ValueError(f"palette is {palette!r}, expected 'auto' or 'never'")
    expect_near(float(np.abs(splats.means).max(initial=0)))
    request = Request.of(SCENE_PRESET, options).looking_at(splats)
    if request.is_by_views:
        splats = bounded_opacities(splats)
    is_sure = is_surely_in_reach(request, splats)
    if len(splats) >= CHECKED_FROM and not request.is_plain and not is_sure:
        few = FewSplats.of_scene(splats, levels, request, palette=palette == "auto")
        is_sure = few.expect_in_reach(request)
    request = replace(request, is_in_reach=is_sure)
    lifted = lift_with_order(
        splats, levels, n_neighbours=request.effort.n_neighbours, progress=request.progress
    )
    if improve is not None:
        lifted = _improved(lifted, improve)
    shared = with_palette(lifted, splats) if palette == "auto" else None
    leaf_error = (0.0,) * len(GROUPS)
    if request.errors:
        leaf_error = largest_leaf_errors(shared or lifted.tree, splats, lifted.leaf_of)
    # The tree without a palette may be smaller: of few splats, or where a target leaves SH few
    # bits.
    trees = [shared, lifted.tree] if shared else [lifted.tree]
    found = best_stream(trees, request, leaf_error, splats)
    found = steady(found, request)
    return EncodedScene(found.data, found.tree, request.n_tiles, lifted.leaf_of, found.orders)


def encode_tree(
    tree: EvolutionTree,
    *,
    preset: str | Settings | None = None,
    target_psnr: float | None = None,
    target_bytes: int | None = None,
    max_error: MaxError | None = None,
    layers: int | None = None,
    polish: int = 0,
    cameras: Sequence[Camera] | None = None,
    up: Direction | None = None,
    n_tiles: int | None = None,
    effort: str | int | None = None,
    info: SceneInfo | None = None,
    progress: Progress | None = None,
) -> bytes:
    """The stream of a tree, as `evogs encode tree.npz` makes it.

    Without a preset and without a target, a tree that was trained in integers keeps them. Another
    tree is encoded to 52 dB against itself over rendered views; where nothing can be rendered, or
    views show too little, with the preset `trained` and a warning.

    Args:
        tree: any tree.
        preset: a name in `PRESETS` or settings. No target goes with it.
        target_psnr: dB of rendered views against the leaves of the tree.
        target_bytes: the best stream of at most this many bytes.
        max_error: no number of a leaf is further off, as of `encode_scene`.
        layers: of precision, as of `encode_scene`.
        polish: iterations of gradient descent, as of `encode_scene`.
        cameras: of the views, as of `encode_scene`.
        up: what is up in the default views, as of `encode_scene`.
        n_tiles: tiles wanted; by default 1 below about 200,000 leaves.
        effort: as of `encode_scene`.
        info: metadata; its text gets a `generator` if it has none.
        progress: called with a stage and the part of it that is done.

    Raises:
        TypeError: `tree` is none.
        TargetMissedError, NotRepresentableError, InputError, ValueError: as `encode_scene`.
    """
    return encode_tree_with_order(
        tree,
        preset=preset,
        target_psnr=target_psnr,
        target_bytes=target_bytes,
        max_error=max_error,
        layers=layers,
        polish=polish,
        cameras=cameras,
        up=up,
        n_tiles=n_tiles,
        effort=effort,
        info=info,
        progress=progress,
    ).data


def encode_tree_with_order(tree: EvolutionTree, **options: Unpack[TreeOptions]) -> EncodedScene:
    """`encode_tree`, with the order of the leaves in the stream.

    Args:
        tree: any tree, with N leaves.
        options: as of `encode_tree`, which says what is raised.
    """
    expect_tree(tree)
    request = Request.of(TREE_PRESET, options).looking_at(tree.shared_leaves())
    found = None
    if options.get("preset") is None and request.is_plain:
        if tree.quanta:
            own = Settings.of_quanta(tree.quanta)
            request = replace(
                request, settings=replace(own, zstd_level=request.settings.zstd_level)
            )
        elif tree.n_leaves:
            found = _at_tree_psnr(tree, request)
    is_sure = is_surely_in_reach(request, tree.shared_leaves())
    if tree.n_leaves >= CHECKED_FROM and not request.is_plain and not is_sure:
        is_sure = FewSplats.of_tree(tree).expect_in_reach(request)
    request = replace(request, is_in_reach=is_sure)
    if found is None:
        asked, leaf_error = replace(request, has_preset=True), (0.0,) * len(GROUPS)
        plain = best_stream([tree], asked, leaf_error, tree.shared_leaves())
        found = steady(plain, request)
    n = np.arange(tree.n_leaves)
    return EncodedScene(found.data, found.tree, request.n_tiles, n, found.orders)


def _at_tree_psnr(tree: EvolutionTree, request: Request) -> FoundStream | None:
    """Steady; None, with a warning, if views show nothing of the tree, or too little."""
    try:
        found = at_tree_psnr(tree, request)
        return None if found is None else steady(found, request)
    except InputError as error:  # of a few splats, or none that is seen
        warn_of_preset(error)
        return None


def _expect_splats(splats: object) -> None:
    if not isinstance(splats, SplatParams):
        other = "encode_tree takes trees" if isinstance(splats, EvolutionTree) else "see read_ply"
        raise TypeError(f"expected SplatParams, not {type(splats).__name__}: {other}")


def _improved(lifted: Lifted, improve: Callable[[EvolutionTree], EvolutionTree]) -> Lifted:
    tree = improve(lifted.tree)
    if tree.n_leaves != lifted.tree.n_leaves:
        said = f"{tree.n_leaves} leaves came back of {lifted.tree.n_leaves}"
        raise ValueError(f"improve must keep the leaves: {said}")
    return replace(lifted, tree=tree)
