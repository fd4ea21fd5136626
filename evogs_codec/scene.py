"""A whole encode in one call: what `evogs encode` does, as functions.

splats -> lift -> with a palette, or without -> to an accuracy or a target -> the smallest stream
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal, TypeAlias, TypedDict

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.common.version import __version__
from evogs_codec.encoding.arrange import leaf_order
from evogs_codec.encoding.encode import encode, expect_tree
from evogs_codec.encoding.measured_gains import ORDERING_VIEWS
from evogs_codec.encoding.settings import PRESETS, TREE_PSNR, Settings
from evogs_codec.encoding.targets import TargetEncoder, TargetMissedError
from evogs_codec.errors import InputError
from evogs_codec.lifting.lift import Lifted, lift_with_order, off_of
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import I64, SplatParams
from evogs_codec.model.tree import EvolutionTree

if TYPE_CHECKING:
    from typing import Unpack

    from evogs_codec.render import Camera, Views

__all__ = [
    "EncodedScene",
    "SceneOptions",
    "encode_scene",
    "encode_scene_with_order",
    "encode_tree",
]

N_LEVELS = 5  # of a lifted scene
NO_NUMBA = "numba is missing: pip install -e '.[render]'"

MaxError: TypeAlias = "float | Mapping[str, float]"


class TreeOptions(TypedDict, total=False):
    """The options of `encode_tree`."""

    preset: str | Settings | None
    target_psnr: float | None
    target_bytes: int | None
    max_error: MaxError | None
    polish: int
    cameras: Sequence[Camera] | None
    up: str
    n_tiles: int | None
    effort: int | None
    info: SceneInfo | None
    progress: Progress | None


class SceneOptions(TreeOptions, total=False):
    """The options of `encode_scene`."""

    levels: int
    palette: Literal["auto", "never"]
    improve: Callable[[EvolutionTree], EvolutionTree] | None


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """A stream, and where its splats come from.

    Attributes:
        data: the stream.
        tree: what was encoded, with a palette where that is smaller.
        n_tiles: as it was asked for.
        leaf_of: (N,) the index of the input splat that each leaf of `tree` is.
    """

    data: bytes
    tree: EvolutionTree
    n_tiles: int | None
    leaf_of: I64

    @cached_property
    def leaf_order(self) -> I64:
        """(N,) the index of the input splat that each splat of `decode(data).leaves()` is."""
        return self.leaf_of[leaf_order(self.tree, self.n_tiles)]

    def __repr__(self) -> str:
        return f"EncodedScene({len(self.data)} bytes, {len(self.leaf_of)} splats)"


def encode_scene(
    splats: SplatParams,
    *,
    levels: int = N_LEVELS,
    preset: str | Settings | None = None,
    palette: Literal["auto", "never"] = "auto",
    target_psnr: float | None = None,
    target_bytes: int | None = None,
    max_error: MaxError | None = None,
    polish: int = 0,
    improve: Callable[[EvolutionTree], EvolutionTree] | None = None,
    cameras: Sequence[Camera] | None = None,
    up: str = "z",
    n_tiles: int | None = None,
    effort: int | None = None,
    info: SceneInfo | None = None,
    progress: Progress | None = None,
) -> bytes:
    """The stream of splats, as `evogs encode scene.ply` makes it.

    Args:
        splats: N splats, all finite (`drop_non_finite`).
        levels: of the tree that is built under them, 1 to 64.
        preset: a name in `PRESETS` or settings; "scene" by default. No target goes with it.
        palette: "auto" stores SH above band 0 once where splats share them, if that is smaller;
            "never" stores them splat by splat.
        target_psnr: dB of rendered views against the splats; the smallest stream that has it.
        target_bytes: the best stream of at most this many bytes.
        max_error: no number of a splat is further off: one for all groups, in the units of each
            group, or one per name of a group (position, rotation, scale, opacity, sh).
        polish: with `target_psnr` or `target_bytes`, iterations of gradient descent that move the
            integers of the last level.
        improve: is given the lifted tree and returns one with better coarse levels, for instance
            by `reference_trainer.distil`; its leaves and their order must stay.
        cameras: of the views; by default 24 around the splats. With `polish` every 5th judges. An
            empty sequence: nothing is rendered, and estimates put packets in order.
        up: axis that is up in the default views: x, y or z, perhaps with a minus.
        n_tiles: tiles wanted; by default 1 below about 200,000 splats.
        effort: Zstandard level, 1..22; by default that of the settings, 19.
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
    levels, palette = options.pop("levels", N_LEVELS), options.pop("palette", "auto")
    improve = options.pop("improve", None)
    if palette not in ("auto", "never"):
        raise ValueError(f"palette is {palette!r}, expected 'auto' or 'never'")
    request = _Request.of("scene", options)
    lifted = lift_with_order(splats, levels, progress=request.progress)
    if improve is not None:
        lifted = _improved(lifted, improve)
    shared = with_palette(lifted, splats) if palette == "auto" else None
    leaf_error = (0.0,) * len(GROUPS)
    if request.errors:
        leaf_error = off_of(shared or lifted.tree, splats, lifted.leaf_of)
    # The tree without a palette may be smaller: of few splats, or where a target leaves SH few
    # bits.
    trees = [shared, lifted.tree] if shared else [lifted.tree]
    found = _encoded(trees, request, leaf_error)
    return EncodedScene(found.data, found.tree, request.n_tiles, lifted.leaf_of)


def encode_tree(
    tree: EvolutionTree,
    *,
    preset: str | Settings | None = None,
    target_psnr: float | None = None,
    target_bytes: int | None = None,
    max_error: MaxError | None = None,
    polish: int = 0,
    cameras: Sequence[Camera] | None = None,
    up: str = "z",
    n_tiles: int | None = None,
    effort: int | None = None,
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
        polish: iterations of gradient descent, as of `encode_scene`.
        cameras: of the views, as of `encode_scene`.
        up: axis that is up in the default views.
        n_tiles: tiles wanted; by default 1 below about 200,000 leaves.
        effort: Zstandard level, 1..22; by default that of the settings, 19.
        info: metadata; its text gets a `generator` if it has none.
        progress: called with a stage and the part of it that is done.

    Raises:
        TypeError: `tree` is none.
        TargetMissedError, NotRepresentableError, InputError, ValueError: as `encode_scene`.
    """
    expect_tree(tree)
    options: TreeOptions = {
        "preset": preset,
        "target_psnr": target_psnr,
        "target_bytes": target_bytes,
        "max_error": max_error,
        "polish": polish,
        "cameras": cameras,
        "up": up,
        "n_tiles": n_tiles,
        "effort": effort,
        "info": info,
        "progress": progress,
    }
    request = _Request.of("trained", options)
    if preset is None and request.is_plain:
        if tree.quanta:
            own = Settings.of_quanta(tree.quanta)
            request = replace(request, settings=replace(own, effort=request.settings.effort))
        elif tree.n_leaves:
            nearest = _at_tree_psnr(tree, request)
            if nearest is not None:
                return nearest
    return _encoded([tree], request, (0.0,) * len(GROUPS)).data


def _expect_splats(splats: object) -> None:
    if not isinstance(splats, SplatParams):
        other = "encode_tree takes trees" if isinstance(splats, EvolutionTree) else "see read_ply"
        raise TypeError(f"expected SplatParams, not {type(splats).__name__}: {other}")


# --- options --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Request:
    """The options of an encode, checked."""

    settings: Settings
    target_psnr: float | None
    target_bytes: int | None
    errors: Mapping[str, float]
    polish: int
    cameras: Sequence[Camera] | None
    up: str
    n_tiles: int | None
    info: SceneInfo
    progress: Progress

    @staticmethod
    def of(default: str, options: TreeOptions) -> _Request:
        """From the options that a caller gave; `default` is the name of a preset."""
        unknown = sorted(set(options) - set(TreeOptions.__annotations__))
        if unknown:
            raise TypeError(f"no such option: {', '.join(unknown)}")
        preset, polish = options.get("preset"), options.get("polish", 0)
        psnr, n_bytes = options.get("target_psnr"), options.get("target_bytes")
        errors = _errors_of(options.get("max_error"))
        n_targets = (psnr is not None) + (n_bytes is not None) + bool(errors)
        if n_targets > 1:
            raise ValueError("target_psnr, target_bytes and max_error exclude each other")
        if n_targets and preset is not None:
            raise ValueError("a preset does not go with a target: the target decides the steps")
        if polish and (n_targets == 0 or errors):
            raise ValueError("polish needs target_psnr or target_bytes")
        settings = _settings_of(default if preset is None else preset)
        effort, n_tiles = options.get("effort"), options.get("n_tiles")
        if effort is not None and not 1 <= effort <= 22:
            raise ValueError(f"effort is {effort}, expected 1..22")
        if n_tiles is not None and n_tiles < 1:
            raise ValueError(f"n_tiles is {n_tiles}, expected at least 1")
        return _Request(
            settings=settings if effort is None else replace(settings, effort=effort),
            target_psnr=psnr,
            target_bytes=n_bytes,
            errors=errors,
            polish=polish,
            cameras=options.get("cameras"),
            up=options.get("up", "z"),
            n_tiles=n_tiles,
            info=_with_generator(options.get("info") or SceneInfo()),
            progress=options.get("progress") or no_progress,
        )

    @property
    def is_plain(self) -> bool:
        """There is no target."""
        return self.target_psnr is None and self.target_bytes is None and not self.errors

    @property
    def why_no_views(self) -> str:
        """Why `views` has none; empty if it has some."""
        if self.cameras is not None and not len(self.cameras):
            return "there are no cameras"
        return NO_NUMBA if find_spec("numba") is None else ""

    def views(
        self, scene: SplatParams, n_views: int | None = None, *, descent: bool = False
    ) -> Views | None:
        """Of the scene; None where nothing can be rendered, or is to be."""
        if self.why_no_views:
            return None
        from evogs_codec.render import Views

        return Views.of(scene, self.cameras, up=self.up, n_views=n_views, descent=descent)


def _settings_of(preset: str | Settings) -> Settings:
    if isinstance(preset, Settings):
        return preset
    if preset not in PRESETS:
        raise ValueError(f"preset is {preset!r}, expected Settings or one of {', '.join(PRESETS)}")
    return PRESETS[preset]


def _errors_of(max_error: MaxError | None) -> dict[str, float]:
    if max_error is None:
        return {}
    if not isinstance(max_error, Mapping):
        return dict.fromkeys(GROUPS, float(max_error))
    unknown = sorted(set(max_error) - set(GROUPS))
    if unknown or not max_error:
        raise ValueError(f"max_error is of {unknown or 'no group'}, expected {', '.join(GROUPS)}")
    return dict(max_error)


def _with_generator(info: SceneInfo) -> SceneInfo:
    return replace(info, text={**info.text, "generator": f"evogs {__version__}"} | dict(info.text))


def _improved(lifted: Lifted, improve: Callable[[EvolutionTree], EvolutionTree]) -> Lifted:
    tree = improve(lifted.tree)
    if tree.n_leaves != lifted.tree.n_leaves:
        said = f"{tree.n_leaves} leaves came back of {lifted.tree.n_leaves}"
        raise ValueError(f"improve must keep the leaves: {said}")
    return replace(lifted, tree=tree)


# --- encoding -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Found:
    """A stream and the tree that it is of; the larger `merit` is the better."""

    data: bytes
    tree: EvolutionTree
    merit: float


def _encoded(
    trees: Sequence[EvolutionTree], request: _Request, leaf_error: tuple[float, ...]
) -> _Found:
    """The best stream of trees with the same leaves, at the target if there is one."""
    tree = trees[-1]
    whole = TargetEncoder(
        tree,
        request.settings,
        leaf_error=leaf_error,
        n_tiles=request.n_tiles,
        info=request.info,
        progress=request.progress,
    )
    if request.errors:
        return _best(trees, whole, lambda aim: aim.within(request.errors))
    if request.is_plain:
        views = request.views(tree.leaves(), ORDERING_VIEWS) if tree.n_leaves else None

        def plainly(aim: TargetEncoder) -> bytes:
            return encode(
                aim.tree,
                request.settings,
                n_tiles=request.n_tiles,
                info=request.info,
                views=views,
                progress=request.progress,
            )

        return _best(trees, whole, plainly)
    if not tree.n_leaves:
        raise InputError("a scene without splats has nothing to aim at")
    views = request.views(tree.leaves(), descent=request.polish > 0)
    if views is None and (request.polish or request.target_psnr is not None):
        what = "polishing" if request.polish else "a target PSNR"
        raise InputError(f"{what} needs rendered views: {request.why_no_views}")
    if request.polish and not any(
        step.level == tree.n_levels - 1 > 0 and step.psi.any() for step in tree.steps
    ):
        warnings.warn("polishing changes nothing: the last level refines nothing", stacklevel=3)
    aim = replace(whole, views=views, polish=request.polish)
    if request.target_bytes is not None:
        most = request.target_bytes
        return _best(trees, aim, lambda one: one.at_bytes(most), by_psnr=True)
    target = request.target_psnr
    assert target is not None, "there is a target"
    return _best(trees, aim, lambda one: one.at_psnr(target))


def _best(
    trees: Sequence[EvolutionTree],
    aim: TargetEncoder,
    make: Callable[[TargetEncoder], bytes],
    *,
    by_psnr: bool = False,
) -> _Found:
    """The smallest of the streams that meet a target, or that with the highest PSNR.

    Without views to tell the PSNR, the first that meets it.

    Raises:
        TargetMissedError: of the tree that comes nearest, if none meets it.
    """
    found: list[_Found] = []
    missed: list[TargetMissedError] = []
    for tree in trees:
        one = replace(aim, tree=tree)
        try:
            data = make(one)
        except TargetMissedError as error:
            missed.append(error)
            continue
        if not by_psnr:
            found.append(_Found(data, tree, -len(data)))
        elif len(trees) == 1 or one.views is None:
            return _Found(data, tree, math.inf)
        else:
            found.append(_Found(data, tree, one.psnr(data)))
    if not found:
        raise min(missed, key=lambda error: error.by)
    return max(found, key=lambda one: one.merit)


def _at_tree_psnr(tree: EvolutionTree, request: _Request) -> bytes | None:
    """At `TREE_PSNR`; None if nothing can be rendered, or if views show too little of the tree."""
    views = request.views(tree.leaves())
    instead = "encoded with the preset trained instead"
    if views is None:
        warnings.warn(f"{request.why_no_views}; {instead}", stacklevel=3)
        return None
    aim = TargetEncoder(
        tree,
        request.settings,
        views,
        n_tiles=request.n_tiles,
        info=request.info,
        progress=request.progress,
    )
    try:
        return aim.at_psnr(TREE_PSNR)
    except InputError as error:  # of a few splats, or none that is seen
        warnings.warn(f"{error}; {instead}", stacklevel=3)
        return None
