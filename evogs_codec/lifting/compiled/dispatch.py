"""Whether the compiled loops of lifting are there, and worth loading."""

from __future__ import annotations

import sys
from types import ModuleType

__all__ = ["compiled_for"]

MIN_LOADING = 60_000  # nodes below which numpy takes less time than loading compiled code
MIN_COMPILED = 1_000  # likewise, once it is loaded
LOOPS = "evogs_codec.lifting.compiled.loops"


def compiled_for(n_nodes: int) -> ModuleType | None:
    """`loops`, where numba is installed and there are nodes enough; None for numpy."""
    is_loaded = sys.modules.get(LOOPS) is not None
    if n_nodes < (MIN_COMPILED if is_loaded else MIN_LOADING):
        return None
    try:
        from evogs_codec.lifting.compiled import loops
    except ImportError:  # numba is an extra
        return None
    return loops
