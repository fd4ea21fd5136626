"""What the levels of a stream look like: a PSNR each, in its metadata."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from evogs_codec.editing.level_psnr import KEY, LevelPsnr, without_level_psnr
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Views

__all__ = ["Gauge", "with_room", "without_room"]

N_VIEWS = 4
ALL_LOOK_UP_TO = 20_000  # splats; of few, errors are chance: all views look for falls
MANY_ABOVE = 60_000  # splats: of so many, less is done against falls
N_OF_PACKETS, N_OF_LARGE = 24, 8
PIXELS = 200  # of the longer side of a view
# Of half of the views that look for falls, two and two. Small splats are drawn larger than they
# are, by part of a pixel: a level may look better than the one before in small pictures alone.
MORE_PIXELS = 400


@dataclass(frozen=True, eq=False)
class Gauge:
    """Views that say what cuts of a tree look like.

    Attributes:
        views: of levels.
        said: what they are.
        many: more, that look for falls; half of them larger.
        packets: still more of many splats, that look at packets where some prefix falls.
    """

    views: Views
    said: str
    many: Views
    packets: Views

    @staticmethod
    def of(tree: EvolutionTree, request: Request) -> Gauge | None:
        """For the streams of a tree; None if no views are to be rendered or they show nothing."""
        if not _measures(request) or not tree.n_leaves:
            return None
        from evogs_codec.render import Views
        from evogs_codec.render.framing import background_for, options_for

        scene = tree.shared_leaves()
        cameras, said = _cameras(scene, request)
        is_small = tree.n_leaves <= ALL_LOOK_UP_TO
        all_, _ = _chosen(scene, request, N_OF_PACKETS, 0)
        chosen = all_ if is_small else all_[:: -(-len(all_) // N_OF_LARGE)]
        more = [one.within((PIXELS, MORE_PIXELS)[k // 2 % 2]) for k, one in enumerate(chosen)]
        of_packets = more if is_small else [one.within(PIXELS) for one in all_]
        empty = background_for(scene)
        # Streams that are tried after one another have states in common.
        known: dict[tuple[bytes, Camera], float] | None = {} if is_small else None
        views = Views(scene, cameras, background=empty, options=options_for(scene), known=known)
        if not any((picture != empty).any() for picture in views.pictures):
            return None
        many, packets = (replace(views, cameras=some) for some in (more, of_packets))
        return Gauge(views, said, many, packets)


def with_room(info: SceneInfo, tree: EvolutionTree, n_levels: int, request: Request) -> SceneInfo:
    """The metadata with as many bytes for the PSNR of the levels as `steady` takes."""
    if not _measures(request):
        return info
    value = str(LevelPsnr((0.0,) * n_levels, _cameras(tree.shared_leaves(), request)[1]))
    return replace(info, text={**info.text, KEY: value})


def without_room(data: bytes, request: Request) -> bytes:
    """A stream of which nothing was measured, without the bytes that `with_room` gave it."""
    has_room = request.target_bytes is not None and _measures(request)
    return without_level_psnr(data) if has_room else data


def _measures(request: Request) -> bool:
    """Whether there are views, and time for them; `max_error` counts numbers, not pictures."""
    return request.effort.looks and not request.why_no_views and not request.errors


def _cameras(scene: SplatParams, request: Request) -> tuple[list[Camera], str]:
    """Of the views of levels, and what they are."""
    from evogs_codec.render.framing import BLACK, background_for

    chosen, said = _chosen(scene, request, N_VIEWS, 1)
    on = " on black" if background_for(scene) == BLACK else ""
    return [camera.within(PIXELS) for camera in chosen], f"{said}{on}, {PIXELS} pixels"


def _chosen(
    scene: SplatParams, request: Request, n_views: int, first: int
) -> tuple[list[Camera], str]:
    """Cameras, and what they are; where nobody named any, some of those on the circle.

    One in three of these weighs errors, too. Of given cameras none does, if there are enough.
    """
    from evogs_codec.render import cameras_around
    from evogs_codec.render.viewpoints import N_ORBIT, most_different
    from evogs_codec.render.views import MORE_OF_GIVEN

    if request.cameras is None:
        chosen = cameras_around(scene, request.up)[first :: N_ORBIT // n_views]
        said = f"{len(chosen)} views on a circle"
    else:
        weighing = most_different(request.cameras, MORE_OF_GIVEN * request.effort.n_views)
        others = [camera for camera in request.cameras if camera not in weighing]
        chosen = most_different(others if len(others) >= n_views else request.cameras, n_views)
        said = f"{len(chosen)} of the {len(request.cameras)} cameras given"
    return chosen, said
