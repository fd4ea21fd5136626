"""The reference trainer: photographs with cameras become an evolution tree."""
