"""Edits of scenes: crops, floaters, transforms, several scenes as one."""

from evogs_codec.scene_edits.edit import Edit as Edit
from evogs_codec.scene_edits.edit import Edited as Edited
from evogs_codec.scene_edits.edit import edit_scenes as edit_scenes
from evogs_codec.scene_edits.regions import Box as Box
from evogs_codec.scene_edits.regions import Sphere as Sphere

__all__ = ["Box", "Edit", "Edited", "Sphere", "edit_scenes"]
