"""Coarse levels of lifted scenes, trained on views of the scene."""
