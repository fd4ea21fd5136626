"""Photographs with cameras: reading folders of them, and pyramids of smaller pictures."""

from reference_trainer.data.loading import load_views
from reference_trainer.data.pyramid import at_scale
from reference_trainer.data.view import BACKGROUNDS, Dataset, View

__all__ = ["BACKGROUNDS", "Dataset", "View", "at_scale", "load_views"]
