"""Splats, evolution trees, their coded form, and the integer arithmetic of spec 7."""
