"""What the levels of a stream look like: a PSNR each, in its metadata."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.level_psnr import KEY, LevelPsnr, with_level_psnr
from evogs_codec.format.directory import read_directory
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Camera

__all__ = ["measured_levels", "with_room"]

N_VIEWS = 6
PIXELS = 200  # of the longer side of a view


def measured_levels(data: bytes, tree: EvolutionTree, request: Request) -> bytes:
    """The stream of a tree, which says the PSNR of its levels, if views were to be rendered."""
    if not _measures(request) or not tree.n_leaves:
        return data
    from evogs_codec.render import Views
    from evogs_codec.render.framing import options_for

    scene = tree.leaves()
    cameras, said = _cameras(scene, request)
    views = Views(scene, cameras, options=options_for(scene))
    if not any((picture != 1.0).any() for picture in views.pictures):  # nothing but background
        return data
    directory = read_directory(data)
    found = []
    for level in range(directory.n_levels):
        request.progress("measure", level / directory.n_levels)
        cut = Cut.of_level(directory, level)
        leaves = decode(data, cut, directory=directory).leaves(sh_degree=tree.shown_degree)
        found.append(views.psnr(leaves))
    request.progress("measure", 1.0)
    return with_level_psnr(data, LevelPsnr(tuple(found), said))


def with_room(info: SceneInfo, tree: EvolutionTree, n_levels: int, request: Request) -> SceneInfo:
    """The metadata with as many bytes for the PSNR of the levels as `measured_levels` takes."""
    if not _measures(request):
        return info
    value = str(LevelPsnr((0.0,) * n_levels, _cameras(tree.leaves(), request)[1]))
    return replace(info, text={**info.text, KEY: value})


def _measures(request: Request) -> bool:
    """Whether there are views; those of `max_error` count numbers, not pictures."""
    return not request.why_no_views and not request.errors


def _cameras(scene: SplatParams, request: Request) -> tuple[list[Camera], str]:
    """Of the views, and what they are: others than `PRICED_VIEWS`, where nobody named any."""
    from evogs_codec.render import cameras_around
    from evogs_codec.render.viewpoints import N_ORBIT

    if request.cameras is None:
        chosen = cameras_around(scene, request.up)[1 :: N_ORBIT // N_VIEWS]
        said = f"{len(chosen)} views on a circle"
    else:
        chosen = list(request.cameras[:: -(-len(request.cameras) // N_VIEWS)])
        said = f"{len(chosen)} of the {len(request.cameras)} cameras given"
    return [_small(camera) for camera in chosen], f"{said}, {PIXELS} pixels"


def _small(camera: Camera) -> Camera:
    """The same view whose longer side has at most `PIXELS` pixels."""
    part = min(1.0, PIXELS / max(camera.width, camera.height))
    return camera.resized(*(max(1, round(part * side)) for side in (camera.width, camera.height)))
