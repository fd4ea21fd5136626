"""The nodes of a tileset: files at the leaves, overviews above them.

The k-d tree of the files has two children at each node. Of it those nodes are taken that give a
tree with few levels, in which a node has about `FANOUT` children.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from evogs_codec.jobs.partition import Partition
from evogs_codec.jobs.tile_tree import Tree
from evogs_codec.model.splats import F64
from evogs_codec.tileset.boxes import Box

__all__ = ["Node", "nodes_of"]

FANOUT = 8
MAX_CHILDREN = 16  # children


@dataclass(eq=False)
class Node:
    """A tile of the tileset.

    Attributes:
        name: `root`, or numbers of children from the root on.
        origin: (3,) of its content, in the scene.
        tile: of the partition; None of an inner node.
        weight: splats of the scene below it.
        children: of an inner node.
        box: of its content and all below, from its origin; known when these are made.
        error: scene units: how large what an overview merges is; 0 of a leaf.
        n_splats, n_bytes: of its content.
    """

    name: str
    origin: F64
    tile: int | None
    weight: int
    children: list[Node] = field(default_factory=list)
    box: Box = field(default_factory=lambda: Box((0, 0, 0), (0, 0, 0)))
    error: float = 0.0
    n_splats: int = 0
    n_bytes: int = 0

    @property
    def height(self) -> int:
        """Levels of nodes below."""
        return 1 + max(child.height for child in self.children) if self.children else 0

    def all(self) -> Iterator[Node]:
        """This node and all below, parents first."""
        yield self
        for child in self.children:
            yield from child.all()


def nodes_of(partition: Partition) -> Node:
    """The root."""
    tree = partition.tree
    leaves = _Leaves(tree, partition.counts)
    return _node(leaves, 0, "root")


class _Leaves:
    """Files below each node of a k-d tree, those without splats left out."""

    def __init__(self, tree: Tree, counts: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        self.tree = tree
        self.counts = counts
        n = len(tree.axis)
        self.n_files = np.zeros(n, np.int64)
        self.n_splats = np.zeros(n, np.int64)
        for node in range(n - 1, -1, -1):  # children come after their parents
            child = int(tree.child[node])
            if tree.axis[node] < 0:
                self.n_splats[node] = counts[child]
                self.n_files[node] = counts[child] > 0
            else:
                self.n_splats[node] = self.n_splats[child] + self.n_splats[child + 1]
                self.n_files[node] = self.n_files[child] + self.n_files[child + 1]

    def below(self, node: int) -> list[int]:
        """The children that have splats; none of a leaf."""
        if self.tree.axis[node] < 0:
            return []
        child = int(self.tree.child[node])
        return [one for one in (child, child + 1) if self.n_files[one]]


def _node(leaves: _Leaves, at: int, name: str) -> Node:
    while len(only := leaves.below(at)) == 1:
        at = only[0]
    weight = int(leaves.n_splats[at])
    if leaves.n_files[at] == 1:
        tile = int(leaves.tree.child[at])
        return Node(name, leaves.tree.origins[tile], tile, weight)
    most = FANOUT
    while most * FANOUT < leaves.n_files[at]:
        most *= FANOUT
    most = 1 if leaves.n_files[at] <= FANOUT else most
    found = leaves.below(at)
    while len(found) < MAX_CHILDREN:
        largest = max(range(len(found)), key=lambda k: (leaves.n_files[found[k]], -k))
        if leaves.n_files[found[largest]] <= most:
            break
        found[largest : largest + 1] = leaves.below(found[largest])
    prefix = "" if name == "root" else f"{name}-"
    children = [_node(leaves, one, f"{prefix}{k}") for k, one in enumerate(found)]
    origins = np.array([child.origin for child in children])
    # Halves of the sum of two multiples of a power of two: exact, as all that is derived from it.
    middle: F64 = (origins.min(axis=0) + origins.max(axis=0)) / 2
    return Node(name, middle, None, weight, children)
