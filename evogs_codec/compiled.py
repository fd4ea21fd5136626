"""Whether the compiled loops of `kernels` are used: they are an extra, and take time to load."""

from __future__ import annotations

from types import ModuleType

__all__ = ["kernels_for"]

MIN_COMPILED = 50_000  # slots below which numpy is as fast as loading compiled code


def kernels_for(n_slots: int) -> ModuleType | None:
    """The compiled loops where they are installed and worth loading; None for numpy."""
    if n_slots < MIN_COMPILED:
        return None
    try:
        from evogs_codec import kernels
    except ImportError:  # numba is an extra
        return None
    return kernels
