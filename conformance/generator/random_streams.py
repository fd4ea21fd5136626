"""Random streams that are legal, or nearly always are, and unlike what any encoder writes.

Everything that spec 5 leaves free is drawn: order of packets, steps and bands that are empty, late
or missing, palettes of any size and levels, quantisers and alpha tables at their limits, coding
bytes wider than needed, psi as sibling differences, any partition into frames of any blocks,
ancillary chunks.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from itertools import pairwise
from random import Random

from conformance.decoders import oracle
from conformance.generator.builder import (
    DROP,
    PALETTE,
    PICKS,
    REFINE,
    SPLIT,
    Chunk,
    Packet,
    Stream,
    Tile,
    build,
)
from conformance.generator.random_values import (
    ANCILLARY,
    random_alphas,
    random_coding,
    random_metadata,
    random_names,
    random_numbers,
    random_origin,
    random_quantiser,
    random_style,
)

__all__ = ["random_stream"]

MAX_DELTA, MAX_PRODUCT = 1 << 28, 1 << 30
HAS_PALETTE = 1 << 8  # bit of the flags


@dataclass
class Branch:
    """A tile as far as it has grown: what records may name, and how many packets each chain has."""

    live: list[int]
    n_slots: int
    level: int
    steps: list[Packet]
    bands: list[int]
    born_from: list[int | None] = field(default_factory=list)

    def n_siblings(self, core: Packet) -> int:
        """Records of a step whose slot was born from another of the step."""
        return sum(self.born_from[slot] in core.records for slot in core.records)


@dataclass
class Palette:
    """Packets of the palette, and how many of them have come."""

    packets: list[Packet]
    n_came: int = 0

    def come(self, n: int) -> list[Packet]:
        """Those that have not come, up to the first `n` of all."""
        due, self.n_came = self.packets[self.n_came : n], max(self.n_came, n)
        return due

    def of_level(self, level: int) -> list[Packet]:
        """Those that picks of the level may require."""
        return [packet for packet in self.packets if packet.level <= level]


def random_stream(rng: Random, times: int = 1) -> bytes:
    """A stream of a few hundred bytes, now and then some thousand; adds come `times` as many."""
    degree = rng.choice((0, 0, 0, 1, 1, 2, 3))
    n_levels, n_tiles = rng.choice((1, 2, 2, 3, 3, 5)), rng.choice((1, 1, 1, 2, 3, 0))
    n_levels = 64 if rng.random() < 0.02 else n_levels
    has_palette = degree > 0 and rng.random() < 0.25
    if has_palette:
        n_levels = rng.choice((n_levels, 3, 4, 8))
    rows = [(row, c) for row in range(1 + n_levels) for c in range(5 + degree)]
    quantisers = {at: random_quantiser(rng) for at in rows} if rng.random() < 0.7 else {}
    alphas = random_alphas(rng, n_levels)
    flags = rng.choice((0, 1, 0xFE)) | (HAS_PALETTE if has_palette else 0)
    stream = Stream(
        degree=degree,
        has_palette=has_palette,
        n_levels=n_levels,
        tiles=[Tile(random_origin(rng)) for _ in range(n_tiles)],
        quantisers=quantisers,
        alphas=alphas,
        grid=tuple(rng.choice((-16, 0, 10, 40)) for _ in range(5)),  # type: ignore[arg-type]
        tier=rng.randint(1, 3),
        header={"version_minor": rng.choice((0, 0, 1, 255)), "flags": flags},
    )
    packets = _packets(rng, stream, times)
    stream = replace(stream, packets=packets, metadata=random_metadata(rng))
    stream = replace(stream, chunks=lambda chunks: _with_ancillary(Random(len(packets)), chunks))
    if rng.random() < 0.5:
        stream = replace(stream, digests=dict.fromkeys(random_names(rng, packets)))
    if rng.random() < 0.7:
        stream = replace(stream, tiles=_tight(stream))
    return _built(stream)


def _built(stream: Stream) -> bytes:
    """The bytes; without digests if the stream has none, or names too many states (R-5.7-5)."""
    try:
        data = build(stream)
        if stream.digests:
            oracle.read_tables(data, {})
    except (KeyError, oracle.FaultError):
        data = build(replace(stream, digests=None))
    return data


def _packets(rng: Random, stream: Stream, times: int) -> list[Packet]:
    """Packets of all tiles, bands and the palette in an order that chains allow."""
    n_left, packets = rng.choice((0, 1, 2, 4, 6, 10)) if stream.tiles else 0, list[Packet]()
    branches = [Branch([], 0, 0, [], [0] * (1 + PICKS)) for _ in stream.tiles]
    palette = Palette(_palette(rng, stream) if stream.has_palette and stream.tiles else [])
    while n_left:
        n_left -= 1
        t = rng.randrange(len(branches))
        branch = branches[t]
        bands = (PICKS,) if stream.has_palette else range(1, stream.degree + 1)
        late = [b for b in bands if branch.bands[b] < len(branch.steps)]
        if palette.n_came < len(palette.packets) and rng.random() < 0.3:
            packets += palette.come(palette.n_came + 1)
            n_left += 1
        elif late and rng.random() < 0.6:
            band = rng.choice(late)
            core = branch.steps[branch.bands[band]]
            packets += (
                _picks(rng, core, palette)
                if stream.has_palette
                else [_band(rng, stream, core, band, branch.n_siblings(core))]
            )
            branch.bands[band] += 1
            n_left += 1  # bands come on top
        else:
            packets.append(_core(rng, stream, branch, t, times))
    if stream.has_palette and rng.random() < 0.6:  # few picks came: most steps are late
        for branch in branches:
            for core in branch.steps[branch.bands[PICKS] :]:
                packets += _picks(rng, core, palette)
    return packets + palette.come(len(palette.packets))


def _core(rng: Random, stream: Stream, branch: Branch, tile: int, times: int) -> Packet:
    """A step of core; the branch grows."""
    if branch.level + 1 < stream.n_levels and rng.random() < 0.5:
        branch.level = rng.randint(branch.level + 1, min(branch.level + 3, stream.n_levels - 1))
    n_records = rng.choice((0, 1, len(branch.live), rng.randint(0, len(branch.live))))
    weights = rng.choice(((1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 4, 1), (1, 1, 1)))
    if any(slot is not None for slot in branch.born_from) and rng.random() < 0.4:
        n_records = rng.choice((len(branch.live), rng.randint(0, len(branch.live))))
        weights = (1, 0, 0)  # a layer: there are siblings to refine
    slots = sorted(rng.sample(branch.live, min(n_records, len(branch.live))))
    kinds = rng.choices((REFINE, SPLIT, DROP), weights, k=len(slots))
    n_adds = times * rng.choice((0, 0, 1, 3, 5, 40) if branch.n_slots else (0, 1, 3, 9, 60))
    n_splits = kinds.count(SPLIT)
    alphas = stream.alphas or {}
    packet = Packet(
        tile=tile,
        level=branch.level,
        records=dict(zip(slots, kinds, strict=True)),
        alpha={
            group: [rng.randrange(len(alphas[branch.level, group][1])) for _ in range(n_splits)]
            for group in range(5)
            if n_splits and (branch.level, group) in alphas
        },
        n_adds=n_adds,
    )
    branch.steps.append(packet)
    dropped = {slot for slot, kind in zip(slots, kinds, strict=True) if kind == DROP}
    n_new = n_splits + n_adds
    branch.live = [slot for slot in branch.live if slot not in dropped]
    branch.live += range(branch.n_slots, branch.n_slots + n_new)
    branch.n_slots += n_new
    branch.born_from += [slot for slot, kind in packet.records.items() if kind == SPLIT]
    branch.born_from += [None] * n_adds
    return _filled(rng, stream, packet, packet, branch.n_siblings(packet))


def _band(rng: Random, stream: Stream, core: Packet, band: int, n_siblings: int) -> Packet:
    """A packet of a band, now and then of no bytes."""
    packet = Packet(tile=core.tile, component=band)
    return packet if rng.random() < 0.2 else _filled(rng, stream, packet, core, n_siblings)


def _palette(rng: Random, stream: Stream) -> list[Packet]:
    """Packets of the palette, several or none, some without entries, of levels that never fall."""
    n_packets = rng.choice((0, 1, 2, 2, 3, 5))
    sizes = rng.choices((0, 1, 2, 7, 30, 300), (4, 6, 6, 6, 6, 3), k=n_packets)
    highest = rng.choice((0, stream.n_levels - 1, stream.n_levels - 1))
    levels = sorted(rng.randint(0, rng.randint(0, highest)) for _ in sizes)  # most are low
    packets = [
        Packet(component=PALETTE, level=level, n_adds=n)
        for level, n in zip(levels, sizes, strict=True)
    ]
    return [_filled(rng, stream, packet, packet) for packet in packets]


def _picks(rng: Random, core: Packet, palette: Palette) -> list[Packet]:
    """A packet of picks, after some of the palette that it then requires.

    Most often all of its level come before it. Now and then it is of no bytes; some change the
    picks of slots that are there.
    """
    n_of_level = len(palette.of_level(core.level))
    n_before = n_of_level if rng.random() < 0.6 else rng.randint(0, n_of_level)
    packets = palette.come(n_before)
    required = palette.of_level(core.level)[: palette.n_came]
    n_entries = sum(packet.counts["n_adds"] for packet in required)
    packet = Packet(tile=core.tile, component=PICKS)
    if n_entries == 0 or rng.random() < 0.2:
        return [*packets, packet]
    counts, of_changed = core.counts, rng.random() < 0.5
    n_new = counts["n_splits"] + counts["n_adds"]
    n_changed = counts["n_splits"] + counts["n_refines"] if of_changed else 0
    most = rng.choice((0, 1, n_entries, n_entries))
    picks = [
        rng.choice((0, n_entries, *[rng.randint(0, most)] * 3)) for _ in range(n_changed + n_new)
    ]
    codings = {"picks": random_coding(rng, max(picks))} if picks and rng.random() < 0.5 else {}
    packet = replace(
        packet,
        picks=picks[n_changed:],
        repicks=picks[:n_changed] if of_changed else None,
        codings=codings,
        flags=rng.choice((0, 0, 1, 2, 3)),
        is_explicit=True,
        style=random_style(rng),
    )
    return [*packets, packet]


def _filled(
    rng: Random, stream: Stream, packet: Packet, core: Packet, n_siblings: int = 0
) -> Packet:
    """The packet with integers, coding bytes and frames.

    `n_siblings` of the records are of slots that were born from others of the step.
    """
    counts, band = core.counts, packet.component
    channels = oracle.channels_of(band)
    is_palette = band == PALETTE
    if is_palette:
        channels = range(oracle.N_CORE, oracle.channels_of(stream.degree).stop)
    n_psi = counts["n_splits"] + counts["n_refines"]
    adds, psi = dict[int, list[int]](), dict[int, list[int]]()
    codings = dict[str, int]()
    ycocg = rng.choice((0, 0, 1, 2, 3))
    siblings = set[int]()
    if n_psi and not counts["n_splits"] and not counts["n_drops"]:
        share_of_siblings = rng.choice((0, 0.5, 0.5, 1))
        siblings = {c for c in range(len(channels)) if rng.random() < share_of_siblings}
    # Sums of sibling differences are as many times as large, if all are of one parent or chain.
    n_summed = 1 + n_siblings if siblings else 1
    for channel in range(len(channels)):
        kind = oracle.class_of(channels[channel])
        is_sh = kind >= 4
        # What YCoCg-R gives is up to three times as large.
        share = 24 if is_sh else 8
        psi[channel] = random_numbers(
            rng, n_psi, _most_psi(stream, core, kind) // share // n_summed
        )
        adds[channel] = random_numbers(rng, counts["n_adds"], _most_adds(stream, kind) // share)
        is_flat = all(abs(b - a) < 1 << 23 for a, b in pairwise([0, *adds[channel]]))
        if counts["n_adds"] and is_flat and rng.random() < 0.3:
            codings[f"adds {channel}"] = 0x68  # delta; 8 low bits and two planes
        for name, values in ((f"psi {channel}", psi[channel]), (f"adds {channel}", adds[channel])):
            if values and name not in codings and rng.random() < 0.3:
                codings[name] = random_coding(rng, max(2 * abs(q) for q in values))
    if is_palette and counts["n_adds"] > 16 * (2 + len(channels)):
        codings.setdefault(
            "adds 0", random_coding(rng, max(2 * abs(q) for q in adds[0]))
        )  # R-5.6-7
    filled = replace(
        packet,
        adds=adds if counts["n_adds"] else {},
        psi=psi if n_psi else {},
        siblings=siblings,
        codings=codings,
        flags=ycocg,
        is_explicit=True,
        style=random_style(rng),
    )
    if not any(counts.values()):
        return replace(packet, is_explicit=band > 0 and not stream.has_palette)
    return filled


def _most_adds(stream: Stream, kind: int) -> int:
    """|q| of adds that keeps Delta within its bound."""
    m, e = stream.quantisers.get((0, kind), (1, 0))
    return (MAX_DELTA >> e) // m


def _most_psi(stream: Stream, core: Packet, kind: int) -> int:
    """|q| of psi that keeps Delta and alpha times Delta within bounds."""
    m, e = stream.quantisers.get((1 + core.level, kind), (1, 0))
    group = (0, 1, 2, 3, 4, 4, 4, 4)[kind]
    _, entries = (stream.alphas or {}).get((core.level, group), (0, [1]))
    largest = max(1, *(abs(a) for a in entries))
    return min(MAX_DELTA, MAX_PRODUCT // largest - 4096) // (m << e)


def _with_ancillary(rng: Random, chunks: list[Chunk]) -> list[Chunk]:
    for _ in range(rng.choice((0, 0, 1, 3))):
        body = rng.randbytes(rng.choice((0, 1, 12, 41)))
        chunks.insert(rng.randint(0, len(chunks)), Chunk(rng.choice(ANCILLARY), body))
    return chunks


def _tight(stream: Stream) -> list[Tile]:
    """The tiles with the smallest boxes that hold what the steps give."""
    boxes: list[list[list[int]]] = [[[], [], []] for _ in stream.tiles]

    def note(tile: int, step: int, component: int, state: bytes) -> None:
        if component > 0:
            return
        (n,) = struct.unpack_from("<I", state)
        live = state[4 : 4 + n]
        for axis in range(3):
            x = struct.unpack_from(f"<{n}i", state, 4 + 5 * n + 4 * axis * n)
            boxes[tile][axis] += [v for v, is_live in zip(x, live, strict=True) if is_live]

    try:
        oracle.decode(build(replace(stream, digests=None)), trace=note)
    except oracle.FaultError:
        return list(stream.tiles)
    return [
        replace(
            tile,
            low=(min(x, default=0), min(y, default=0), min(z, default=0)),
            high=(max(x, default=0), max(y, default=0), max(z, default=0)),
        )
        for tile, (x, y, z) in zip(stream.tiles, boxes, strict=True)
    ]
