"""The options of a whole encode: their types, and how they are checked."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal, TypeAlias, TypedDict

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.common.version import __version__
from evogs_codec.encoding.layers import MAX_LAYERS, N_LAYERS
from evogs_codec.encoding.settings import PRESETS, Settings
from evogs_codec.format.write_directory import MAX_LEVELS
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.effort import Effort

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Views
    from evogs_codec.render.up import Direction

__all__ = ["NO_NUMBA", "MaxError", "Request", "SceneOptions", "TreeOptions", "with_generator"]

MIN_SHOWN = 0.5  # of the splats; given cameras that show fewer are those of another world, or few
NO_NUMBA = "numba is missing: pip install -e '.[render]'"

MaxError: TypeAlias = "float | Mapping[str, float]"


class TreeOptions(TypedDict, total=False):
    """The options of `encode_tree`."""

    preset: str | Settings | None
    target_psnr: float | None
    target_bytes: int | None
    max_error: MaxError | None
    layers: int | None
    polish: int
    cameras: Sequence[Camera] | None
    up: Direction | None
    n_tiles: int | None
    effort: str | int | None
    info: SceneInfo | None
    progress: Progress | None


class SceneOptions(TreeOptions, total=False):
    """The options of `encode_scene`."""

    levels: int | None
    palette: Literal["auto", "never"]
    improve: Callable[[EvolutionTree], EvolutionTree] | None


@dataclass(frozen=True)
class Request:
    """The options of an encode, checked.

    Attributes:
        settings: of the preset, or of that which stands for none.
        has_preset: it decides the steps, not views.
        layers: of precision, where views decide; None if the caller did not say.
        errors: the largest allowed, per name of a group; empty for none.
        up: of the default views; None until `looking_at` finds it.
        is_in_reach: some of the splats tell that the target can be met, for sure (`reach`).
        of_scene: its views, once they have been asked for.
    """

    settings: Settings
    has_preset: bool
    target_psnr: float | None
    target_bytes: int | None
    errors: Mapping[str, float]
    layers: int | None
    polish: int
    cameras: Sequence[Camera] | None
    up: Direction | None
    n_tiles: int | None
    effort: Effort
    info: SceneInfo
    progress: Progress
    is_in_reach: bool = False
    of_scene: list[Views] = field(default_factory=list, repr=False, compare=False)

    @staticmethod
    def of(default: str, options: TreeOptions) -> Request:
        """From the options that a caller gave; `default` is the name of a preset."""
        unknown = sorted(set(options) - set(TreeOptions.__annotations__))
        if unknown:
            raise TypeError(f"no such option: {', '.join(unknown)}")
        preset, polish = options.get("preset"), options.get("polish", 0)
        layers = options.get("layers")
        psnr, n_bytes = options.get("target_psnr"), options.get("target_bytes")
        errors = _errors_of(options.get("max_error"))
        n_targets = (psnr is not None) + (n_bytes is not None) + bool(errors)
        if n_targets > 1:
            raise ValueError("target_psnr, target_bytes and max_error exclude each other")
        if psnr is not None and not math.isfinite(psnr):
            raise ValueError(f"target_psnr is {psnr}, expected a number of dB")
        if n_bytes is not None and n_bytes < 1:
            raise ValueError(f"target_bytes is {n_bytes}, expected at least 1")
        if n_targets and preset is not None:
            raise ValueError("a preset does not go with a target: the target decides the steps")
        if polish < 0:
            raise ValueError(f"polish is {polish}, expected 0 or more")
        if polish and (n_targets == 0 or errors):
            raise ValueError("polish needs target_psnr or target_bytes")
        if layers is not None and layers not in range(1, MAX_LAYERS + 1):
            raise ValueError(f"layers is {layers}, expected 1..{MAX_LAYERS}")
        if layers is not None and layers > 1 and (preset is not None or errors):
            raise ValueError("layers do not go with a preset or max_error")
        settings = _settings_of(default if preset is None else preset)
        asked, n_tiles = options.get("effort"), options.get("n_tiles")
        effort = Effort.of(asked)
        if n_tiles is not None and n_tiles < 1:
            raise ValueError(f"n_tiles is {n_tiles}, expected at least 1")
        return Request(
            settings=settings if asked is None else replace(settings, zstd_level=effort.zstd_level),
            has_preset=preset is not None,
            target_psnr=psnr,
            target_bytes=n_bytes,
            errors=errors,
            layers=layers,
            polish=polish,
            cameras=options.get("cameras"),
            up=options.get("up"),
            n_tiles=n_tiles,
            effort=effort,
            info=with_generator(options.get("info") or SceneInfo()),
            progress=options.get("progress") or no_progress,
        )

    @property
    def is_plain(self) -> bool:
        """There is no target."""
        return self.target_psnr is None and self.target_bytes is None and not self.errors

    @property
    def is_by_views(self) -> bool:
        """Whether rendered views decide how exact numbers are."""
        return not (self.has_preset or self.errors or self.why_no_views)

    @property
    def why_no_views(self) -> str:
        """Why `views` has none; empty if it has some."""
        if self.cameras is not None and not len(self.cameras):
            return "there are no cameras"
        return NO_NUMBA if find_spec("numba") is None else ""

    def n_layers(self, n_levels: int) -> int:
        """Layers of precision of so many levels: those asked for, or as many as there is room for.

        One where nothing can be rendered.
        """
        if self.layers or self.why_no_views:
            return self.layers or 1
        return max(1, min(N_LAYERS, 1 + MAX_LEVELS - n_levels))

    def looking_at(self, scene: SplatParams) -> Request:
        """The same, which knows what is up in the default views of a scene.

        Warns the caller of `encode_scene` where given cameras show less than `MIN_SHOWN` of it.
        """
        if self.errors or self.why_no_views:
            return self
        from evogs_codec.render import up_of
        from evogs_codec.render.viewpoints import share_shown

        if self.cameras is not None and self.is_by_views:
            share = share_shown(scene, self.cameras)
            if share < MIN_SHOWN:
                warnings.warn(
                    f"the cameras show {share:.0%} of the splats, and the others get large errors:"
                    " are these cameras of the same world, and all there are?",
                    stacklevel=4,
                )
        if self.up is not None or self.cameras is not None:
            return self

        return replace(self, up=up_of(scene, self.info).vector)

    def views(
        self, scene: SplatParams, n_views: int | None = None, *, descent: bool = False
    ) -> Views | None:
        """Views of the scene; None where nothing can be rendered, or the caller gave no cameras."""
        if self.why_no_views:
            return None
        from evogs_codec.render import Views

        return Views.of(scene, self.cameras, up=self.up, n_views=n_views, descent=descent)

    def views_of_scene(self, scene: SplatParams) -> Views | None:
        """`views` of the scene that is encoded, always the same: no picture is drawn twice.

        With `descent` where it is polished.
        """
        if not self.of_scene:
            found = self.views(scene, descent=self.polish > 0)
            if found is None:
                return None
            self.of_scene.append(found)
        return self.of_scene[0]

    def weighing_views(self, scene: SplatParams) -> Views | None:
        """Those by which errors are weighed where there is no target: what the effort allows."""
        views = self.views(scene, self.effort.n_views)
        if views is None:
            return None
        views = views.within(self.effort.pixels)
        if self.cameras is not None:
            return views
        weighing = views.weighing if self.effort.all_round else ()
        return replace(views, weighing=weighing, n_drawn=self.effort.n_views)


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


def with_generator(info: SceneInfo) -> SceneInfo:
    """The metadata, with this program as the `generator` if it names none."""
    return replace(info, text={**info.text, "generator": f"evogs {__version__}"} | dict(info.text))
