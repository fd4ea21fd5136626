"""Registered names of spec 8.4. Made by `tools/spec_tables.py` from `spec/registry.csv`."""

from __future__ import annotations

# The number of a name is its place.
COORDINATE_SYSTEMS = ("unspecified", "RDF", "RUB", "RUF", "FLU", "RFU")
UP_AXES = ("unspecified", "+x", "-x", "+y", "-y", "+z", "-z")
UNITS = ("unspecified", "metre", "centimetre", "millimetre", "foot", "inch")
COLOUR_SPACES = ("unspecified", "srgb", "linear")

# Metadata keys that a person gives.
TEXT_OPTIONS = (
    "title",
    "author",
    "licence",
    "source",
    "captured",
    "device",
    "provenance",
    "comment",
)


def name(names: tuple[str, ...], number: int) -> str:
    """The name of a number; an unknown one reads as 0 (spec 5.1)."""
    return names[number] if number < len(names) else names[0]
