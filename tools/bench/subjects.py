"""What is measured from every side: a tree, its pictures, and the time that one takes."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evogs_codec import (
    PRESETS,
    EvolutionTree,
    Settings,
    SplatParams,
    encode,
    encode_scene,
    encode_tree,
    lift_with_order,
    read_ply,
    read_tree,
    with_palette,
)
from evogs_codec.encoding.error_factors import N_MEASURING_VIEWS
from evogs_codec.encoding.measured_gains import N_ORDERING_VIEWS
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.lifting.lift import Lifted, default_levels
from evogs_codec.render import (
    Camera,
    cameras_all_around,
    cameras_around,
    psnr,
    render,
    weighing_cameras,
)
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tools.bench.photographs import held_out

__all__ = ["SIZE", "WHITE", "Gauge", "Subject", "aim_of", "subjects"]

SIZE = 400  # pixels to a side of a picture
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Gauge:
    """Pictures that others are compared with.

    Attributes:
        cameras: of the views.
        targets: (H, W, 3) each.
        most: pictures are clipped to 0..most before they are compared.
    """

    cameras: Sequence[Camera]
    targets: Sequence[npt.NDArray[np.floating]]
    most: float = np.inf

    def __call__(self, splats: SplatParams) -> tuple[float, float]:
        """Mean PSNR in dB, and median milliseconds of processor time of a picture."""
        found, seconds = [], []
        for camera, target in zip(self.cameras, self.targets, strict=True):
            start = time.process_time()
            picture = render(splats, camera, WHITE)
            seconds.append(time.process_time() - start)
            found.append(psnr(np.clip(picture, 0, self.most), target))
        return float(np.mean(found)), 1000 * float(np.median(seconds))


@dataclass(frozen=True, eq=False)
class Subject:
    """A tree to encode.

    Attributes:
        name: of the scene.
        tree: lifted or trained.
        lifted: the same with where its leaves come from, if it was lifted.
        settings: the preset for such trees.
        views: of its leaves, by which an encoder aims.
        gauge: by which streams are judged: the same views, or photographs.
        up: axis that the views are around.
    """

    name: str
    tree: EvolutionTree
    settings: Settings
    views: Views
    gauge: Gauge
    up: str = "z"
    lifted: Lifted | None = None

    @property
    def is_scene(self) -> bool:
        """Whether it is a scene, and no trained tree."""
        return self.settings == PRESETS["scene"]

    def encoded(self, *, target_psnr: float | None = None, polish: int = 0) -> bytes:
        """What `evogs encode` makes of it with these options."""
        if self.is_scene:
            scene = self.views.scene
            return encode_scene(
                scene,
                levels=self.tree.n_levels,
                up=self.up,
                target_psnr=target_psnr,
                polish=polish,
            )
        return encode_tree(self.tree, up=self.up, target_psnr=target_psnr, polish=polish)

    @cached_property
    def best(self) -> EvolutionTree:
        """What `evogs encode` takes: with a palette where splats share their SH."""
        return self.shared(self.tree) or self.tree

    def shared(self, tree: EvolutionTree) -> EvolutionTree | None:
        """This tree, or one with other coarse levels, with a palette."""
        if self.lifted is None:
            return None
        return with_palette(replace(self.lifted, tree=tree), self.views.scene)

    @cached_property
    def stream(self) -> bytes:
        """Of the preset, in the order that the command line gives it."""
        every = -(-len(self.views.cameras) // N_ORDERING_VIEWS)
        few = replace(self.views, cameras=self.views.cameras[::every])
        return encode(self.best, self.settings, views=few)

    @staticmethod
    def of_scene(name: str, splats: SplatParams, up: str) -> Subject:
        """A scene, lifted; judged by pictures of itself."""
        views = _views_of(splats, up)
        lifted = lift_with_order(splats, default_levels(len(splats)))
        subject = Subject.of_tree(name, lifted.tree, PRESETS["scene"], views)
        return replace(subject, up=up, lifted=lifted)

    @staticmethod
    def of_tree(name: str, tree: EvolutionTree, settings: Settings, views: Views) -> Subject:
        """A tree, judged by pictures of what `views` see."""
        targets = [render(views.scene, camera, WHITE) for camera in views.cameras]
        return Subject(name, tree, settings, views, Gauge(views.cameras, targets))


def subjects(args: argparse.Namespace) -> Iterator[Subject]:
    """The scene, or the shipped one; and the tree, judged by photographs if there are any."""
    if args.ply:
        yield Subject.of_scene(args.ply.stem, read_ply(args.ply), args.up)
    else:
        yield Subject.of_scene("shipped", make_scene(), "z")
    if args.tree:
        tree, name = read_tree(args.tree), args.tree.name.split(".")[0]
        leaves = tree.leaves()
        views = _views_of(leaves, "z")
        subject = Subject.of_tree(name, tree, PRESETS["trained"], views)
        if args.photos:
            shots = [photograph.at(SIZE) for photograph in held_out(args.photos)]
            gauge = Gauge([camera for camera, _ in shots], [target for _, target in shots], 1.0)
            subject = replace(subject, gauge=gauge)
        yield subject


def aim_of(
    tree: EvolutionTree,
    settings: Settings,
    views: Views,
    *,
    layers: int = 1,
    polish: int = 0,
    ordering: Views | None = None,
) -> TargetEncoder:
    """What `evogs encode` does with a target, by these views."""
    return TargetEncoder(
        tree,
        settings,
        views,
        ordering=ordering,
        measuring=views.fewer(N_MEASURING_VIEWS),
        layers=layers,
        polish=polish,
    )


def _views_of(splats: SplatParams, up: str) -> Views:
    """Those by which `evogs encode` aims."""
    return Views(
        splats,
        cameras_around(splats, up, SIZE),
        others=cameras_all_around(splats, up),
        weighing=weighing_cameras(splats, up),
    )
