"""The components of a stream: the channels of each, and what its packets require (spec 3.5, 12).

A component has the same number in every stream. What a tile has per component (steps of a cut,
errors of a step) stands in the order of `Components.of_tiles`: in the *column* of the component.

| Number | Component | Its rows of the packet table | Its packets require |
|---|---|---|---|
| 0 | core | of a tile, with level and counts | the step of core before |
| 1..3 | an SH band | of a tile | the step before; core of the same step |
| 4 | picks | of a tile | as a band; the palette up to the label of the step |
| 5 | the palette | of the stream, with level and count of entries | the step before |

A stream has core, and either the bands up to its SH degree, or picks and a palette.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from evogs_codec.model.channels import (
    N_CORE,
    N_GEOMETRY,
    channel_class,
    group_of_class,
    n_channels,
)
from evogs_codec.model.splats import I64

__all__ = [
    "CORE",
    "PALETTE",
    "PICKS",
    "Components",
    "component_channels",
    "component_classes",
    "component_slice",
    "sh_channels",
]

CORE, PICKS, PALETTE = 0, 4, 5  # 1 to 3 are SH bands
N_NUMBERS = 256  # of a component, a byte
BYTES_OF_SLOT = 1 + 4  # liveness and `born_from`, in the state of core


@dataclass(frozen=True)
class Components:
    """Which components a stream has, from two fields of its header."""

    sh_degree: int
    has_palette: bool

    @cached_property
    def of_tiles(self) -> tuple[int, ...]:
        """The components that each tile has, core first."""
        return (CORE, PICKS) if self.has_palette else tuple(range(1 + self.sh_degree))

    @cached_property
    def numbers(self) -> tuple[int, ...]:
        """All components of the stream."""
        return (*self.of_tiles, PALETTE) if self.has_palette else self.of_tiles

    @cached_property
    def columns(self) -> I64:
        """(256,) the column of each number; -1 of the palette, and of what the stream has not."""
        columns = np.full(N_NUMBERS, -1, np.int64)
        columns[list(self.of_tiles)] = np.arange(len(self.of_tiles))
        return columns

    @property
    def lowest_bands(self) -> tuple[int, ...]:
        """The lowest SH band that each component of a tile gives, by column."""
        return (0, 1) if self.has_palette else self.of_tiles

    @property
    def highest_bands(self) -> tuple[int, ...]:
        """The highest SH band that each component of a tile gives, by column."""
        return (0, self.sh_degree) if self.has_palette else self.of_tiles

    @property
    def n_above(self) -> int:
        """Channels above core: of an entry, and of what a pick shows."""
        return n_channels(self.sh_degree) - N_CORE

    @property
    def n_stored(self) -> int:
        """Channels that slots store numbers of; with a palette they store picks for the others."""
        return N_CORE if self.has_palette else n_channels(self.sh_degree)

    @cached_property
    def state_bytes(self) -> I64:
        """(256,) bytes of a slot or an entry in the state of each component (spec 5.7)."""
        sizes = np.zeros(N_NUMBERS, np.int64)
        for component in self.numbers:
            part = self.channels(component)
            sizes[component] = 4 * (part.stop - part.start)
        sizes[CORE] += BYTES_OF_SLOT
        return sizes

    def channels(self, component: int) -> slice:
        """The channels, among the D of a splat, that a component of the stream gives."""
        if component in (PICKS, PALETTE):
            return slice(N_CORE, N_CORE + self.n_above)
        return component_slice(component)


def component_channels(component: int) -> int:
    """Channels of core, 14, or of band b, 3 (2 b + 1) (spec 3.5)."""
    return N_CORE if component == CORE else 3 * (2 * component + 1)


def component_slice(component: int) -> slice:
    """Channels of core or of an SH band among the D of a splat (spec 3.5)."""
    if component == CORE:
        return slice(0, N_CORE)
    return slice(N_GEOMETRY + 3 * component**2, N_GEOMETRY + 3 * (component + 1) ** 2)


@cache
def component_classes(component: int) -> tuple[tuple[int, int], ...]:
    """Quantiser class, and its group, of each channel of core or of an SH band (spec 3.2)."""
    part = component_slice(component)
    classes = [channel_class(channel) for channel in range(part.start, part.stop)]
    return tuple((kind, group_of_class(kind)) for kind in classes)


def sh_channels(component: int) -> slice:
    """Which channels of core or of an SH band are SH triples."""
    return slice(N_GEOMETRY if component == CORE else 0, component_channels(component))
