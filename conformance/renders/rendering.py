"""A renderer that is the oracle with one line of meaning changed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt

from conformance.mutants.mutant import Mutant
from conformance.renders.manifest import Image, Suite
from conformance.renders.png import Pixels
from conformance.renders.reference import to_pixels
from evogs_codec import Cut, decode, read_directory
from evogs_codec.render import Camera, Options, oracle

__all__ = ["Rendering", "picture"]

Convert = Callable[[npt.NDArray[np.float64]], Pixels]


@dataclass(frozen=True)
class Rendering:
    """A renderer that differs from the oracle in one thing.

    Attributes:
        name: what reports call it.
        says: what it does, in a few words.
        edits: (old, new) lines; old lines are in the oracle exactly once.
        level: the level it draws, of the level asked for and the last one.
        convert: from a picture to pixels of 8 or 16 bits.
    """

    name: str
    says: str
    edits: tuple[tuple[str, str], ...] = ()
    level: Callable[[int, int], int] = lambda asked, _last: asked
    convert: Convert = to_pixels


def picture(rendering: Rendering, suite: Suite, image: Image) -> Pixels:
    """What it makes of an image."""
    data = suite.stream(image)
    directory = read_directory(data)
    level = rendering.level(image.level, directory.n_levels - 1)
    splats = decode(data, Cut.of_level(directory, level)).leaves()
    camera = Camera(**image.camera)
    options = Options(antialiased=suite.scenes[image.scene].antialiased)
    # What is wrong may well overflow or divide by zero.
    with np.errstate(all="ignore"):
        render = _load(rendering).render_exactly
        exact = render(splats, camera, image.background, options=options).image
        return rendering.convert(np.nan_to_num(exact))


@cache
def _load(rendering: Rendering) -> ModuleType:
    """The oracle with the edits, as a module of its own."""
    mutant = Mutant(rendering.name, "", rendering.says, rendering.edits)
    module = ModuleType(f"{__name__}.{rendering.name}")
    sys.modules[module.__name__] = module  # dataclasses look their module up
    text = mutant.text(Path(oracle.__file__).read_text(encoding="utf-8"))
    exec(compile(text, f"oracle.py as {rendering.name}", "exec"), module.__dict__)
    return module
