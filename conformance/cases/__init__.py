"""Recipes of the vectors, one module per family."""

from __future__ import annotations

from types import ModuleType

from conformance.cases import (
    core,
    invalid_chunks,
    invalid_directory,
    invalid_header,
    invalid_packets,
    invalid_tables,
    invalid_values,
    numeric,
    order,
    progressive,
    shapes,
    zstd,
)

__all__ = ["FAMILIES"]

FAMILIES: tuple[ModuleType, ...] = (
    core,
    numeric,
    invalid_header,
    invalid_packets,
    invalid_chunks,
    invalid_tables,
    invalid_values,
    invalid_directory,
    zstd,
    order,
    shapes,
    progressive,
)
