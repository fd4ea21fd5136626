"""Recipes of the vectors, one module per family."""

from __future__ import annotations

from types import ModuleType

from conformance.cases import core

__all__ = ["FAMILIES"]

FAMILIES: tuple[ModuleType, ...] = (core,)
