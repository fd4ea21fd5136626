"""The JSON of a tileset: one file, or several where one would be too much to begin with.

A tile whose children are in another file has that file as its content.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from evogs_codec.common.version import __version__
from evogs_codec.model.splats import F64
from evogs_codec.tileset.nodes import Node

__all__ = ["FOLDER", "GENERATOR", "MAX_JSON", "ROOT", "Frame", "json_files"]

MAX_JSON = 1 << 16  # bytes of a file, about: what is to be read before the first splat
ROOT = "tileset.json"
FOLDER = "tiles"
GENERATOR = f"evogs {__version__}"


@dataclass(frozen=True)
class Frame:
    """Where a tileset is.

    Attributes:
        matrix: (4, 4) from the scene to what is around the tileset.
        scale: metres of a unit of the scene there.
        extras: what is said of the scene.
    """

    matrix: F64
    scale: float
    extras: dict[str, Any]


def json_files(root: Node, frame: Frame, ending: str, max_json: int = MAX_JSON) -> dict[str, bytes]:
    """The text of each file by its name.

    Args:
        root: of the tileset.
        frame: where it is.
        ending: of contents.
        max_json: bytes of a file, about.
    """
    sizes = {root.name: len(_text(_tile(root, root.origin, FOLDER, ending)))}
    for node in root.all():
        for child in node.children:
            sizes[child.name] = len(_text(_tile(child, node.origin, FOLDER, ending)))
    files: dict[str, bytes] = {}
    todo = [(root, ROOT)]
    while todo:
        top, name = todo.pop()
        within = _within(top, sizes, max_json)
        is_root = name == ROOT
        folder = f"{FOLDER}/" if is_root else ""
        tile = _tree(top, top.origin, within, folder, ending)
        if is_root:
            matrix = frame.matrix @ translation(root.origin)
            tile = {"transform": matrix.T.ravel().tolist(), **tile}
        tile["refine"] = "REPLACE"
        text = {
            "asset": {"version": "1.1", "extras": {"generator": GENERATOR}},
            "geometricError": frame.scale * (_outermost(root) if is_root else top.error),
            "root": tile,
        }
        if is_root:
            text["extras"] = frame.extras
        files[name] = _text(text) + b"\n"
        todo += [
            (node, f"{FOLDER}/{node.name}.json")
            for one in top.all()
            if one.name in within
            for node in one.children
            if node.children and node.name not in within
        ]
    return files


def translation(way: F64) -> F64:
    """(4, 4) by (3,)."""
    out = np.eye(4)
    out[:3, 3] = way
    return out


def _outermost(root: Node) -> float:
    """What is missing where nothing is drawn: all of it."""
    return max(root.box.diagonal, root.error)


def _within(top: Node, sizes: dict[str, int], most: int) -> set[str]:
    """The names of the nodes whose children are in the file of `top`; leaves are not among them.

    Nodes nearer to the top come first, so that the file is as large as it may be.
    """
    found, size = {top.name}, sizes[top.name] + sum(sizes[child.name] for child in top.children)
    rank = list(top.children)
    while rank:
        after: list[Node] = []
        for node in rank:
            own = sum(sizes[child.name] for child in node.children)
            if node.children and size + own <= most:
                found.add(node.name)
                size += own
                after += node.children
        rank = after
    return found


def _tree(node: Node, parent: F64, within: set[str], folder: str, ending: str) -> dict[str, Any]:
    if node.children and node.name not in within:
        tile = _tile(node, parent, folder, ending)
        tile["content"] = {"uri": f"{folder}{node.name}.json"}
        return tile
    tile = _tile(node, parent, folder, ending)
    if node.children:
        tile["children"] = [
            _tree(child, node.origin, within, folder, ending) for child in node.children
        ]
    return tile


def _tile(node: Node, parent: F64, folder: str, ending: str) -> dict[str, Any]:
    """A tile without its children."""
    low, high = np.array(node.box.low), np.array(node.box.high)
    half = np.diag((high - low) / 2)
    box = [*((low + high) / 2).tolist(), *half.ravel().tolist()]
    tile: dict[str, Any] = {}
    way = node.origin - parent
    if way.any():
        tile["transform"] = translation(way).T.ravel().tolist()
    return tile | {
        "boundingVolume": {"box": list(map(_short, box))},
        "geometricError": node.error,
        "content": {
            "uri": f"{folder}{node.name}{ending}",
            "extras": {"splats": node.n_splats, "bytes": node.n_bytes},
        },
    }


def _short(x: float) -> float | int:
    return int(x) if x == int(x) and abs(x) < 1 << 53 else x


def _text(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
