"""Scenes of many files: OGC 3D Tiles 1.1 tilesets whose contents are streams."""

from evogs_codec.tileset.write import TilesetOptions, write_tileset

__all__ = ["TilesetOptions", "write_tileset"]
