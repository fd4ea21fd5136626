"""Panes: pictures of a tile, by which other tiles see what it hides and what shows behind them.

A tile is drawn once for each view of its neighbourhood. The boxes of a k-d tree are before or
behind one another in any view. So what is in front of a tile and what is behind it, splat for
splat, are the panes of the others, put one over the other.

Letters: V views, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.scratch_files import arrays_of
from evogs_codec.jobs.tile_tree import Split
from evogs_codec.model.splats import F32, I64, SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Options
    from evogs_codec.render.views import Between, Colour

__all__ = ["Panes", "between"]

FULL = 255  # what one is stored as: of a colour, and of what shows through


@dataclass(frozen=True, eq=False)
class Panes:
    """What a tile shows in each view, and what shows through it.

    Attributes:
        boxes: (V, 4) first and last row and column, last ones excluded, of what it covers.
        numbers: of the pixels of all boxes, four each: red, green, blue, and what shows through.
    """

    boxes: I64
    numbers: npt.NDArray[np.uint8]

    @staticmethod
    def of(splats: SplatParams, cameras: Sequence[Camera], options: Options) -> Panes:
        """Of the splats of a tile."""
        from evogs_codec.render import draw
        from evogs_codec.render.activated import Activated

        ready = Activated.of(splats)
        boxes, numbers = np.zeros((len(cameras), 4), np.int64), [np.empty((0, 4), np.uint8)]
        for box, camera in zip(boxes, cameras, strict=True):
            drawing = draw(ready, camera, options=options)
            pane = np.dstack([drawing.image, drawing.transmittance])
            rounded = np.rint(FULL * np.clip(pane, 0, 1)).astype(np.uint8)
            covered = np.nonzero(rounded[..., 3] < FULL)
            if len(covered[0]):
                box[0::2], box[1::2] = np.min(covered, axis=1), 1 + np.max(covered, axis=1)
            numbers.append(rounded[slice(*box[:2]), slice(*box[2:])].reshape(-1, 4))
        return Panes(boxes, np.concatenate(numbers))

    def write(self, path: Path) -> None:
        """To a file that `read` reads."""
        write_atomic(
            path,
            lambda file: np.savez_compressed(file, boxes=self.boxes, numbers=self.numbers),
        )

    @staticmethod
    def read(path: Path) -> Panes:
        """From a file that `write` wrote."""
        with arrays_of(path) as found:
            return Panes(found["boxes"], found["numbers"])

    def each(self) -> Iterator[tuple[tuple[slice, slice], F32]]:
        """Of each view, where the pane is and (h, w, 4) what it has there, as parts of one."""
        end = 0
        for top, bottom, left, right in self.boxes.tolist():
            start, end = end, end + (bottom - top) * (right - left)
            pane = self.numbers[start:end].reshape(bottom - top, right - left, 4)
            yield (
                (slice(top, bottom), slice(left, right)),
                pane.astype(np.float32) / np.float32(FULL),
            )


def between(
    tile: int,
    split: Split,
    panes: Mapping[int, Path],
    cameras: Sequence[Camera],
    eyes: npt.NDArray[np.float64],
    background: Colour,
) -> dict[Camera, Between]:
    """What is in front of a tile and behind it, of each view.

    Args:
        tile: which.
        split: the part of the tree that is its neighbourhood.
        panes: of each other tile that has some.
        cameras: V, as the tile has them.
        eyes: (V, 3) where they are, as the tree has it.
        background: behind all.
    """
    from evogs_codec.render.views import Between

    found = {other: Panes.read(path).each() for other, path in panes.items()}
    result = {}
    for camera, eye in zip(cameras, eyes, strict=True):
        shape = camera.height, camera.width
        veil, through = np.ones((*shape, 1), np.float32), np.ones((*shape, 1), np.float32)
        behind, is_behind = np.zeros((*shape, 3), np.float32), False
        shown = {other: next(each) for other, each in found.items()}
        for other in _from_front(split, eye.tolist()):
            is_behind |= other == tile
            if other not in shown:
                continue
            place, pane = shown[other]
            if is_behind:
                behind[place] += through[place] * pane[..., :3]
                through[place] *= pane[..., 3:]
            else:
                veil[place] *= pane[..., 3:]
        behind += through * np.array(background, np.float32)
        result[camera] = Between(veil.astype(np.float16), behind.astype(np.float16))
    return result


def _from_front(split: Split, eye: Sequence[float]) -> Iterator[int]:
    """The tiles in an order in which none hides one before it."""
    if isinstance(split, int):
        yield split
        return
    axis, value, left, right = split
    near, far = (left, right) if eye[axis] < value else (right, left)
    yield from _from_front(near, eye)
    yield from _from_front(far, eye)
