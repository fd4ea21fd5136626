"""`evogs encode` and `evogs lift`."""

from __future__ import annotations

import argparse
import json
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evogs_codec._generated import registry
from evogs_codec.cli.default_view import with_default_camera, with_opening_view
from evogs_codec.cli.large_scenes import encode_large, wants_jobs
from evogs_codec.cli.looking import find_up, need_numba, without_refuted_up
from evogs_codec.cli.reporting import write_report
from evogs_codec.cli.reports import level_figures, print_levels
from evogs_codec.cli.terminal import noted_warnings, progress_bar
from evogs_codec.common.heap import keep_freed_memory
from evogs_codec.common.printable import shown
from evogs_codec.common.progress import Progress
from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.encoding.settings import PRESETS, SCENE_PRESET, TREE_PRESET, RangeBits, Settings
from evogs_codec.errors import InputError
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.io.files import KIND_BYTES, STREAM, kind_of, write_atomic
from evogs_codec.io.finite import drop_non_finite
from evogs_codec.io.foreign import hint_for_zip
from evogs_codec.io.interchange.scene_files import Scene, read_scene, size_of_scene
from evogs_codec.io.interchange.sog import is_sog
from evogs_codec.io.tree_npz import read_tree, write_tree
from evogs_codec.lifting.lift import N_LEVELS, lift
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene import encode_scene, encode_tree

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Up

# `full-date` or `date-time` of RFC 3339, as spec 8.4 has it.
CAPTURED = re.compile(r"\d{4}-\d\d-\d\d([Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d))?", re.ASCII)

__all__ = ["encode_file", "read_splats", "run_encode", "run_lift", "scene_info"]


def run_encode(args: argparse.Namespace) -> None:
    """`evogs encode`."""
    is_scene = _is_scene(args.input)
    _check(args, is_scene=is_scene)
    preset, notes = _preset(args, SCENE_PRESET if is_scene else TREE_PRESET), noted_warnings()
    if is_scene and wants_jobs(args):
        with progress_bar() as progress:
            tiles_up = encode_large(args, partial(scene_info, args), progress)
        size = args.output.stat().st_size
        data_there = np.memmap(args.output, np.uint8, "r").data
        _print_figures(args, read_directory(data_there), size, tiles_up)
        return
    keep_freed_memory(share=True)
    with progress_bar() as progress:
        if is_scene:
            scene = read_splats(args.input, drop_invalid=args.drop_invalid)
            splats = scene.splats
            info = with_default_camera(args, splats, scene_info(args, scene.info))
            up = find_up(args, splats, info)
            data = encode_scene(
                splats,
                levels=args.levels,
                preset=preset,
                palette="never" if args.no_palette else "auto",
                improve=_refiner(args, progress),
                info=info,
                **_options(args, progress),
            )
        else:
            tree = read_tree(args.input)
            splats = tree.leaves()
            info = with_default_camera(args, splats, scene_info(args, SceneInfo()))
            up = find_up(args, splats, info)
            data = encode_tree(
                tree,
                preset=preset,
                info=info,
                **_options(args, progress),
            )
    write_atomic(args.output, data)
    write_report(args, splats, data, up, notes)
    reached = _reached(args, splats, data, up)
    _print_figures(args, read_directory(data), len(data), up, reached)


def _reached(
    args: argparse.Namespace, splats: SplatParams, data: bytes, up: Up | None
) -> tuple[float, int] | None:
    """PSNR of a stream that has a target, dB, and over how many views; None without one."""
    has_target = args.target_psnr is not None or args.target_bytes is not None
    if not has_target or not len(splats) or find_spec("numba") is None:
        return None
    from evogs_codec.render import Views

    views = Views.of(splats, _cameras(args), up=None if up is None else up.vector)
    return views.psnr(decode_leaves(data)), len(views.cameras)


def _print_figures(
    args: argparse.Namespace,
    directory: Directory,
    size: int,
    up: Up | None,
    reached: tuple[float, int] | None = None,
) -> None:
    figures = level_figures(directory)
    n = figures[-1]["n_leaves"]
    each = size / max(n, 1)
    if args.json:
        found = {
            "output": str(args.output),
            "splats": n,
            "bytes": size,
            "bytes_per_splat": round(each, 3),
            "levels": figures,
            "up": None if up is None else {"axis": up.name, "source": up.source},
        }
        if reached is not None:
            found["psnr"], found["psnr_views"] = round(reached[0], 2), reached[1]
        print(json.dumps(found))
        return
    print(f"{shown(args.output)}: {n:,} splats, {size:,} bytes, {each:.2f} a splat")
    print_levels(directory)
    if reached is not None:
        print(f"\nreached: {reached[0]:.2f} dB over {reached[1]} views")
    if up is not None:
        print(f"\nviews: {up}")


def run_lift(args: argparse.Namespace) -> None:
    """`evogs lift`."""
    if not _is_scene(args.input):
        raise InputError(f"{args.input}: is a zip (.npz), not a scene: give a 3DGS .ply")
    with progress_bar() as progress:
        scene = read_splats(args.input, drop_invalid=args.drop_invalid)
        tree = lift(scene.splats, args.levels or N_LEVELS, progress=progress)
        up = find_up(args, scene.splats, scene.info) if args.refine else None
        refine = _refiner(args, progress)
        tree = tree if refine is None else refine(tree)
    write_tree(args.output, tree, made_by=args.command)
    said = "" if up is None else f", {up}"
    print(f"{shown(args.output)}: {tree.n_leaves:,} splats, {tree.n_levels} levels{said}")


def encode_file(path: Path, progress: Progress, effort: str | int | None = None) -> bytes:
    """A scene or a `.tree.npz` as a stream, as `evogs encode` without other options makes it.

    Splats with NaN or infinite numbers are left out. The default camera of a scene that names none
    is the view that `evogs render` shows, so that a page opens on its front.

    Raises:
        InputError: the file is neither.
    """
    if _is_scene(path):
        scene = read_splats(path, drop_invalid=True)
        info = with_opening_view(scene.splats, scene.info)
        return encode_scene(scene.splats, effort=effort, info=info, progress=progress)
    return encode_tree(read_tree(path), effort=effort, progress=progress)


# --- what is encoded ------------------------------------------------------------------------------


def _is_scene(path: Path) -> bool:
    """Whether to read a scene, and not a `.tree.npz`: judged by the first bytes of the file.

    Raises:
        InputError: the file is a stream, or a zip that is neither.
    """
    if path.is_dir():
        return True
    with path.open("rb") as file:
        start = file.read(KIND_BYTES)
    if kind_of(start) is STREAM:
        raise InputError(
            f"{path}: is an EvoGS stream already: `evogs extract` makes a smaller one;"
            f" to encode it again, decode it first: `evogs decode {path} OUT.ply`"
        )
    is_zip = start.startswith(b"PK") and not is_sog(path, start)
    if is_zip and (hint := hint_for_zip(path)):
        raise InputError(f"{path}: {hint}")
    return not is_zip


def read_splats(path: Path, *, drop_invalid: bool) -> Scene:
    """The scene of a file, whose splats have finite numbers.

    Raises:
        InputError: the file cannot be used, or splats with others are not to be dropped.
    """
    scene = read_scene(path)
    splats, n_invalid = drop_non_finite(scene.splats)
    if n_invalid and not drop_invalid:
        raise InputError(
            f"{path}: {n_invalid:,} of {n_invalid + len(splats):,} splats have a NaN or an infinite"
            " number: use --drop-invalid to leave them out"
        )
    if n_invalid and not len(splats):
        raise InputError(f"{path}: all {n_invalid:,} splats have a NaN or an infinite number")
    if n_invalid:
        warnings.warn(f"{n_invalid:,} splats with NaN or infinite numbers left out", stacklevel=1)
    return Scene(splats, without_refuted_up(replace(scene, splats=splats)))


def _refiner(
    args: argparse.Namespace, progress: Progress
) -> Callable[[EvolutionTree], EvolutionTree] | None:
    """What `--refine` asks for: the refiners of the entry points `evogs.refiners`, in turn."""
    if not args.refine:
        return None
    refiners = entry_points(group="evogs.refiners")
    if not refiners:
        raise InputError("--refine renders views: pip install -e '.[render]'")

    def refine(tree: EvolutionTree) -> EvolutionTree:
        for entry in refiners:
            tree = entry.load()(tree, args.camera, args.up, args.refine, progress)
        return tree

    return refine


# --- how it is encoded ----------------------------------------------------------------------------


def _check(args: argparse.Namespace, *, is_scene: bool) -> None:
    """Refuse options that do not go together."""
    if args.finer and (args.target_psnr or args.target_bytes or args.max_error):
        raise InputError("--finer does not go with a target: the target decides how fine steps are")
    if args.polish and not (args.target_psnr or args.target_bytes):
        raise InputError("--polish needs --target-psnr or --target-bytes")
    steps = args.preset or args.bits or args.near_lossless or args.finer or args.max_error
    if args.layers and args.layers > 1 and steps:
        raise InputError("--layers: views decide how exact each layer is, so no steps go with it")
    if args.finer and (args.bits or args.near_lossless or args.preset == "paper"):
        raise InputError("--finer divides steps: for finer ranges --bits, for more --max-error")
    if args.refine and not is_scene:
        raise InputError("--refine is for .ply scenes: a tree has its levels")
    if args.levels is not None and not is_scene:
        raise InputError("--levels is for scenes: a tree has its levels")
    if not is_scene and wants_jobs(args):
        raise InputError(
            "several inputs, --workers, --engine, --scheduler, --scratch and --resume are for"
            " scenes, which are encoded tile by tile: a tree is encoded whole"
        )
    if args.page is not None:
        need_numba()


def _preset(args: argparse.Namespace, default: str) -> str | Settings | None:
    """What the options say of steps; None if they say nothing."""
    if args.near_lossless:
        return "near-lossless"
    if args.bits:
        return replace(PRESETS[default], accuracy=RangeBits(args.bits))
    if args.finer:
        return PRESETS[args.preset or default].finer(args.finer)
    preset: str | None = args.preset
    return preset


def _options(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """The options that scenes and trees have in common."""
    errors: dict[str, float] = {}
    for given in sorted(args.max_error or [], key=len, reverse=True):  # one for all groups first
        errors |= given
    return {
        "target_psnr": args.target_psnr,
        "target_bytes": _target_bytes(args),
        "max_error": errors or None,
        "layers": args.layers,
        "polish": args.polish or 0,
        "cameras": _cameras(args),
        "up": args.up,
        "n_tiles": args.tiles,
        "effort": args.effort,
        "progress": progress,
    }


def _target_bytes(args: argparse.Namespace) -> int | None:
    if args.target_bytes is None:
        return None
    n_bytes: int = args.target_bytes.of(size_of_scene(args.input))
    if n_bytes < 1:
        raise InputError("--target-bytes: a stream has at least one byte")
    return n_bytes


def _cameras(args: argparse.Namespace) -> list[Camera] | None:
    """Those of the file; None without one, or where nothing renders."""
    if args.camera is None or find_spec("numba") is None:
        return None
    from evogs_codec.render import load_cameras

    cameras = load_cameras(args.camera)
    if args.polish and len(cameras) < 2:
        raise InputError(f"{args.camera}: 1 camera, expected at least 2")
    return cameras


def scene_info(args: argparse.Namespace, known: SceneInfo) -> SceneInfo:
    """What the options say of the scene; where they say nothing, what is known of the file."""
    given = {key: getattr(args, key) for key in registry.TEXT_OPTIONS if getattr(args, key)}
    if "captured" in given and not CAPTURED.fullmatch(given["captured"]):
        raise InputError("--captured: expected a date, 2026-09-30, or 2026-09-30T12:00:00Z")

    def number(names: tuple[str, ...], option: str, otherwise: int) -> int:
        return names.index(option) or otherwise

    return SceneInfo(
        coordinate_system=number(
            registry.COORDINATE_SYSTEMS, args.coordinate_system, known.coordinate_system
        ),
        up_axis=number(registry.UP_AXES, args.up_axis, known.up_axis),
        unit=number(registry.UNITS, args.unit, known.unit),
        colour_space=number(registry.COLOUR_SPACES, args.colour_space, known.colour_space),
        antialiased=args.antialiased or known.antialiased,
        text={**known.text, **given},
    )
