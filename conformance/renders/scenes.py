"""The scenes: what each tests, its stream, and three cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from conformance.renders import recipes
from conformance.renders.manifest import FOLDER
from evogs_codec import PRESETS, EvolutionTree, Settings, SplatParams, encode
from evogs_codec.render import Camera

__all__ = ["SCENES", "Scene", "View"]

WIDTH, HEIGHT = 96, 72
ORIGIN = (0.0, 0.0, 0.0)
Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
WHITE: Colour = (1.0, 1.0, 1.0)
BLUE: Colour = (0.2, 0.4, 0.8)  # whole numbers in 8 bits


@dataclass(frozen=True, eq=False)
class View:
    """A camera and what is behind the splats."""

    name: str
    camera: Camera
    background: Colour


@dataclass(frozen=True, eq=False)
class Scene:
    """A stream and three views of it.

    Attributes:
        id: name of the stream.
        tests, faulty: one sentence each: what is looked at, what a wrong renderer would show.
        recipe: makes the splats, or the tree, or has the stream.
        views: three of them.
        settings: how the stream is coded.
        n_tiles: tiles of the stream.
        antialiased: whether opacity is compensated (spec/rasterizer.md, section 4).
        kept: the stream stays as it was first made, because lifting, which made it, may improve;
            it is made anew where its file is removed.
    """

    id: str
    tests: str
    faulty: str
    recipe: Callable[[], SplatParams | EvolutionTree | bytes]
    views: tuple[View, View, View]
    settings: Settings = PRESETS["near-lossless"]
    n_tiles: int = 1
    antialiased: bool = False
    kept: bool = False

    def stream(self) -> bytes:
        """The bytes of the stream."""
        file = FOLDER / "streams" / f"{self.id}.evogs"
        if self.kept and file.exists():
            return file.read_bytes()
        made = self.recipe()
        if isinstance(made, bytes):
            return made
        tree = EvolutionTree.of_splats(made) if isinstance(made, SplatParams) else made
        return encode(tree, self.settings, n_tiles=self.n_tiles, digests=False)


def _looking(
    name: str,
    eye: tuple[float, float, float],
    target: tuple[float, float, float] = ORIGIN,
    background: Colour = BLACK,
    *,
    fov: float = 0.8,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> View:
    """A view from `eye` to `target`; `fov` in radians.

    Eyes are no round numbers: depths of splats on a grid would be equal by chance.
    """
    camera = Camera.look_at(eye, target, up, width=WIDTH, height=HEIGHT, fov_x=fov)
    return View(name, camera, background)


def _along_z(
    name: str,
    distance: float,
    background: Colour = BLACK,
    *,
    focal: tuple[float, float] = (96.0, 96.0),
    center: tuple[float, float] = (WIDTH / 2, HEIGHT / 2),
    size: tuple[int, int] = (WIDTH, HEIGHT),
    turn: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> View:
    """A view along an axis, so that equal z of splats is equal depth in every arithmetic."""
    camera = Camera(*size, *focal, *center, np.diag(turn), np.array([0.0, 0.0, distance]))
    return View(name, camera, background)


ABOUT = (
    _looking("front", (0.3127, -3.0391, 0.6173)),
    _looking("side", (2.5837, 1.2291, -1.4113), background=WHITE),
    _looking("top", (-0.4219, 0.5347, 3.1873), background=BLUE, up=(0.0, 1.0, 0.0)),
)
# Chosen so that no two splats that fill a picture are equally deep but for rounding.
AROUND = (
    _looking("right", (9.1718, 3.7425, 5.5846), (0.0, 0.0, 0.8), WHITE, fov=0.85),
    _looking("left", (-7.8253, 6.0708, 5.5846), (0.0, 0.0, 0.8), fov=0.85),
    _looking("close", (4.1696, 1.7011, 2.9748), (0.0, 0.0, 0.8), BLUE, fov=0.85),
)
# name: as in `tools.trained_streams`
TRAINED = {
    "evogs": "EvoGS",
    "evogs-degree-3": "EvoGS with SH of degree 3, coded as the paper does",
    "evogs-sym": "the symmetric tree",
    "evogs-a": "a tree of independent children",
    "evogs-b": "a tree of independent residuals",
    "lapis": "layers whose lower ones change their opacity",
    "l3gs": "frozen layers",
}
BEHIND = (-1.0, 1.0, -1.0)
BASE = (1_000_000.0, -800_000.0, 600_000.0)


def _from_base(x: float, y: float, z: float) -> tuple[float, float, float]:
    return BASE[0] + x, BASE[1] + y, BASE[2] + z


SCENES = (
    Scene(
        "ties",
        "Splats of equal depth are drawn in order of their slots; children of a split keep to the"
        " slots they are given.",
        "Draws equal depths in another order, or the children of a split next to each other.",
        recipes.ties,
        (
            _along_z("before", 3.0),
            _along_z("behind", 3.0, WHITE, turn=BEHIND),
            _looking("oblique", (1.5373, 1.0391, -2.3919), background=BLUE),
        ),
    ),
    Scene(
        "kinds",
        "Adds, splits, refines and drops of four levels; nothing is left at the last one.",
        "Draws dropped splats, forgets added ones, or draws another level than asked.",
        recipes.kinds,
        ABOUT,
    ),
    Scene(
        "off-screen",
        "Splats out of the picture that reach into it, with slopes clamped at 1.3 times the field"
        " of view; a principal point out of the middle, pixels that are not square.",
        "Drops splats whose centre is out of the picture, does not clamp slopes, or assumes"
        " that the principal point is in the middle.",
        recipes.off_screen,
        (
            _along_z("middle", 0.5),
            _along_z("corner", 0.5, WHITE, center=(20.0, 60.0)),
            _along_z("tall", 1.0, BLUE, focal=(60.0, 110.0), size=(72, 96), center=(40.0, 30.0)),
        ),
    ),
    Scene(
        "near",
        "Splats at the near plane are not drawn, those a thousandth behind it are; nor are those"
        " behind the camera.",
        "Draws what is at, before or behind the near plane, or has it elsewhere.",
        recipes.near,
        (
            _along_z("at-zero", 0.2),
            _along_z("at-minus-one", 1.2, WHITE),
            _looking(
                "inside", (0.2131, 0.1173, -0.6219), (0.0, 0.0, 1.0), BLUE, fov=1.2, up=(0, -1, 0)
            ),
        ),
    ),
    Scene(
        "opacity",
        "Opacity 0 and 1 and everything between: alpha is at most 0.99, and skipped below 1/255.",
        "Overflows at large logits, clamps alpha elsewhere, or draws what is too faint.",
        recipes.opacity,
        (
            _along_z("front", 3.0),
            _along_z("back", 3.5, WHITE, turn=BEHIND),
            _looking("oblique", (1.2173, -0.9391, -2.6337), background=BLUE, up=(0, -1, 0)),
        ),
    ),
    Scene(
        "needles",
        "Needles far thinner than a pixel are widened by the dilation.",
        "Loses needles, draws them dashed, or as wide as another dilation makes them.",
        recipes.needles,
        ABOUT,
    ),
    Scene(
        "pancakes",
        "Flat discs seen edge-on, at a grazing angle and from above.",
        "Divides by a determinant that cancelled; shows holes or spikes.",
        recipes.pancakes,
        (
            _looking("edge-on", (0.1391, -3.0173, 0.0)),
            _looking("grazing", (2.9173, 0.3391, 0.1219), background=WHITE),
            _looking("above", (0.3173, 0.4219, 3.0391), background=BLUE),
        ),
    ),
    Scene(
        "huge",
        "Splats many times larger than the view, with the camera between and within them.",
        "Cuts splats off at a multiple of their deviation, or at a size in pixels or tiles.",
        recipes.huge,
        (
            _looking("outside", (0.1219, -6.0391, 1.0173)),
            _looking("inside", (0.3173, 0.2219, 0.1391), (1.0, 0.5, 0.2), WHITE, fov=1.4),
            _looking("wide", (3.0173, 2.9391, -1.0219), background=BLUE, fov=1.9),
        ),
    ),
    Scene(
        "far",
        "A scene a million units from the origin; its positions are exact in float32.",
        "Multiplies positions by a view matrix in float32: splats jump by whole pixels.",
        recipes.far,
        (
            _looking("front", _from_base(5.0173, -70.0391, 12.0219), BASE),
            _looking("side", _from_base(55.0391, 30.0219, -25.0173), BASE, WHITE),
            _looking("top", _from_base(-8.0219, 10.0173, 75.0391), BASE, BLUE, up=(0.0, 1.0, 0.0)),
        ),
    ),
    Scene(
        "overlap",
        "Three hundred layers: a pixel closes before its transmittance would fall below 0.0001, and"
        " what is behind, 200 times as bright as white, is not seen.",
        "Does not close pixels, closes them earlier or later, or draws the splat that closes.",
        recipes.overlap,
        (
            _along_z("front", 2.0),
            _looking("oblique", (0.9173, -0.7219, -2.2391), (0.0, 0.0, 0.5), WHITE, up=(0, -1, 0)),
            _along_z("close", 1.0, BLUE, focal=(70.0, 70.0)),
        ),
    ),
    *(
        Scene(
            f"sh-{degree}",
            f"Colours of spherical harmonics of degree {degree} from three sides.",
            "Has a sign, the order or a factor of a coefficient wrong, or looks up the colour in"
            " the opposite direction, or in that of the camera.",
            partial(recipes.harmonics, degree),
            ABOUT,
        )
        for degree in (1, 2, 3)
    ),
    Scene(
        "antialiased",
        "Antialiased: dots below the size of a pixel lose the opacity that dilation adds.",
        "Ignores the option, or compensates without the root.",
        recipes.antialiased,
        ABOUT,
        antialiased=True,
    ),
    Scene(
        "rotations",
        "Quaternions of any length, w first; zero is the identity.",
        "Does not normalise, reads x first, transposes, or drops splats without a rotation.",
        recipes.rotations,
        ABOUT,
    ),
    Scene(
        "colors",
        "Colours are clamped at 0 before blending, and not above: what is under translucent splats"
        " may be brighter than white.",
        "Clamps colours to 1 or not at all, or blends in 8 bits.",
        recipes.colors,
        ABOUT,
    ),
    Scene(
        "procedural",
        "A part of the procedural scene, coded as scenes are, four levels.",
        "Shows another level, or is wrong where splats are as training leaves them.",
        recipes.procedural,
        (
            _looking("front", (-1.2, -2.2, 1.4), (-1.5, 0.5, 0.9)),
            _looking("side", (1.2, 1.1, 0.7), (-1.5, 0.5, 0.9), WHITE),
            _looking("low", (-3.6, 2.2, 0.3), (-1.5, 0.5, 0.9), BLUE),
        ),
        settings=PRESETS["scene"],
        kept=True,
    ),
    Scene(
        "lifted",
        "A lifted tree of five levels in several tiles, drawn in order of tile and slot.",
        "Shows another level, or splats of one tile only.",
        recipes.lifted,
        ABOUT,
        settings=PRESETS["scene"],
        kept=True,
        n_tiles=4,
    ),
    *(
        Scene(
            f"trained-{name}",
            f"Three levels that the trainer made of photographs: {says}.",
            "Shows another level, or is wrong where splats are as training leaves them.",
            partial(recipes.trained, name),
            AROUND,
        )
        for name, says in TRAINED.items()
    ),
)
