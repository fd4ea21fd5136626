"""What is up in a scene that is never in memory as a whole: some of its splats show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.jobs.partition import SPLATS_OF_STAND_IN, Partition, rows_of, stand_ins_of
from evogs_codec.jobs.tile_job import sorted_rows
from evogs_codec.model.channels import n_channels
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Up
    from evogs_codec.render.up import Direction

__all__ = ["up_of_tiles"]

N_SAMPLED = 1 << 16  # splats, about
SAMPLED_UP_TO = 1 << 19  # of no more splats some are looked at themselves, of more the stand-ins


def up_of_tiles(partition: Partition, asked: Direction | None, info: SceneInfo) -> Up:
    """What was asked for, or else what the file says, or else what some splats show.

    It is the same in whatever order the splats were read.

    Args:
        partition: tiles on disk.
        asked: what is up, if the caller knows.
        info: of the scene.
    """
    from evogs_codec.render import Up, up_of
    from evogs_codec.render.up import said_by

    if asked is not None:
        return Up.of(asked, "as asked for")
    if (axis := said_by(info)) is not None:
        return Up.of(axis, "as the file says")
    return up_of(_some(partition))


def _some(partition: Partition) -> SplatParams:
    """Some splats of all tiles, positions from the first tile."""
    degree, tree = partition.sh_degree, partition.tree
    tiles = np.flatnonzero(partition.counts).tolist()
    n = int(partition.counts.sum())
    file_of = rows_of if n <= SAMPLED_UP_TO else stand_ins_of
    every = max(1, -(-n // (N_SAMPLED if n <= SAMPLED_UP_TO else N_SAMPLED * SPLATS_OF_STAND_IN)))
    parts = [np.empty((0, n_channels(degree)), np.float32)]
    for tile in tiles:
        rows = sorted_rows(str(file_of(partition.folder, tile)), degree)[::every]
        rows[:, 0:3] += (tree.origins[tile] - tree.origins[tiles[0]]).astype(np.float32)
        parts.append(rows)
    return SplatParams.from_channels(np.concatenate(parts).T)
