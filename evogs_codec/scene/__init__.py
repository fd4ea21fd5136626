"""A whole encode in one call: the options, the choice among streams, and the functions."""

from evogs_codec.lifting.lift import N_LEVELS
from evogs_codec.scene.encode import (
    EncodedScene,
    encode_scene,
    encode_scene_with_order,
    encode_tree,
    encode_tree_with_order,
)

__all__ = [
    "N_LEVELS",
    "EncodedScene",
    "encode_scene",
    "encode_scene_with_order",
    "encode_tree",
    "encode_tree_with_order",
]
