"""Recipes of the vectors, one module per family."""

from __future__ import annotations

from types import ModuleType

from conformance.cases import (
    core,
    core_tables,
    extension,
    invalid_chunks,
    invalid_directory,
    invalid_header,
    invalid_packets,
    invalid_palette,
    invalid_ranges,
    invalid_tables,
    invalid_values,
    late_bands,
    limits,
    metamorphic,
    numeric,
    numeric_ranges,
    odd,
    order,
    order_packets,
    palette,
    palette_changes,
    palette_states,
    polyglot,
    progressive,
    real,
    shapes,
    zstd,
)

__all__ = ["FAMILIES"]

FAMILIES: tuple[ModuleType, ...] = (
    core,
    core_tables,
    odd,
    numeric,
    numeric_ranges,
    shapes,
    zstd,
    extension,
    metamorphic,
    progressive,
    late_bands,
    real,
    invalid_header,
    invalid_chunks,
    invalid_tables,
    invalid_directory,
    invalid_packets,
    invalid_values,
    invalid_ranges,
    order,
    order_packets,
    limits,
    polyglot,
    palette,
    palette_states,
    palette_changes,
    invalid_palette,
)
