"""Encoding: a tree to the bytes of a stream.

    EvolutionTree -> arrange -> quantise -> CodedTree -> packets -> bytes

`write` is exact: it turns the integers of a `CodedTree` into a stream and nothing else.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping

import numpy as np

from evogs_codec.common.parallel import each
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import replay
from evogs_codec.encoding.arrange import arrange, default_tiles
from evogs_codec.encoding.measured_gains import Pictures, Shown
from evogs_codec.encoding.packet_order import Place, packet_order, palette_places
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.settings import PRESETS, Settings
from evogs_codec.format import layout
from evogs_codec.format.directory import UNKNOWN_ERROR, Directory, read_directory
from evogs_codec.format.pack import pack, pack_entries, pack_picks
from evogs_codec.format.write_directory import build_directory
from evogs_codec.model.channels import N_GROUPS, PALETTE, PICKS, component_slice
from evogs_codec.model.coded_tree import CodedStep, CodedTree
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.tree import EvolutionTree, Kind

__all__ = ["encode", "write"]

Progress = Callable[[str, float], None]


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
        NotRepresentable: values too large for any grid of the format.
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
        coded = Shown.of(tree, pictures).put_right(coded)
    return write(coded, effort=settings.effort, digests=digests, progress=report)


def write(
    tree: CodedTree,
    *,
    effort: int = 19,
    digests: bool = True,
    progress: Progress | None = None,
) -> bytes:
    """The stream of a coded tree; `decode` gives back exactly its integers.

    Packets are in the order of `progression`.

    Raises:
        ValueError: an integer needs more than 24 bits, or a limit of the format is exceeded.
    """
    report = progress or (lambda _stage, _part: None)
    levels = tree.palette_levels

    def pack_one(place: Place) -> bytes:
        tile, number, component = place
        if tree.entries is not None and component == PALETTE:
            of_level = tree.entry_levels == levels[number]
            return pack_entries(tree.entries[:, of_level], effort=effort)
        step = tree.tiles[tile].steps[number]
        if tree.entries is not None and component == PICKS:
            return pack_picks(step.picks, step.n_new, effort=effort)
        part = component_slice(component)
        alpha = [
            step.alpha[group] if len(tree.alpha_table(step.level, group).entries) > 1 else None
            for group in range(N_GROUPS)
        ]
        return pack(
            component,
            step.slots,
            step.kinds,
            alpha,
            step.psi[part],
            step.adds[part],
            effort=effort,
        )

    places = [
        (tile, number, component)
        for tile, own in enumerate(tree.tiles)
        for number in range(len(own.steps))
        for component in range(tree.n_components)
    ]
    places += palette_places(tree)
    bodies: dict[Place, bytes] = {}
    for k, (place, body) in enumerate(zip(places, each(pack_one, places), strict=True)):
        report("pack", k / len(places))
        bodies[place] = body
    order = packet_order(tree, {place: len(body) for place, body in bodies.items()})
    entries = np.zeros(len(order), layout.dtype_of(layout.PACKET_ENTRY))
    for row, (tile, number, component) in zip(entries, order, strict=True):
        body = bodies[tile, number, component]
        if tree.entries is not None and component == PALETTE:
            row["level"], row["error"] = levels[number], UNKNOWN_ERROR
            row["n_adds"] = np.count_nonzero(tree.entry_levels == levels[number])
        else:
            step = tree.tiles[tile].steps[number]
            for name, value in _entry(step, component).items():
                row[name] = value
        row["tile"], row["component"] = tile, component
        row["size"], row["crc"] = len(body), zlib.crc32(body)
    tiles = np.zeros(len(tree.tiles), layout.dtype_of(layout.TILE_ENTRY))
    for row, own in zip(tiles, tree.tiles, strict=True):
        row["origin"], row["box_min"], row["box_max"] = own.origin, own.box_min, own.box_max

    def directory(found: Mapping[Place, bytes]) -> bytes:
        return build_directory(
            sh_degree=tree.sh_degree,
            n_levels=tree.n_levels,
            grid_exponents=tree.grid_exponents,
            info=tree.info,
            quantisers=tree.quantisers,
            alpha=tree.alpha,
            tiles=tiles,
            packets=entries,
            digests=found,
            has_palette=tree.entries is not None,
        )

    data = b"".join(bodies[place] for place in order)
    head = directory({})
    if not digests:
        return head + data
    report("verify", 0.0)
    # What is digested is what a decoder decodes from these bytes, so every encode is checked.
    return directory(final_digests(read_directory(memoryview(head)), head + data)) + data


def final_digests(directory: Directory, stream: bytes) -> dict[Place, bytes]:
    """Digests of the last state of each tile and component, and of the palette (spec 5.7)."""
    decoded = replay(directory, memoryview(stream), Cut.full(directory))
    digests = {
        (tile, component, n - 1): decoded.tiles[tile].digest(component)
        for tile, row in enumerate(decoded.cut.steps.tolist())
        for component, n in enumerate(row)
        if n
    }
    palette = decoded.tiles[0].palette if directory.n_entries else None
    if palette is not None:
        digests[0, PALETTE, palette.n_applied - 1] = palette.digest()
    return digests


def _entry(step: CodedStep, component: int) -> dict[str, int]:
    """The fields of a packet entry that follow from the step."""
    error = step.error[component] if step.error else UNKNOWN_ERROR
    if component:
        return {"error": error}
    n_splits = int(np.count_nonzero(step.kinds == Kind.SPLIT))
    n_refines = int(np.count_nonzero(step.kinds == Kind.REFINE))
    return {
        "level": step.level,
        "n_adds": step.adds.shape[1],
        "n_splits": n_splits,
        "n_refines": n_refines,
        "n_drops": len(step.slots) - n_splits - n_refines,
        "error": error,
    }
