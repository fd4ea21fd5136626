"""Recipes of the vectors, one module per family."""

from __future__ import annotations

from types import ModuleType

from conformance.cases import (
    core,
    extension,
    invalid_chunks,
    invalid_directory,
    invalid_header,
    invalid_packets,
    invalid_tables,
    invalid_values,
    limits,
    metamorphic,
    numeric,
    odd,
    order,
    polyglot,
    progressive,
    real,
    shapes,
    zstd,
)

__all__ = ["FAMILIES"]

FAMILIES: tuple[ModuleType, ...] = (
    core,
    odd,
    numeric,
    shapes,
    zstd,
    extension,
    metamorphic,
    progressive,
    real,
    invalid_header,
    invalid_chunks,
    invalid_tables,
    invalid_directory,
    invalid_packets,
    invalid_values,
    order,
    limits,
    polyglot,
)
