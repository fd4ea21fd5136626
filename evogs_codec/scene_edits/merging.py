"""Several scenes as one."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

from evogs_codec.editing.level_psnr import KEY as PSNR
from evogs_codec.io.interchange.frames import frame_of, transformed, turn
from evogs_codec.io.interchange.scene_files import Scene
from evogs_codec.model.placement import PLACES
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

__all__ = ["merged", "merged_info"]

MAX_TEXT = 65_535  # bytes of a value of the metadata


def merged(scenes: Sequence[Scene]) -> Scene:
    """All splats of several scenes, in the axes of the first, with the highest SH degree of all.

    Args:
        scenes: at least one. A scene whose `coordinate_system` is another is turned.
    """
    frame = frame_of(scenes[0].info)
    parts = [transformed(one.splats, turn(frame_of(one.info), frame)) for one in scenes]
    return Scene(SplatParams.joined(parts), merged_info([one.info for one in scenes]))


def merged_info(infos: Sequence[SceneInfo]) -> SceneInfo:
    """What the first says, with the texts of all: values that differ stand one after another.

    A PSNR of levels is left out; cameras and the place in the world are those of the first. A
    warning says if only some scenes are antialiased.
    """
    text = {key: infos[0].text[key] for key in PLACES if key in infos[0].text}
    for key in sorted({key for info in infos for key in info.text} - {PSNR, *PLACES}):
        values = dict.fromkeys(info.text[key] for info in infos if key in info.text)
        whole = " + ".join(values).encode()[:MAX_TEXT]
        text[key] = whole.decode(errors="ignore")
    if len({info.antialiased for info in infos}) > 1:
        said = "antialiased" if infos[0].antialiased else "not antialiased"
        warnings.warn(
            f"of the scenes only some are antialiased: all are taken as {said}", stacklevel=2
        )
    return replace(infos[0], text=text)
