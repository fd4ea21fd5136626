"""A stream that is found to be the best of some: how it is made, and what it is to show."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.joined_steps import composed
from evogs_codec.encoding.late_level import can_be_late
from evogs_codec.encoding.layers import Layered, Layering
from evogs_codec.encoding.search import Found
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.format.directory import read_directory
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I64
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.prefixes import Prefixes, StreamPrefixes, TreePrefixes

__all__ = ["FoundStream", "Make"]

# The stream of an encoder, at its price of a bit: looked for from another one on, if there is one.
Make: TypeAlias = Callable[[TargetEncoder, "float | None"], Found[bytes]]


@dataclass(frozen=True, eq=False)
class FoundStream:
    """A stream, made or yet to be made, and the tree that it is of.

    Attributes:
        tree: what is encoded.
        stream: its bytes; None until it is `made`.
        encoder: how it is made, if not with fixed steps.
        make: the stream of an encoder, and its price of a bit; looked for from a price on.
        price: of a bit, at which it is made, or near which.
        psnr: that it aims at, dB; None if it does not.
        n_bytes: at most, likewise.
    """

    tree: EvolutionTree
    stream: bytes | None = None
    encoder: TargetEncoder | None = None
    make: Make | None = None
    price: float | None = None
    psnr: float | None = None
    n_bytes: int | None = None

    @staticmethod
    def of(encoder: TargetEncoder, make: Make, price: float | None = None) -> FoundStream:
        """One that is yet to be made."""
        return FoundStream(encoder.tree, encoder=encoder, make=make, price=price)

    def made(self) -> FoundStream:
        """With its bytes.

        Raises:
            TargetMissedError: no stream meets the target.
        """
        if self.stream is not None:
            return self
        assert self.encoder is not None, "what is not made can be"
        assert self.make is not None, "what is not made can be"
        found, encoder = self.make(self.encoder, self.price), self.encoder
        if encoder.guess and self.psnr is not None:
            encoder = encoder.guessing(encoder.guess.jumping(found, self.psnr))
        return replace(self, stream=found.what, encoder=encoder, price=found.at)

    @property
    def data(self) -> bytes:
        """The bytes of a stream that is made."""
        assert self.stream is not None, "it is made"
        return self.stream

    @property
    def has_target(self) -> bool:
        """Whether it aims at a PSNR or at bytes."""
        return self.psnr is not None or self.n_bytes is not None

    @property
    def is_by_views(self) -> bool:
        """Whether views decided how exact numbers are."""
        return (
            self.encoder is not None and self.encoder.views is not None and self.price is not None
        )

    @property
    def is_layered(self) -> bool:
        """Whether it has several layers of precision."""
        return self._layered is not None

    @property
    def layering(self) -> Layering:
        """Its layers of precision."""
        return Layering(1) if self._layered is None else self._layered.layering

    @property
    def n_coarse(self) -> int:
        """Levels at coarse steps, or all of them where there is one layer."""
        return self.tree.n_levels if self._layered is None else self._layered.n_coarse

    @property
    def orders(self) -> Sequence[I64 | None] | None:
        """In which other order slots are (`EncodedScene`)."""
        own = None if self.encoder is None else self.encoder.prepared.orders
        if self._layered is None:
            return own
        of_layers = self._layered.orders
        return of_layers if own is None else composed(own, of_layers)

    @property
    def is_at_once(self) -> bool:
        """Whether all leaves come in the place of the roots at once."""
        return self.encoder is not None and self.encoder.prepared.is_at_once

    @property
    def can_be_late(self) -> bool:
        """Whether the last level of the tree may come with a second layer."""
        if self.encoder is None or not self.is_layered:
            return False
        return can_be_late(self.encoder.prepared.tiles, self.tree.n_levels)

    def draft(self, *, is_whole: bool = False) -> Prefixes[Any]:
        """What is to be looked at: the coarse levels of the stream, with the same integers.

        `is_whole`: all levels. It must be by views.
        """
        if self.stream is not None:
            return StreamPrefixes(self.stream)
        return self._whole if is_whole else self._coarse

    @property
    def prefixes(self) -> Prefixes[Any]:
        """Of the stream, which is made; of its integers where they are still there."""
        written = None if self.encoder is None else self.encoder.prepared.written
        if written is not None and written[0] is self.stream:
            return TreePrefixes(written[1])
        return StreamPrefixes(self.data)

    def nearer(self) -> FoundStream:
        """At a price at which it is nearer to what it aims at, by a draft.

        Itself if its price is no guess.
        """
        if self.stream is not None or self.encoder is None or self.encoder.guess is None:
            return self
        if self.psnr is not None:
            guess = self.encoder.nearer(self.encoder.guess, self.psnr, self._whole.tree)
        elif self.n_bytes is not None:
            guess = self.encoder.nearer_bytes(self.encoder.guess, self.n_bytes, self._whole.tree)
        else:
            return self
        return replace(self, encoder=self.encoder.guessing(guess), price=guess.price)

    @property
    def _layered(self) -> Layered | None:
        return None if self.encoder is None else self.encoder.prepared.layered

    @cached_property
    def _coarse(self) -> TreePrefixes:
        if not self.is_layered:
            return self._whole
        assert self.encoder is not None, "it is by views"
        assert self.price is not None, "it is by views"
        return TreePrefixes(self.encoder.prepared.coarse(self.price))

    @cached_property
    def _whole(self) -> TreePrefixes:
        assert self.encoder is not None, "it is by views"
        assert self.price is not None, "it is by views"
        return TreePrefixes(self.encoder.prepared.coded(self.price))

    def warn_of_span(self) -> None:
        """Warn where values span so much that they are coarser than views ask."""
        if self.is_by_views:
            assert self.encoder is not None, "it is by views"
            assert self.price is not None, "it is by views"
            self.encoder.prepared.warn_of_span(self.price, read_directory(self.data))

    def at(self, factor: float) -> FoundStream:
        """At so many times its price of a bit, whatever it aims at; yet to be made."""
        assert self.encoder is not None, "it is by views"
        assert self.price is not None, "it is by views"
        price = factor * self.price

        def make(encoder: TargetEncoder, near: float | None) -> Found[bytes]:
            return Found(price, math.nan, encoder.at_price(price))

        return replace(self, stream=None, make=make, price=price)

    def leaving_empty(self, packets: frozenset[PacketId]) -> FoundStream:
        """With these packets of SH bands empty, in the order of this stream, yet to be made."""
        assert self.encoder is not None, "it is by views"
        order = tuple(read_directory(self.data).packet_ids())
        return replace(self, stream=None, encoder=self.encoder.leaving_empty(packets, order))

    def holding(self, runs: Sequence[Run], layering: Layering) -> FoundStream:
        """That of the same tree without states in runs of steps (`Prepared.holding`)."""
        assert self.encoder is not None, "it is by views"
        return replace(self, stream=None, encoder=self.encoder.holding(runs, layering))

    def at_once(self) -> FoundStream:
        """That of the same tree with all leaves in the place of the roots at once."""
        assert self.encoder is not None, "it is by views"
        return replace(self, stream=None, encoder=self.encoder.at_once())
