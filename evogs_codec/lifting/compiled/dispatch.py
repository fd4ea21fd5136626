"""Whether the compiled loops of lifting are there, and worth loading."""

from __future__ import annotations

from types import ModuleType

__all__ = ["compiled_for"]

MIN_COMPILED = 20_000  # nodes below which numpy takes less time than loading compiled code


def compiled_for(n_nodes: int) -> ModuleType | None:
    """`loops`, where numba is installed and there are nodes enough; None for numpy."""
    if n_nodes < MIN_COMPILED:
        return None
    try:
        from evogs_codec.lifting.compiled import loops
    except ImportError:  # numba is an extra
        return None
    return loops
