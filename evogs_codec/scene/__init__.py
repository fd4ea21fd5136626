"""A whole encode in one call: the options, the choice among streams, and the functions."""

from evogs_codec.scene.encode import (
    EncodedScene,
    encode_scene,
    encode_scene_with_order,
    encode_tree,
)
from evogs_codec.scene.request import N_LEVELS

__all__ = ["N_LEVELS", "EncodedScene", "encode_scene", "encode_scene_with_order", "encode_tree"]
