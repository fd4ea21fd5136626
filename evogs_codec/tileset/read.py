"""Reading a tileset: its tiles, in coordinates of the scene; each file of tiles when asked for.

Below the root, tiles are only moved, as `write_tileset` does it. So the coordinates of the scene
are those of the content of the root and its origin, which is in the extras.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.model.splats import F64
from evogs_codec.tileset.boxes import Box
from evogs_codec.tileset.places import Place

__all__ = ["Tile", "Tileset"]

MAX_TILES = 1_000_000
MAX_DEPTH = 64
MAX_FAR = 1e30  # of the origin of a tile, scene units: sums with positions stay float32


@dataclass(eq=False)
class Tile:
    """A tile.

    Attributes:
        origin: (3,) of its content, in the scene.
        box: from that origin.
        error: geometric error, scene units.
        name: of the file of its content; None without one.
        n_splats, n_bytes: of the content as the tileset says; None if it does not.
        children: those that are known; `Tileset.children` has all.
        depth: 0 of the root.
    """

    origin: F64
    box: Box
    error: float
    name: str | None
    n_splats: int | None
    n_bytes: int | None
    depth: int
    children: list[Tile] = field(default_factory=list)

    @property
    def box_in_scene(self) -> Box:
        """The box in the coordinates of the scene."""
        return self.box.moved(self.origin)


class Tileset:
    """The tiles of a place.

    Attributes:
        place: where its files are.
        matrix: (4, 4) from the content of the root to what is around the tileset.
        extras: what the tileset says of the scene.
        root: the first tile.
        n_json: bytes of JSON that were read.
        n_json_files: of these.
    """

    def __init__(self, place: Place) -> None:
        """Reads the file of the root.

        Raises:
            InputError: it is no tileset that is known.
            OSError: it cannot be read.
        """
        self.place = place
        self.n_json = self.n_json_files = self._n_tiles = 0
        self.matrix: F64 = np.eye(4)
        self.extras: dict[str, Any] = {}
        self._read: set[str] = set()
        self._contents: set[str] = set()
        found = self._json(place.root)
        extras = found.get("extras")
        own = extras.get("evogs") if isinstance(extras, dict) else None
        self.extras = own if isinstance(own, dict) else {}
        try:
            origin = _numbers(self.extras.get("origin", [0, 0, 0]), 3, "origin")
        except _BadError as error:
            raise InputError(f"{place}: {error}") from error
        self.root = self._tiles(found, place.root, None, origin)

    def children(self, tile: Tile) -> list[Tile]:
        """Those of a tile; their file is read if it was not.

        Raises:
            InputError, OSError: as of the file of the root.
        """
        self.load(tile)
        return tile.children

    def load(self, tile: Tile) -> None:
        """Read the file that is the content of a tile, which becomes the tile itself.

        Raises:
            InputError, OSError: as of the file of the root.
        """
        while tile.name is not None and tile.name.endswith(".json"):
            name = tile.name
            inner = self._tiles(self._json(name), name, tile, tile.origin)
            tile.name, tile.n_splats, tile.n_bytes = inner.name, inner.n_splats, inner.n_bytes
            tile.children = inner.children
            tile.origin, tile.box, tile.error = inner.origin, inner.box, inner.error

    def all(self) -> Iterator[Tile]:
        """All tiles, parents first; every file of tiles is read.

        Raises:
            InputError, OSError: as of the file of the root.
        """
        todo = [self.root]
        while todo:
            tile = todo.pop()
            children = self.children(tile)
            yield tile
            todo += reversed(children)

    def files(self) -> frozenset[str]:
        """The names of all files, from the folder of the root.

        Raises:
            InputError, OSError: as of the file of the root.
        """
        contents = {tile.name for tile in self.all() if tile.name is not None}
        return frozenset(contents | self._read)

    def _json(self, name: str) -> dict[str, Any]:
        if name in self._read:
            raise InputError(f"{self.place}: {shown(name)} is among its own tiles")
        self._read.add(name)
        data = self.place.text(name)
        self.n_json += len(data)
        self.n_json_files += 1
        try:
            found = json.loads(data, parse_constant=_no_number)
        except RecursionError as error:
            raise InputError(f"{self.place.path_of(name)}: is nested too deeply") from error
        except ValueError as error:
            raise InputError(f"{self.place.path_of(name)}: is not JSON: {shown(error)}") from error
        if not isinstance(found, dict) or not isinstance(found.get("asset"), dict):
            raise InputError(f"{self.place.path_of(name)}: is no tileset: it has no asset")
        version = found["asset"].get("version")
        if version not in ("1.0", "1.1"):
            raise InputError(f"{self.place.path_of(name)}: is of 3D Tiles {shown(str(version))}")
        return found

    def _tiles(self, found: dict[str, Any], name: str, outer: Tile | None, origin: F64) -> Tile:
        """The tiles of a file; `origin` is that of its first tile before it is moved."""
        depth = 0 if outer is None else outer.depth
        try:
            top = self._tile(found.get("root"), name, origin, depth, is_root=outer is None)
            todo = [(top, found["root"])]
            while todo:
                tile, said = todo.pop()
                for child in _listed(said.get("children")):
                    tile.children.append(
                        self._tile(child, name, tile.origin, tile.depth + 1, is_root=False)
                    )
                    todo.append((tile.children[-1], child))
        except _BadError as error:
            raise InputError(f"{self.place.path_of(name)}: {error}") from error
        return top

    def _tile(self, said: object, name: str, parent: F64, depth: int, *, is_root: bool) -> Tile:
        self._n_tiles += 1
        if self._n_tiles > MAX_TILES or depth > MAX_DEPTH:
            raise _BadError(f"more than {MAX_TILES:,} tiles, or {MAX_DEPTH} below one another")
        if not isinstance(said, dict):
            raise _BadError("a tile is no object")
        if "contents" in said or "implicitTiling" in said:
            raise _BadError("tiles with several contents or implicit ones are not read")
        matrix = _numbers(said.get("transform", np.eye(4).ravel().tolist()), 16, "transform")
        matrix = matrix.reshape(4, 4).T
        origin = parent
        if is_root:
            self.matrix = matrix
        else:
            if not np.array_equal(matrix[:3, :3], np.eye(3)) or matrix[3].tolist() != [0, 0, 0, 1]:
                raise _BadError("a tile below the root is turned or scaled, not only moved")
            origin = parent + matrix[:3, 3]
        if np.abs(origin).max() > MAX_FAR:
            raise _BadError(f"a tile is over {MAX_FAR:.0e} units from the origin of the scene")
        volume = said.get("boundingVolume")
        if not isinstance(volume, dict) or "box" not in volume:
            raise _BadError("a tile has no bounding volume that is a box")
        (error,) = _numbers([said.get("geometricError")], 1, "geometricError").tolist()
        if error < 0:
            raise _BadError("a geometric error is negative")
        content = said.get("content")
        uri = content.get("uri") if isinstance(content, dict) else None
        if uri is not None and not isinstance(uri, str):
            raise _BadError("the uri of a content is no text")
        file = None if uri is None else self.place.named(uri, name)
        if file is not None and not file.endswith(".json"):
            if file in self._contents:  # little JSON would be much to decode
                raise _BadError(f"two tiles have the content {shown(file)}")
            self._contents.add(file)
        extras = content.get("extras") if isinstance(content, dict) else None
        extras = extras if isinstance(extras, dict) else {}
        return Tile(
            origin=origin,
            box=_box(_numbers(volume["box"], 12, "box")),
            error=error,
            name=file,
            n_splats=_count(extras.get("splats")),
            n_bytes=_count(extras.get("bytes")),
            depth=depth,
        )


class _BadError(Exception):
    """A tile is not what it should be."""


def _no_number(name: str) -> NoReturn:
    """NaN and infinities, which Python reads and JSON does not have."""
    raise ValueError(f"{name} is no number of JSON")


def _listed(value: object) -> list[object]:
    if value is None:
        return []
    if not isinstance(value, list):
        raise _BadError("children are no list")
    return value


def _numbers(value: object, n: int, name: str) -> F64:
    """(n,) finite numbers."""
    are_numbers = isinstance(value, list) and all(
        isinstance(x, int | float) and not isinstance(x, bool) for x in value
    )
    if not are_numbers or len(value) != n:  # type: ignore[arg-type]
        raise _BadError(f"{name} is not {n} number{'s' if n > 1 else ''}")
    try:
        found = np.array([float(x) for x in value])  # type: ignore[attr-defined]
    except OverflowError:
        raise _BadError(f"{name} has a number that is too large") from None
    if not np.isfinite(found).all() or np.abs(found).max() > 1e150:
        raise _BadError(f"{name} has a number that is too large")
    return found


def _count(value: object) -> int | None:
    return value if type(value) is int and 0 <= value < 1 << 53 else None


def _box(numbers: F64) -> Box:
    """The box along the axes that holds one with a middle and three half axes."""
    middle, half = numbers[:3], np.abs(numbers[3:].reshape(3, 3)).sum(axis=0)
    return Box.of(middle - half, middle + half)
