"""Everything of lifting that is compiled: what loads it loads numba."""

from __future__ import annotations

from evogs_codec.lifting.compiled import matching, neighbours, raising, shapes

__all__ = ["matching", "neighbours", "raising", "shapes"]
