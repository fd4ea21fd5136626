"""An edit of scenes or streams: on the packets where they say the same after it, or on the splats.

several scenes -> one -> crop -> floaters -> scale, rotate, move
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from evogs_codec._generated import registry
from evogs_codec.decoding.decode import decode, decode_leaves
from evogs_codec.decoding.float_view import n_moved_by_float32
from evogs_codec.editing.extract import extract_tiles
from evogs_codec.editing.join import NotJoinableError, joined
from evogs_codec.editing.move import moved
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.frames import frame_of, transformed
from evogs_codec.io.interchange.scene_files import Scene
from evogs_codec.model.placement import placed_text
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64
from evogs_codec.scene_edits.floaters import floaters
from evogs_codec.scene_edits.merging import merged
from evogs_codec.scene_edits.regions import Region
from evogs_codec.stores.sources import Source, bytes_of

__all__ = ["Edit", "Edited", "edit_scenes"]

NEAR_AXIS = 1e-6  # of a direction that is taken for an axis


@dataclass(frozen=True, eq=False)
class Edit:
    """What is done, in this order: crop, floaters, x -> scale * rotation @ x + offset.

    Attributes:
        crop: what is kept; None: all.
        floaters: threshold of `floaters`; None: they stay.
        scale: a factor above 0.
        rotation: (3, 3) a rotation.
        offset: (3,) scene units.
    """

    crop: Region | None = None
    floaters: float | None = None
    scale: float = 1.0
    rotation: F64 = field(default_factory=lambda: np.eye(3))
    offset: F64 = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        if not 0 < self.scale < np.inf:
            raise ValueError(f"the scale {self.scale:g} is not above 0")

    @property
    def turns(self) -> bool:
        """Whether it changes more than positions by an offset."""
        return self.scale != 1 or not np.array_equal(self.rotation, np.eye(3))


@dataclass(frozen=True, eq=False)
class Edited:
    """What an edit made.

    Attributes:
        scene: the splats, and what is known of them.
        n_before: splats of all inputs.
        n_outside: of these, left out by the crop.
        n_floaters: of the rest, left out as floaters.
        stream: the edited stream, where no packet had to be encoded again.
        how: of streams: what was done to the packets, or why splats must be encoded again.
    """

    scene: Scene
    n_before: int
    n_outside: int
    n_floaters: int
    stream: bytes | None
    how: str


def edit_scenes(inputs: Sequence[Scene | Source], edit: Edit) -> Edited:
    """Edit scenes, or streams, which may be mixed.

    Args:
        inputs: at least one: scenes, whose splats are finite, or whole streams.
        edit: what is done to all of them together.

    Raises:
        StreamError: a stream is not legal.
        InputError: numbers would not be finite.
        OSError: a stream cannot be read.
    """
    found = [one if isinstance(one, Scene) else _Stream.of(one) for one in inputs]
    whole = merged([one.scene if isinstance(one, _Stream) else one for one in found])
    kept = np.ones(len(whole.splats), bool)
    if edit.crop is not None:
        kept = edit.crop.holds(whole.splats)
    n_inside = int(kept.sum())
    if edit.floaters is not None:
        kept[kept] = ~floaters(whole.splats.take(kept), edit.floaters)
    stream, how, offset = None, "a scene is no stream", edit.offset
    streams = [one for one in found if isinstance(one, _Stream)]
    if len(streams) == len(found):
        try:
            stream, how, offset = _on_packets(streams, whole.info, kept, edit)
        except _EncodeAgainError as error:
            how = str(error)
    linear = edit.scale * edit.rotation
    if stream is not None and offset.any():
        splats = decode_leaves(stream)  # of the integers: what was far away may be near now
    else:
        if stream is None:
            _warn_of_float32(streams)
        with np.errstate(over="ignore"):
            splats = transformed(whole.splats.take(kept), linear, offset if offset.any() else None)
    if not splats.finite().all():
        raise InputError("the edit makes numbers that are too large for a scene")
    return Edited(
        scene=Scene(splats, _info_after(whole.info, edit, linear, offset)),
        n_before=len(kept),
        n_outside=len(kept) - n_inside,
        n_floaters=n_inside - int(kept.sum()),
        stream=stream,
        how=how,
    )


def _warn_of_float32(streams: Sequence[_Stream]) -> None:
    n_moved = sum(one.n_moved for one in streams)
    if n_moved:
        text = f"float32 moves up to {n_moved:,} splats by more than a tenth of their size"
        warnings.warn(f"{text}: first move the stream near zero, which is exact", stacklevel=3)


def _info_after(info: SceneInfo, edit: Edit, linear: F64, offset: F64) -> SceneInfo:
    """What the scene says of itself then: up, if it is an axis still, the unit, and cameras."""
    axis = registry.name(registry.UP_AXES, info.up_axis)
    up = "unspecified"
    if axis != "unspecified":
        before = np.zeros(3)
        before["xyz".index(axis[1])] = -1 if axis[0] == "-" else 1
        after = edit.rotation @ before
        if np.abs(after).max() > 1 - NEAR_AXIS:
            k = int(np.argmax(np.abs(after)))
            up = ("-" if after[k] < 0 else "+") + "xyz"[k]
    return replace(
        info,
        up_axis=registry.UP_AXES.index(up),
        unit=info.unit if edit.scale == 1 else 0,
        text=placed_text(info.text, linear, offset),
    )


# --- on packets ----------------------------------------------------------------------------------


class _EncodeAgainError(Exception):
    """Packets cannot say what is asked for; the message says why."""


@dataclass(frozen=True, eq=False)
class _Stream:
    """A stream: its bytes, its scene, the splats of each tile, and those that float32 moves."""

    data: memoryview
    scene: Scene
    n_splats: list[int]
    n_moved: int

    @staticmethod
    def of(source: Source) -> _Stream:
        data = bytes_of(source)
        decoded = decode(data)
        n_splats = [int(np.count_nonzero(tile.live[: tile.n_slots])) for tile in decoded.tiles]
        splats = decoded.leaves()
        n_moved = n_moved_by_float32(decoded.directory, splats)
        return _Stream(data, Scene(splats, decoded.directory.info), n_splats, n_moved)


def _on_packets(
    streams: Sequence[_Stream], info: SceneInfo, kept: npt.NDArray[np.bool_], edit: Edit
) -> tuple[bytes, str, F64]:
    """The edited stream, how it was made, and by how much it was moved.

    Args:
        streams: at least one.
        info: of the whole.
        kept: (N,) True for the splats of all streams that stay.
        edit: what is done.

    Raises:
        _EncodeAgainError: splats must be encoded again.
    """
    if edit.scale != 1:
        raise _EncodeAgainError("sizes are stored as logarithms, which a scale shifts off the grid")
    if edit.turns:
        raise _EncodeAgainError("a rotation mixes the numbers of a splat")
    if len({frame_of(one.scene.info) for one in streams}) > 1:
        raise _EncodeAgainError("the streams have different axes")
    parts, said = [], []
    at = n_tiles = n_kept = 0
    for one in streams:
        tiles, at = _kept_tiles(one, kept, at)
        n_tiles, n_kept = n_tiles + len(tiles), n_kept + int(tiles.sum())
        parts.append(bytes(one.data) if tiles.all() else extract_tiles(one.data, tiles))
    if n_kept < n_tiles:
        said.append(f"{n_kept} of {n_tiles} tiles kept")
    whole, offset = parts[0], np.zeros(3)
    if len(parts) > 1:
        try:
            whole = joined(parts, info)
        except NotJoinableError as error:
            raise _EncodeAgainError(str(error)) from error
        said.append(f"packets of {len(parts)} streams joined")
    if edit.offset.any():
        try:
            found = moved(whole, edit.offset)
        except ValueError as error:
            raise _EncodeAgainError(str(error)) from error
        whole, offset = found.data, found.offset
        by = " ".join(f"{number:.9g}" for number in offset)
        is_whole = np.array_equal(offset, edit.offset)
        rounded = "" if is_whole else f", rounded to the grid of {found.unit:g}"
        said.append(f"origins moved by {by}{rounded}")
    return whole, "; ".join(said) or "nothing had to change", offset


def _kept_tiles(
    stream: _Stream, kept: npt.NDArray[np.bool_], at: int
) -> tuple[npt.NDArray[np.bool_], int]:
    """(n_tiles,) True for the tiles that stay, and where the splats of the next stream begin.

    Tiles without splats stay.

    Raises:
        _EncodeAgainError: a tile has splats of both kinds.
    """
    found = np.ones(len(stream.n_splats), bool)
    n_cut = 0
    for k, n_splats in enumerate(stream.n_splats):
        own = kept[at : at + n_splats]
        n_cut += bool(own.any() and not own.all())
        found[k] = not n_splats or own.any()
        at += n_splats
    if n_cut:
        raise _EncodeAgainError(f"{n_cut} of {len(found)} tiles keep only some of their splats")
    return found, at
