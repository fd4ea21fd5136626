"""Several scenes as one."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from evogs_codec.editing.level_psnr import KEY as PSNR
from evogs_codec.io.interchange.frames import frame_of, transformed, turn
from evogs_codec.io.interchange.scene_files import Scene
from evogs_codec.model.placement import PLACES
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, SplatParams

__all__ = ["merged", "merged_info"]

MOST_TEXT = 65_535  # bytes of a value of the metadata


def merged(scenes: Sequence[Scene]) -> Scene:
    """All splats of several scenes, in the axes of the first, with the highest SH degree of all.

    Args:
        scenes: at least one. A scene whose `coordinate_system` is another is turned.
    """
    frame = frame_of(scenes[0].info)
    parts = [transformed(one.splats, turn(frame_of(one.info), frame)) for one in scenes]
    degree = max(part.sh_degree for part in parts)
    whole = SplatParams(
        means=np.concatenate([part.means for part in parts]),
        quats=np.concatenate([part.quats for part in parts]),
        log_scales=np.concatenate([part.log_scales for part in parts]),
        opacity_logits=np.concatenate([part.opacity_logits for part in parts]),
        sh=np.concatenate([_with_degree(part.sh, degree) for part in parts]),
    )
    return Scene(whole, merged_info([one.info for one in scenes]))


def merged_info(infos: Sequence[SceneInfo]) -> SceneInfo:
    """What the first says, with the texts of all: values that differ stand one after another.

    A PSNR of levels is left out; cameras and the place in the world are those of the first. A
    warning says if only some scenes are antialiased.
    """
    text = {key: infos[0].text[key] for key in PLACES if key in infos[0].text}
    for key in sorted({key for info in infos for key in info.text} - {PSNR, *PLACES}):
        values = dict.fromkeys(info.text[key] for info in infos if key in info.text)
        whole = " + ".join(values).encode()[:MOST_TEXT]
        text[key] = whole.decode(errors="ignore")
    if len({info.antialiased for info in infos}) > 1:
        said = "antialiased" if infos[0].antialiased else "not antialiased"
        warnings.warn(
            f"of the scenes only some are antialiased: all are taken as {said}", stacklevel=2
        )
    return replace(infos[0], text=text)


def _with_degree(sh: F32, degree: int) -> F32:
    """(N, (degree + 1)**2, 3): coefficients that are missing are 0."""
    missing = (degree + 1) ** 2 - sh.shape[1]
    return np.pad(sh, ((0, 0), (0, missing), (0, 0)))
