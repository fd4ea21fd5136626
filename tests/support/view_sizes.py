"""How large default views are in this process; processes that it starts draw them in full."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from evogs_codec.render import viewpoints

__all__ = ["FULL", "SMALL", "views_of"]

FULL = viewpoints.SIZE
SMALL = 100  # pixels, width and height: what is tested is what is done with them


@contextmanager
def views_of(size: int) -> Iterator[None]:
    """Default views have this width and height meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(viewpoints, "SIZE", size)
        yield
