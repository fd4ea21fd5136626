"""Damage that the last checks of a packet find, when most of the packet has been decoded.

What such a packet wrote must be gone (R-6.4-5), and shows best where it came out of order, or where
packets of other tiles are missing. Every size and checksum is right.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from random import Random

from conformance.decoders.outcomes import Run, by_oracle
from conformance.generator.builder import PALETTE, PICKS, places
from conformance.generator.tampering import Parts, edited_content

__all__ = ["late_fault", "runs_beside_faults"]

TRIES = 8  # to find damage that is a fault of a packet, not of the tables, and leaves a state
TILE_SIZE, BOX_AT, AXES = 48, 24, 3
STEP_SIZE, FIRST_LATE = 3, 2  # of a quantiser; the first class that does not come at the beginning
LARGEST = (65535, 24)  # M and E
PALETTE_BIT = 1  # of byte 19


def late_fault(rng: Random, data: bytes) -> bytes:
    """The stream with one fault of this kind, if one is found."""
    changed = data
    for _ in range(TRIES):
        parts = Parts.of(data)
        has_palette = parts.header[19] & PALETTE_BIT
        kinds = OF_PALETTE if has_palette and rng.random() < 0.6 else DAMAGE
        rng.choice(kinds)(rng, parts)
        changed = parts.join()
        beside = by_oracle(changed, Run("progressive", dump_on_fault=True))
        if beside.exit == 1 and beside.dump is not None:
            break
    return changed


def runs_beside_faults(rng: Random, data: bytes) -> list[Run]:
    """All bytes; all packets in any order; some are missing."""
    everything = Run("progressive", dump_on_fault=True)
    spans = [(begin, end) for begin, end in places(data).packets if end > begin]
    if not spans:
        return [everything]
    some = rng.sample(spans, rng.randint(1, len(spans)))
    orders = rng.sample(spans, len(spans)), some, sorted(some)
    head = (0, min(begin for begin, _ in spans))
    arrivals = [(head, *((begin, end - begin) for begin, end in order)) for order in orders]
    return [everything, *(Run("progressive", arrival=a, dump_on_fault=True) for a in arrivals)]


def _box(rng: Random, parts: Parts) -> None:
    """A side of the box of a tile comes nearer; most random boxes are tight."""
    body = _body(parts, b"TILE")
    if not body:
        return
    row = TILE_SIZE * rng.randrange(len(body) // TILE_SIZE) + BOX_AT
    low = row + 4 * rng.randrange(AXES)
    high = low + 4 * AXES
    (a,), (b,) = (struct.unpack_from("<i", body, at) for at in (low, high))
    if a < b:
        near = rng.choice((b - 1, b - 1, rng.randint(a, b - 1)))
        side, value = rng.choice(((high, near), (low, a + b - near)))
        struct.pack_into("<i", body, side, value)


def _quantiser(rng: Random, parts: Parts) -> None:
    """A quantiser of a class that is not among the first takes large steps."""
    body = _body(parts, b"QUAN")
    n_classes = 5 + parts.header[11]
    n_rows = len(body) // (STEP_SIZE * n_classes)
    if n_rows:
        late = rng.choice((n_classes - 1, rng.randrange(FIRST_LATE, n_classes)))
        place = rng.randrange(n_rows) * n_classes + late
        step = rng.choice((LARGEST, (1, 24), (65535, rng.randrange(25))))
        struct.pack_into("<HB", body, STEP_SIZE * place, *step)


def _alpha(rng: Random, parts: Parts) -> None:
    """An entry of a table of alpha is as large as may be, or the last one is gone."""
    body = _body(parts, b"ALFA")
    tables, at = list[tuple[int, int]](), 0
    while at + 4 <= len(body):
        tables.append((at, body[at + 3]))
        at += 6 + 2 * body[at + 3]
    if not tables:
        return
    at, last = rng.choice(tables)
    if last and rng.random() < 0.5:
        body[at + 3] -= 1
        del body[at + 4 + 2 * last : at + 6 + 2 * last]
    else:
        body[at + 2] = 0
        struct.pack_into("<h", body, at + 4 + 2 * rng.randint(0, last), rng.choice((-1, 1)) * 32767)


def _last_numbers(rng: Random, parts: Parts) -> None:
    """The last bytes of the last frame of a packet: of the last channel, or of picks."""
    _end_of_packet(rng, parts, [k for k, packet in enumerate(parts.packets) if len(packet) > 2])


def _last_picks(rng: Random, parts: Parts) -> None:
    """The same, of picks where there are some."""
    _end_of_packet(rng, parts, _of_component(parts, PICKS))


def _last_entries(rng: Random, parts: Parts) -> None:
    """The same, of entries where there are some, whose last class takes larger steps."""
    body = _body(parts, b"QUAN")
    at = STEP_SIZE * (5 + parts.header[11] - 1)  # in the row of adds, which is the first
    if at + STEP_SIZE <= len(body):
        struct.pack_into("<HB", body, at, rng.choice((1, 3, 255)), rng.randint(8, 24))
    packets = _of_component(parts, PALETTE)
    _end_of_packet(rng, parts, packets[-2:])


def _of_component(parts: Parts, component: int) -> list[int]:
    """Packets of a component, or all where there are none."""
    full = [k for k, packet in enumerate(parts.packets) if len(packet) > 2]
    return [k for k in full if parts.component(k) == component] or full


def _end_of_packet(rng: Random, parts: Parts, packets: Sequence[int]) -> None:
    if not packets:
        return

    def edit(content: bytearray) -> None:
        n = min(len(content), rng.choice((1, 1, 2, 5)))
        for at in range(len(content) - n, len(content)):
            content[at] = rng.choice((255, 128, content[at] | 128, rng.randrange(256)))

    edited_content(rng, parts, rng.choice(packets), edit)


def _body(parts: Parts, kind: bytes) -> bytearray:
    return next((body for name, body in parts.chunks if name == kind), bytearray())


DAMAGE: Sequence[Callable[[Random, Parts], None]] = (
    *(_box, _box, _box, _quantiser, _quantiser, _quantiser, _alpha, _alpha),
    *(_last_numbers, _last_numbers),
)
OF_PALETTE = (_last_picks, _last_entries)
