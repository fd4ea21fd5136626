"""What the command line says of a stream, as text and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from evogs_codec._generated import registry
from evogs_codec.common.printable import shown
from evogs_codec.decoding.cut import Cut, scene_bounds
from evogs_codec.editing.byte_stats import GroupBytes, levels
from evogs_codec.editing.level_psnr import KEY as PSNR
from evogs_codec.editing.level_psnr import level_psnr
from evogs_codec.editing.omissions import Omission
from evogs_codec.editing.presence import LevelPresence, level_presence
from evogs_codec.format.directory import Directory
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.viewpoint import default_viewpoint

__all__ = [
    "fetched_text",
    "info_of",
    "info_to_write",
    "level_figures",
    "print_info",
    "print_levels",
]


ENDS = ("low", "high")


def info_to_write(directory: Directory) -> SceneInfo:
    """What a scene says of itself outside the stream: not the PSNR of levels."""
    text = {key: value for key, value in directory.info.text.items() if key != PSNR}
    return replace(directory.info, text=text)


def level_figures(directory: Directory) -> list[dict[str, Any]]:
    """Figures per level for JSON, which has no NaN: an unknown error or PSNR is null."""
    figures = [
        asdict(level) | {"psnr": decibels}
        for level, decibels in zip(levels(directory), _decibels(directory), strict=True)
    ]
    return [{k: v if v == v else None for k, v in level.items()} for level in figures]


def _decibels(directory: Directory) -> list[float | None]:
    """(n_levels,) PSNR of each level; None where the stream has no packet of it or is silent."""
    known = level_psnr(directory)
    found: tuple[float | None, ...] = () if known is None else known.decibels
    found += (None,) * (directory.n_levels - len(found))
    has_packets = [level.n_bytes > 0 for level in levels(directory)]
    return [one if has else None for one, has in zip(found, has_packets, strict=True)]


def info_of(
    directory: Directory,
    size: int,
    groups: dict[str, GroupBytes],
    left_out: Sequence[Omission] = (),
) -> dict[str, Any]:
    """What `evogs info` says of a stream of which `size` bytes are there."""
    scene, presence, known = directory.info, presence_of(directory, size), level_psnr(directory)
    text = {key: value for key, value in scene.text.items() if key != PSNR or known is None}
    bounds, camera = scene_bounds(directory), default_viewpoint(scene.text)
    return {
        "tier": directory.tier,
        "sh_degree": directory.sh_degree,
        "tiles": len(directory.tiles),
        "packets": len(directory.packets),
        "palette_entries": directory.n_entries,
        "size": directory.size,
        "bytes_present": size,
        "grid_exponents": list(directory.grid_exponents),
        "scene": {
            "coordinate_system": registry.name(
                registry.COORDINATE_SYSTEMS, scene.coordinate_system
            ),
            "up_axis": registry.name(registry.UP_AXES, scene.up_axis),
            "unit": registry.name(registry.UNITS, scene.unit),
            "colour_space": registry.name(registry.COLOUR_SPACES, scene.colour_space),
            "antialiased": scene.antialiased,
            **text,
        },
        "bounds": {end: corner.tolist() for end, corner in zip(ENDS, bounds, strict=True)},
        "camera": None if camera is None else camera.members(),
        "psnr_views": None if known is None else known.views,
        "levels": [
            figures | {"presence": there.state, "has_all_splats": there.has_all_splats}
            for figures, there in zip(level_figures(directory), presence, strict=True)
        ],
        "groups": {name: asdict(part) for name, part in groups.items()},
        "left_out": [asdict(omission) for omission in left_out],
        "digests": len(directory.digests),
    }


def print_info(directory: Directory, info: dict[str, Any], groups: dict[str, GroupBytes]) -> None:
    """What `evogs info` prints."""
    for key in ("tier", "sh_degree", "tiles", "packets", "size", "grid_exponents"):
        print(f"{key:>18}  {info[key]}")
    if directory.has_palette:
        print(f"{'palette_entries':>18}  {info['palette_entries']}")
    for key, value in info["scene"].items():
        print(f"{shown(key):>18}  {shown(value)}")
    low, high = ((f"{x:.6g}" for x in info["bounds"][end]) for end in ENDS)
    print(f"{'bounds':>18}  {' '.join(low)} to {' '.join(high)}")
    if info["psnr_views"] is not None:
        print(f"{'PSNR of':>18}  {shown(info['psnr_views'])}")
    if "bytes_fetched" in info:
        fetched = fetched_text(info["bytes_fetched"], info["requests"])
        print(f"{'fetched':>18}  {fetched}; bytes by group need all packets")
    present = info["bytes_present"]
    if present < directory.size:
        print(f"{'truncated':>18}  {present:,} of {directory.size:,} bytes are there")
    print_levels(directory, presence_of(directory, present) if present < directory.size else None)
    if not groups:
        return
    n = max(info["levels"][-1]["n_leaves"], 1)
    print(f"\n{'part':>17} {'bytes':>12} {'a splat':>8} {'share':>7} {'over order-0':>13}")
    for name, part in groups.items():
        over = f"{100 * (part.n_bytes / part.entropy - 1):+.1f} %" if part.entropy else ""
        share = 100 * part.n_bytes / directory.size
        print(
            f"{name:>17} {part.n_bytes:>12,.0f} {part.n_bytes / n:>8.3f} {share:>5.1f} % {over:>13}"
        )
    print_omissions(info["left_out"])


def fetched_text(n_bytes: int, n_requests: int) -> str:
    """How much was fetched of a URL."""
    return f"{n_bytes:,} bytes in {n_requests} request{'s' if n_requests > 1 else ''}"


def print_omissions(left_out: list[dict[str, Any]]) -> None:
    """A row for all that is not there; changes are root mean squares, in the units of the part."""
    if left_out:
        print(f"\n{'left out':>18} {'levels':>12} {'change':>9}")
    for row in left_out:
        levels = ",".join(map(str, row["levels"]))
        change = "unknown" if row["change"] is None else f"{row['change']:.3g}"
        print(f"{row['part']:>18} {levels:>12} {change:>9}  {row['reason']}")


def presence_of(directory: Directory, n_bytes: int) -> list[LevelPresence]:
    """Which levels the first `n_bytes` of the file have."""
    return level_presence(directory, Cut.of_prefix(directory, n_bytes))


def print_levels(directory: Directory, presence: Sequence[LevelPresence] | None = None) -> None:
    """A row per level: what it adds, splats, bytes, how far splats are from where they end.

    Of a truncated file, also whether the level is there.
    """
    decibels = _decibels(directory)
    has_psnr = any(one is not None for one in decibels)
    head = f"{'level':>6}  {'adds':<9} {'splats':>10} {'bytes':>12} {'so far':>12}"
    print(f"\n{head} {'':>7} {'to move':>9}{'PSNR' if has_psnr else '':>7}".rstrip())
    so_far = directory.data_offset
    for level, psnr in zip(levels(directory), decibels, strict=True):
        so_far += level.n_bytes
        quality = "" if not has_psnr else f"{'' if psnr is None else f'{psnr:.2f}':>7}"
        part = 100 * so_far / directory.size
        there = "#" * round(part / 5) if presence is None else _presence_text(presence[level.level])
        print(
            f"{level.level:>6}  {level.adds:<9} {level.n_leaves:>10,} {level.n_bytes:>12,}"
            f" {so_far:>12,}"
            f" {part:>5.1f} % {level.error:>9.3g}{quality}  {there}"
        )


def _presence_text(presence: LevelPresence) -> str:
    lacks_sh = presence.state == "in part" and presence.has_all_splats
    return f"{presence.state}{': all splats, not all SH' if lacks_sh else ''}"
