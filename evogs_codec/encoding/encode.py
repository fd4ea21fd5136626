"""Encoding: a tree to the bytes of a stream.

EvolutionTree -> arrange -> quantise -> CodedTree -> write -> bytes
"""

from __future__ import annotations

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.encoding.alpha_tables import with_used_entries
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.measured_gains import MeasuredGains
from evogs_codec.encoding.pictures import Pictures
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.settings import PRESETS, Settings
from evogs_codec.encoding.write import write
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree

__all__ = ["encode", "expect_tree"]


def encode(
    tree: EvolutionTree,
    settings: Settings | None = None,
    *,
    n_tiles: int | None = None,
    info: SceneInfo | None = None,
    digests: bool = True,
    views: Pictures | None = None,
    progress: Progress | None = None,
) -> bytes:
    """A stream of a tree.

    Args:
        tree: any tree.
        settings: accuracy; may be missing for a tree that was trained in integers, which are then
            stored as they are. `encode_tree` chooses settings for every tree.
        n_tiles: tiles wanted; by default 1 below about 200,000 leaves.
        info: metadata.
        digests: store a digest of the last state of each tile and component.
        views: of the leaves, by which the packets are put in order; estimates by default.
        progress: called with the name of a stage and the part of it that is done.

    Raises:
        NotRepresentableError: values too large for any grid of the format.
        TypeError: `tree` is no tree, or `settings` are none; the message says what to call.
        ValueError: the tree exceeds the limits of the format, settings are missing, or `n_tiles` is
            below 1.
    """
    expect_tree(tree)
    settings = _settings(tree, settings)
    report = progress or no_progress
    report("arrange", 0.0)
    tiles = arrange(tree, n_tiles)
    coded = quantise(tiles, max(tree.n_levels, 1), settings, info=info, progress=report)
    if views is not None and tree.n_leaves:
        report("draw", 0.0)
        coded = MeasuredGains.of(tree, views).rescale(coded)
    coded = with_used_entries(coded)
    return write(coded, zstd_level=settings.zstd_level, digests=digests, progress=report)


def expect_tree(tree: object) -> None:
    """Refuse what is no tree, and say what to call.

    Raises:
        TypeError: `tree` is something else.
    """
    if not isinstance(tree, EvolutionTree):
        other = "encode_scene takes splats" if isinstance(tree, SplatParams) else "see read_tree"
        raise TypeError(f"expected an EvolutionTree, not {type(tree).__name__}: {other}")


def _settings(tree: EvolutionTree, settings: object) -> Settings:
    """The settings, or those of a tree that was trained in integers."""
    if isinstance(settings, Settings):
        return settings
    if settings is not None:
        named = f"PRESETS[{settings!r}]" if settings in PRESETS else "a preset of PRESETS"
        raise TypeError(f"expected Settings, not {settings!r}: {named}")
    if not tree.quanta:
        raise ValueError(
            "settings are missing: encode_tree chooses them, or name a preset:"
            " encode(tree, PRESETS['scene'])"
        )
    return Settings.of_quanta(tree.quanta)
