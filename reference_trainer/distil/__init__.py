"""Coarse levels of lifted scenes, trained on views of the scene: `distil`.

It renders, which needs numba, an extra: `distil` is imported when it is first used, so that
`evogs encode --refine` can say what is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from reference_trainer.distil.coarse_levels import Change, Distilled, distil

__all__ = ["Change", "Distilled", "distil"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from reference_trainer.distil import coarse_levels

    found: object = getattr(coarse_levels, name)
    return found
