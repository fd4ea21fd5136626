"""What coders spend on the integers of a stream: ideally, by rANS, in parts by context."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path

import numpy as np

from evogs_codec import (
    PRESETS,
    EvolutionTree,
    Settings,
    encode,
    lift,
    read_directory,
    read_ply,
    read_tree,
)
from evogs_codec.planes import entropy, split_planes
from evogs_codec.splats import I32
from tools.bench.entropy import parts, rans
from tools.bench.entropy.contexts import (
    CONTEXTS,
    adaptive_bits,
    choose_model,
    classes_of,
    joint_counts,
    magnitudes_of,
)
from tools.bench.entropy.lists import IntegerList, ListPacket, packets
from tools.scene import make_scene

__all__ = ["VARIANTS", "Sample", "samples"]

Costs = dict[str, dict[str, float]]  # by what a list holds, by coder: bytes
# Splats on their own, at the steps that the preset gives the last level.
FLAT = replace(PRESETS["scene"], coarser=(0.0,) * 8)
VARIANTS: dict[str, tuple[str, ...]] = {
    "rANS, no contexts": (),
    "rANS, contexts of the packet": ("neighbour", "channel", "record"),
    "rANS, all contexts": CONTEXTS,
}


@dataclass(frozen=True, eq=False)
class Sample:
    """A stream and its integers.

    Attributes:
        name: what it is of.
        data: the stream.
        fast: the same at effort 3.
        n: leaves.
        packets: of `data`.
    """

    name: str
    data: bytes
    fast: bytes
    n: int
    packets: tuple[ListPacket, ...]

    @staticmethod
    def of(name: str, tree: EvolutionTree, settings: Settings) -> Sample:
        """Of a tree."""
        data = encode(tree, settings)
        fast = encode(tree, replace(settings, effort=3))
        return Sample(name, data, fast, tree.n_leaves, tuple(packets(memoryview(data))))

    @cached_property
    def head(self) -> int:
        """Bytes of the directory, and of the packet headers without their frame entries."""
        directory = read_directory(memoryview(self.data)).data_offset
        return directory + sum(2 + len(packet.header.codings) for packet in self.packets)

    @cached_property
    def costs(self) -> Costs:
        """Of the lists, by ideal coders."""
        found: Costs = defaultdict(lambda: defaultdict(float))
        for packet in self.packets:
            for one, known in with_contexts(packet):
                for coder, bits in _bits(one, known).items():
                    found[one.name][coder] += bits / 8
        return found

    def total(self, coder: str) -> float:
        """Bytes of the stream if its lists cost what `costs` says."""
        return self.head + sum(part[coder] for part in self.costs.values())

    @cached_property
    def blocks(self) -> dict[str, list[bytes]]:
        """The lists of each packet, by rANS with the contexts of each of VARIANTS."""
        found: dict[str, list[bytes]] = {name: [] for name in VARIANTS}
        for packet in self.packets:
            pairs = with_contexts(packet)
            lists, known = [one.values for one, _ in pairs], [known for _, known in pairs]
            for name, contexts in VARIANTS.items():
                models = [
                    choose_model(z, some, contexts) for z, some in zip(lists, known, strict=True)
                ]
                found[name].append(rans.encode(lists, models, known))
        return found

    @cached_property
    def parted(self) -> list[parts.Parted]:
        """The lists of each packet, with planes of their own for each class of a context."""
        found = []
        for packet in self.packets:
            pairs = with_contexts(packet)
            found.append(
                parts.encode([one.values for one, _ in pairs], [some for _, some in pairs])
            )
        return found


@cache
def samples(ply: Path | None, tree: Path | None) -> tuple[Sample, ...]:
    """Scenes lifted and without a tree; a trained tree, and its leaves without a tree."""
    scenes = {"shipped": make_scene()} | ({ply.stem: read_ply(ply)} if ply else {})
    found = []
    for scene, splats in scenes.items():
        found += [
            Sample.of(f"{scene}, lifted", lift(splats, 5), PRESETS["scene"]),
            Sample.of(f"{scene}, no tree", EvolutionTree.of_splats(splats), FLAT),
        ]
    if tree:
        trained, name = read_tree(tree), tree.name.split(".")[0]
        leaves = EvolutionTree.of_splats(trained.leaves())
        found += [
            Sample.of(f"{name}, trained", trained, PRESETS["trained"]),
            Sample.of(f"{name}, near-lossless", trained, PRESETS["near-lossless"]),
            Sample.of(f"{name}, no tree", leaves, FLAT),
        ]
    return tuple(found)


def with_contexts(packet: ListPacket) -> list[tuple[IntegerList, dict[str, I32]]]:
    """The lists of a packet with the magnitudes of their contexts."""
    values = [one.values for one in packet.lists]
    return [
        (one, {context: one.magnitudes(context, values) for context in one.contexts})
        for one in packet.lists
    ]


def _bits(one: IntegerList, known: Mapping[str, I32]) -> dict[str, float]:
    """Bits of a list by ideal coders."""
    planes = split_planes(one.values, one.coding)
    found = {
        "planes": sum(entropy(np.frombuffer(plane, np.uint8)) for plane in planes),
        "integers": entropy(one.values),
    }
    none = choose_model(one.values, known, ())
    for context in CONTEXTS[1:]:
        found[f"static {context}"] = choose_model(one.values, known, (context,)).bits
    found["static none"] = none.bits
    found["static"] = min(bits for coder, bits in found.items() if coder.startswith("static"))

    tokens, n_raw = none.split.tokens(one.values)
    raw = float(n_raw.sum(dtype=np.int64))
    whole = dict(known) | {"neighbour": magnitudes_of("neighbour", none.split, tokens, known)}
    zero = adaptive_bits(joint_counts(tokens, np.zeros(len(tokens), np.uint8)))
    single = {
        context: adaptive_bits(joint_counts(tokens, classes_of(magnitudes)))
        for context, magnitudes in whole.items()
    }
    for context in CONTEXTS:
        found[f"adaptive {context}"] = raw + min(zero, single.get(context, zero))
    found["adaptive"] = raw + min(zero, *single.values())
    octaves = [classes_of(magnitudes) // 2 for magnitudes in whole.values()]
    pairs = [
        adaptive_bits(joint_counts(tokens, 16 * a.astype(np.int32) + b))
        for a, b in combinations(octaves, 2)
    ]
    found["adaptive, two"] = min([found["adaptive"], *(raw + bits for bits in pairs)])
    return found
