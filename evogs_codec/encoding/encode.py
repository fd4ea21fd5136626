"""Encoding: a tree to the bytes of a stream.

EvolutionTree -> arrange -> quantise -> CodedTree -> write -> bytes
"""

from __future__ import annotations

from evogs_codec.encoding.arrange import arrange, default_tiles
from evogs_codec.encoding.measured_gains import MeasuredGains, Pictures
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.settings import PRESETS, Settings
from evogs_codec.encoding.write import Progress, write
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.tree import EvolutionTree

__all__ = ["encode"]


def encode(
    tree: EvolutionTree,
    settings: Settings | None = None,
    *,
    n_tiles: int | None = None,
    info: SceneInfo | None = None,
    digests: bool = True,
    pictures: Pictures | None = None,
    progress: Progress | None = None,
) -> bytes:
    """A stream of a tree.

    Args:
        tree: any tree.
        settings: accuracy; by default the integers that the tree was trained in, or else the
            preset `trained`.
        n_tiles: tiles wanted; by default 1 below about 200,000 leaves.
        info: metadata.
        digests: store a digest of the last state of each tile and component.
        pictures: of the leaves, by which the packets are put in order; estimates by default.
        progress: called with the name of a stage and the part of it that is done.

    Raises:
        NotRepresentableError: values too large for any grid of the format.
        ValueError: the tree exceeds the limits of the format.
    """
    if settings is None:
        settings = Settings.of_quanta(tree.quanta) if tree.quanta else PRESETS["trained"]
    report = progress or (lambda _stage, _part: None)
    report("arrange", 0.0)
    tiles = arrange(tree, n_tiles or default_tiles(tree.n_leaves))
    coded = quantise(
        tiles,
        max(tree.n_levels, 1),
        settings,
        info=info,
        progress=lambda part: report("quantise", part),
    )
    if pictures is not None and tree.n_leaves:
        report("draw", 0.0)
        coded = MeasuredGains.of(tree, pictures).rescale(coded)
    return write(coded, effort=settings.effort, digests=digests, progress=report)
