"""Lists in parts by the class of a context, each part with planes of its own in the frames.

What Zstandard can have of contexts: its Huffman codes know nothing of neighbours, but a plane may
hold only integers that are alike. A list is put together again from its parts in the order of its
records.

Letters: n integers of a list, K parts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar, cast

import numba
import numpy as np

from evogs_codec import frames
from evogs_codec.kernel_values import unpack
from evogs_codec.planes import Coding, choose_coding, split_planes
from evogs_codec.splats import I32, I64, U8
from tools.bench.entropy.contexts import CLASS_OF, N_CLASSES, choose_model, classes_of

__all__ = ["Parted", "decode", "encode", "put_together"]

Function = TypeVar("Function", bound=Callable[..., object])
OVERHEAD = 8 * 40  # bits that a part costs: its coding byte, and the tables of its planes


@dataclass(frozen=True, eq=False)
class PartedList:
    """How a list is stored.

    Attributes:
        context: of `contexts.CONTEXTS`; "none" if there is one part.
        table_of: (N_CLASSES,) the part of each class.
        codings, sizes: of each part.
    """

    context: str
    table_of: U8
    codings: tuple[Coding, ...]
    sizes: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Parted:
    """The lists of a packet.

    Attributes:
        lists: how each is stored.
        frames: of all planes, and the bytes that come out.
    """

    lists: tuple[PartedList, ...]
    frames: tuple[tuple[bytes, int], ...]

    @property
    def n_bytes(self) -> int:
        """Bytes of frames and frame entries, and of what the coding bytes of a list do not say."""
        more = sum(2 * len(one.codings) for one in self.lists if len(one.codings) > 1)
        return more + sum(5 + len(frame) for frame, _ in self.frames)


def encode(lists: Sequence[I32], known: Sequence[Mapping[str, I32]], effort: int = 19) -> Parted:
    """The lists of a packet, in parts where that is worth it."""
    stored, planes = [], list[bytes]()
    for z, magnitudes in zip(lists, known, strict=True):
        context, table_of, parts = _cheapest(z, magnitudes)
        codings = tuple(choose_coding(part)[0] for part in parts)
        for part, coding in zip(parts, codings, strict=True):
            planes += split_planes(part, coding)
        stored.append(PartedList(context, table_of, codings, tuple(map(len, parts))))
    # One frame, or one for each plane, as in packets of the format.
    options = [[(frames.compress(plane, effort), len(plane)) for plane in planes]]
    whole = b"".join(planes)
    if len(whole) <= frames.MAX_CONTENT:
        options.append([(frames.compress(whole, effort), len(whole))])
    best = min(options, key=lambda option: sum(5 + len(frame) for frame, _ in option))
    return Parted(tuple(stored), tuple(best))


def decode(parted: Parted, known: Callable[[int, str, list[I32]], I32]) -> list[I32]:
    """The lists again; `known` is asked for the magnitudes that a context needs."""
    contents = [frames.decompress(memoryview(frame), size, 0) for frame, size in parted.frames]
    planes = np.frombuffer(b"".join(contents), np.uint8)
    out: list[I32] = []
    at = 0
    for k, one in enumerate(parted.lists):
        codes = np.array([coding.byte() for coding in one.codings], np.int64)
        sizes = np.array(one.sizes, np.int64)
        places = [
            sum(coding.plane_sizes(n)) for coding, n in zip(one.codings, one.sizes, strict=True)
        ]
        starts = at + np.cumsum([0, *places[:-1]])
        z = np.empty(sizes.sum(), np.int32)
        put_together(codes, planes, starts, sizes, z)
        if len(sizes) > 1:
            z = _in_order(z, sizes, CLASS_OF, one.table_of, known(k, one.context, out))
        out.append(z)
        at += sum(places)
    return out


def _cheapest(z: I32, known: Mapping[str, I32]) -> tuple[str, U8, list[I32]]:
    """(context, part of each class, parts) with the fewest bits of Huffman codes."""
    best = "none", np.zeros(N_CLASSES, np.uint8), [z]
    least = choose_coding(z)[1]
    for context, magnitudes in known.items():
        model = choose_model(z, known, (context,))
        if model.context != context or len(model.counts) == 1:
            continue
        tables = model.table_of[classes_of(magnitudes)]
        parts = [z[tables == k] for k in range(len(model.counts))]
        cost = sum(choose_coding(part)[1] + OVERHEAD for part in parts)
        if cost < least:
            best, least = (context, model.table_of, parts), cost
    return best


def _jit(function: Function) -> Function:
    return cast(Function, numba.njit(nogil=True, cache=True, boundscheck=False)(function))


@_jit
def put_together(codes: I64, planes: U8, starts: I64, sizes: I64, out: I32) -> None:
    """Lists or parts, one after the other, from their planes."""
    at = 0
    for k in range(len(codes)):
        n = sizes[k]
        unpack(codes[k], planes, starts[k], n, 0, n, out[at : at + n])
        at += n


@_jit
def _in_order(parts: I32, sizes: I64, class_of: U8, table_of: U8, magnitudes: I32) -> I32:
    """(n,) integers in the order of records."""
    most = np.int32(len(class_of) - 1)
    place = np.empty(len(sizes), np.int64)
    at = 0
    for k in range(len(sizes)):
        place[k] = at
        at += sizes[k]
    out = np.empty(len(parts), np.int32)
    for i in range(len(parts)):
        k = table_of[class_of[min(magnitudes[i], most)]]
        out[i] = parts[place[k]]
        place[k] += 1
    return out
