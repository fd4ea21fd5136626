"""The commands that make trees: `evogs encode` and `evogs lift`."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

from evogs_codec._generated import registry
from evogs_codec.cli.reports import level_figures, print_levels
from evogs_codec.cli.terminal import progress_bar, version
from evogs_codec.common.printable import shown
from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.measured_gains import ORDERING_VIEWS, Pictures
from evogs_codec.encoding.settings import PRESETS, TREE_PSNR, Settings
from evogs_codec.encoding.targets import TargetEncoder, TargetMissedError
from evogs_codec.encoding.write import Progress
from evogs_codec.errors import InputError
from evogs_codec.format.directory import read_directory
from evogs_codec.io.files import write_atomic
from evogs_codec.io.ply import drop_non_finite, read_ply
from evogs_codec.io.tree_npz import read_tree, write_tree
from evogs_codec.lifting.lift import Lifted, lift_with_order, off_of
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree

__all__ = ["run_encode", "run_lift"]


def run_encode(args: argparse.Namespace) -> None:
    """`evogs encode`."""
    is_scene = _is_ply(args.input)
    if args.finer and (args.target_psnr or args.target_bytes or args.max_error):
        raise InputError("--finer does not go with a target: the target decides how fine steps are")
    if args.polish and not (args.target_psnr or args.target_bytes):
        raise InputError("--polish needs --target-psnr or --target-bytes")
    settings = _settings(args, "scene" if is_scene else "trained")
    if args.finer and (settings.range_bits or settings.near_lossless):
        raise InputError("--finer divides steps: for finer ranges --bits, for more --max-error")
    info = _scene_info(args)
    off = (0.0,) * len(GROUPS)
    shared: EvolutionTree | None = None
    with progress_bar() as progress:
        if is_scene:
            splats = _read_splats(args.input, drop_invalid=args.drop_invalid)
            lifted = _lifted(splats, args, progress)
            tree = lifted.tree
            shared = None if args.no_palette else with_palette(lifted, splats)
            if args.max_error:
                off = off_of(shared or tree, splats, lifted.leaf_of)
        elif args.refine:
            raise InputError("--refine is for .ply scenes: a tree has its levels")
        else:
            tree = read_tree(args.input)
        data = _encoded(tree, shared, settings, info, args, progress, off)
    write_atomic(args.output, data)
    directory = read_directory(memoryview(data))
    n = tree.n_leaves
    figures = {
        "output": str(args.output),
        "splats": n,
        "bytes": len(data),
        "bytes_per_splat": round(len(data) / max(n, 1), 3),
        "levels": level_figures(directory),
    }
    if args.json:
        print(json.dumps(figures))
        return
    name, each = shown(args.output), len(data) / max(n, 1)
    print(f"{name}: {n:,} splats, {len(data):,} bytes, {each:.2f} a splat")
    print_levels(directory)


def run_lift(args: argparse.Namespace) -> None:
    """`evogs lift`."""
    with progress_bar() as progress:
        splats = _read_splats(args.input, drop_invalid=args.drop_invalid)
        tree = _lifted(splats, args, progress).tree
    write_tree(args.output, tree)
    print(f"{shown(args.output)}: {tree.n_leaves:,} splats, {tree.n_levels} levels")


# --- what is encoded -----------------------------------------------------------------------------


def _is_ply(path: Path) -> bool:
    """Not a `.tree.npz`, judged by the file's first bytes."""
    with path.open("rb") as file:
        return file.read(2) != b"PK"


def _read_splats(path: Path, *, drop_invalid: bool) -> SplatParams:
    splats, n_invalid = drop_non_finite(read_ply(path))
    if n_invalid and not drop_invalid:
        raise InputError(
            f"{path}: {n_invalid:,} of {n_invalid + len(splats):,} splats have a NaN or an infinite"
            " number: use --drop-invalid to leave them out"
        )
    if n_invalid:
        warnings.warn(f"{n_invalid:,} splats with NaN or infinite numbers left out", stacklevel=1)
    return splats


def _lifted(splats: SplatParams, args: argparse.Namespace, progress: Progress) -> Lifted:
    """Its coarse levels refined, if that is asked for; the leaves and their order stay."""
    lifted = lift_with_order(splats, args.levels, progress=lambda part: progress("lift", part))
    if not args.refine:
        return lifted
    refiners = entry_points(group="evogs.refiners")
    if not refiners:
        raise InputError("--refine draws pictures: pip install -e '.[render]'")
    tree = lifted.tree
    for entry in refiners:
        refine = entry.load()
        tree = refine(
            tree, args.camera, args.up, args.refine, lambda part: progress("refine", part)
        )
    return replace(lifted, tree=tree)


# --- how it is encoded ---------------------------------------------------------------------------


def _settings(args: argparse.Namespace, default: str) -> Settings:
    settings = PRESETS["near-lossless" if args.near_lossless else args.preset or default]
    if args.bits:
        settings = replace(settings, range_bits=args.bits)
    if args.finer:
        settings = settings.finer(args.finer)
    return replace(settings, effort=args.effort)


def _encoded(
    tree: EvolutionTree,
    shared: EvolutionTree | None,
    settings: Settings,
    info: SceneInfo,
    args: argparse.Namespace,
    progress: Progress,
    off: tuple[float, ...],
) -> bytes:
    """At a target, if there is one; `off` as of `TargetEncoder`.

    Where splats share their SH, `shared` is the tree with a palette. Both are encoded, as the one
    without may be smaller: of few splats, or where a target leaves SH few bits.
    """
    whole = TargetEncoder(tree, settings, off=off, n_tiles=args.tiles, info=info, progress=progress)
    trees = [shared, tree] if shared else [tree]

    def best(
        make: Callable[[TargetEncoder], bytes], aim: TargetEncoder, *, by_psnr: bool = False
    ) -> bytes:
        return _best([replace(aim, tree=one) for one in trees], make, by_psnr=by_psnr)

    if args.max_error:
        errors: dict[str, float] = {}
        for given in sorted(args.max_error, key=len, reverse=True):  # one for all groups first
            errors |= given
        return best(lambda aim: aim.within(errors), whole)
    if args.target_psnr is None and args.target_bytes is None:
        if _is_open(args) and tree.quanta:
            settings = replace(Settings.of_quanta(tree.quanta), effort=args.effort)
        elif _is_open(args) and not _is_ply(args.input) and tree.n_leaves:
            nearest = _as_near_as_pictures_tell(whole, args)
            if nearest is not None:
                return nearest
        pictures = _pictures(tree, args, ORDERING_VIEWS) if tree.n_leaves else None

        def plainly(aim: TargetEncoder) -> bytes:
            return encode(
                aim.tree,
                settings,
                n_tiles=args.tiles,
                info=info,
                pictures=pictures,
                progress=progress,
            )

        return best(plainly, whole)
    if not tree.n_leaves:
        raise InputError("a scene without splats has nothing to aim at")
    aim = replace(whole, pictures=_pictures(tree, args), polish=args.polish or 0)
    if aim.pictures is None and (args.polish or args.target_bytes is None):
        option = "--polish" if args.polish else "--target-psnr"
        raise InputError(f"{option} draws pictures: pip install -e '.[render]'")
    if args.polish and not any(
        s.level == tree.n_levels - 1 > 0 and s.psi.any() for s in tree.steps
    ):
        warnings.warn("--polish changes nothing: the last level refines nothing", stacklevel=1)
    if args.target_bytes is not None:
        return best(lambda one: one.at_bytes(args.target_bytes), aim, by_psnr=True)
    return best(lambda one: one.at_psnr(args.target_psnr), aim)


def _best(
    aims: Sequence[TargetEncoder], make: Callable[[TargetEncoder], bytes], *, by_psnr: bool
) -> bytes:
    """The smallest of the streams that meet a target, or that with the best pictures.

    Without pictures to tell by, the first that meets it.

    Raises:
        TargetMissedError: of the one that comes nearest, if none does.
    """
    found: list[tuple[float, bytes]] = []
    missed: list[TargetMissedError] = []
    for aim in aims:
        try:
            data = make(aim)
        except TargetMissedError as error:
            missed.append(error)
            continue
        if not by_psnr:
            found.append((-len(data), data))
        elif len(aims) == 1 or aim.pictures is None:
            return data
        else:
            found.append((aim.psnr(data), data))
    if not found:
        raise min(missed, key=lambda error: error.by)
    return max(found, key=lambda one: one[0])[1]


def _is_open(args: argparse.Namespace) -> bool:
    """Whether no option says how fine steps are; targets are asked for before."""
    return not (args.preset or args.bits or args.near_lossless or args.finer)


def _as_near_as_pictures_tell(aim: TargetEncoder, args: argparse.Namespace) -> bytes | None:
    """At `TREE_PSNR`; None if nothing can draw the tree, or if pictures tell too little of it."""
    pictures = _pictures(aim.tree, args)
    instead = "encoded with --preset trained instead"
    if pictures is None:
        warnings.warn(f"no pictures to aim at: pip install -e '.[render]'; {instead}", stacklevel=1)
        return None
    try:
        return replace(aim, pictures=pictures).at_psnr(TREE_PSNR)
    except InputError as error:  # of a few splats, or none that is seen
        warnings.warn(f"{error}; {instead}", stacklevel=1)
        return None


def _pictures(
    tree: EvolutionTree, args: argparse.Namespace, n_views: int | None = None
) -> Pictures | None:
    """Of the leaves, where something can draw them."""
    for entry in entry_points(group="evogs.pictures"):
        draw = entry.load()
        found: Pictures | None = draw(
            tree.leaves(), args.camera, args.up, n_views, polish=bool(args.polish)
        )
        return found
    return None


def _scene_info(args: argparse.Namespace) -> SceneInfo:
    text = {key: getattr(args, key) for key in registry.TEXT_OPTIONS if getattr(args, key)}
    text["generator"] = f"evogs {version()}"
    return SceneInfo(
        coordinate_system=registry.COORDINATE_SYSTEMS.index(args.coordinate_system),
        up_axis=registry.UP_AXES.index(args.up_axis),
        unit=registry.UNITS.index(args.unit),
        colour_space=registry.COLOUR_SPACES.index(args.colour_space),
        antialiased=args.antialiased,
        text=text,
    )
