"""What the levels of a stream look like: a PSNR each, in its metadata."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from evogs_codec.editing.level_psnr import KEY, LevelPsnr
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Views

__all__ = ["MANY", "Gauge", "with_room"]

N_VIEWS = 6
MANY = 10_000  # of more splats some views judge first
EVERY = 3  # so-many-th view of them tells what is no level
PIXELS = 200  # of the longer side of a view


@dataclass(frozen=True, eq=False)
class Gauge:
    """Views that say what cuts of a tree look like.

    Attributes:
        views: of levels.
        said: what they are.
        few: some of them.
        many: twice as many as `views`.
        every: so-many-th of `views` is one of the few.
    """

    views: Views
    said: str
    few: Views
    many: Views
    every: int

    @staticmethod
    def of(tree: EvolutionTree, request: Request) -> Gauge | None:
        """For the streams of a tree; None if no views are to be rendered or they show nothing."""
        if not _measures(request) or not tree.n_leaves:
            return None
        from evogs_codec.render import Views
        from evogs_codec.render.framing import options_for

        scene = tree.leaves()
        cameras, said = _cameras(scene, request)
        more, _ = _cameras(scene, request, 2 * N_VIEWS, 0)
        views = Views(scene, cameras, options=options_for(scene))
        if not any((picture != 1.0).any() for picture in views.pictures):  # only background
            return None
        every = EVERY if len(scene) > MANY else 1
        few, many = (replace(views, cameras=some) for some in (cameras[::every], more))
        return Gauge(views, said, few, many, every)

    def both(self, splats: SplatParams) -> tuple[float, float]:
        """PSNR over all views, and over the few, dB."""
        each = self.views.psnr_of_each(splats)
        if len(each) < len(self.views.cameras):  # some show nothing of the scene
            return float(each.mean()), self.few.psnr(splats)
        return float(each.mean()), float(each[:: self.every].mean())


def with_room(info: SceneInfo, tree: EvolutionTree, n_levels: int, request: Request) -> SceneInfo:
    """The metadata with as many bytes for the PSNR of the levels as `steady` takes."""
    if not _measures(request):
        return info
    value = str(LevelPsnr((0.0,) * n_levels, _cameras(tree.leaves(), request)[1]))
    return replace(info, text={**info.text, KEY: value})


def _measures(request: Request) -> bool:
    """Whether there are views, and time for them; `max_error` counts numbers, not pictures."""
    return request.effort.looks and not request.why_no_views and not request.errors


def _cameras(
    scene: SplatParams, request: Request, n_views: int = N_VIEWS, first: int = 1
) -> tuple[list[Camera], str]:
    """Of the views, and what they are: others than those that weigh, where nobody named any."""
    from evogs_codec.render import cameras_around
    from evogs_codec.render.viewpoints import N_ORBIT

    if request.cameras is None:
        chosen = cameras_around(scene, request.up)[first :: N_ORBIT // n_views]
        said = f"{len(chosen)} views on a circle"
    else:
        chosen = list(request.cameras[:: -(-len(request.cameras) // n_views)])
        said = f"{len(chosen)} of the {len(request.cameras)} cameras given"
    return [camera.within(PIXELS) for camera in chosen], f"{said}, {PIXELS} pixels"
