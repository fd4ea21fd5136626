"""Scenes of many files: OGC 3D Tiles 1.1 tilesets whose contents are streams."""

from evogs_codec.tileset.check import check_tileset
from evogs_codec.tileset.places import Place
from evogs_codec.tileset.read import Tile, Tileset
from evogs_codec.tileset.take import Taken, take
from evogs_codec.tileset.write import TilesetOptions, write_tileset

__all__ = [
    "Place",
    "Taken",
    "Tile",
    "Tileset",
    "TilesetOptions",
    "check_tileset",
    "take",
    "write_tileset",
]
