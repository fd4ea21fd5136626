"""The bytes of packets (spec 5.9)."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from conformance.generator.builder.stream import PALETTE, PICKS, Packet

__all__ = [
    "ADDS_YCOCG",
    "DELTA",
    "OF_CHANGED",
    "PSI_YCOCG",
    "coding_for",
    "packet_body",
    "planes_of",
]

N_CORE, N_GROUPS = 14, 5
PSI_YCOCG, ADDS_YCOCG = 1, 2
OF_CHANGED = 4  # of picks
DELTA = 64  # bit of a coding byte


def packet_body(packet: Packet, counts: Mapping[str, int], n_above: int = 0) -> bytes:
    """The bytes of a packet of a step with these counts.

    Args:
        packet: the packet.
        counts: those of its own row for core and the palette, else of the core of its step.
        n_above: channels above core, those of an entry of the palette.
    """
    integers = (packet.stored, packet.psi, packet.adds, packet.picks)
    flags = packet.flags | (OF_CHANGED if packet.repicks is not None else 0)
    if not packet.is_explicit and not any(integers) and packet.repicks is None:
        is_zero = packet.component not in (0, PALETTE) and not packet.coding_bytes
        if is_zero or not any(counts.values()):
            return b""
    lists = _lists(packet, counts, n_above)
    codings, planes = list[int](), list[bytes]()
    of_siblings = {f"psi {channel}" for channel in packet.siblings}
    for name, values in lists.items():
        coding = packet.codings.get(name, coding_for(values))
        if name in of_siblings and coding:
            coding |= DELTA
        planes += planes_of(values, coding)
        codings.append(packet.coding_bytes.get(name, coding))
    partition = packet.frames if packet.frames is not None else [len(planes)] if planes else []
    frames, entries, rest = list[bytes](), list[tuple[int, int]](), list(planes)
    for n_planes in partition:
        frames.append(packet.style(b"".join(rest[:n_planes])))
        entries.append((n_planes, len(frames[-1])))
        del rest[:n_planes]
    entries = packet.entries(entries)
    table = b"".join(struct.pack("<BI", *entry) for entry in entries)
    return bytes([flags, len(entries), *codings]) + table + b"".join(frames)


def _lists(packet: Packet, counts: Mapping[str, int], n_above: int) -> dict[str, list[int]]:
    """The stored integers of each list, in the order of the coding bytes."""
    slots, lists = sorted(packet.records), dict[str, list[int]]()
    n_psi = counts["n_splits"] + counts["n_refines"]
    n_channels = N_CORE if packet.component == 0 else 3 * (2 * packet.component + 1)
    sides = [("psi", packet.psi, n_psi), ("adds", packet.adds, counts["n_adds"])]
    if packet.component == PICKS:
        n_new = counts["n_splits"] + counts["n_adds"]
        lists["picks"] = list(packet.picks) if packet.picks else [0] * n_new
        if packet.repicks is not None:
            lists["picks"] = [*(packet.repicks or [0] * n_psi), *lists["picks"]]
        sides = []
    elif packet.component == PALETTE:
        n_channels, sides = n_above, sides[1:]
    if packet.component == 0:
        kinds = [packet.records[slot] for slot in slots]
        lists["gaps"] = [b - a - 1 for a, b in zip([-1, *slots], slots, strict=False)]
        lists["kinds"] = kinds if len(set(kinds)) > 1 else []
        for group in range(N_GROUPS):
            lists[f"alpha {group}"] = list(packet.alpha.get(group, ()))
    for kind, values, n in sides:
        for channel in range(n_channels):
            q = values.get(channel, ())
            name = f"{kind} {channel}"
            qs = [q] * n if isinstance(q, int) else list(q)
            if kind == "adds" and packet.codings.get(name, 0) & DELTA:
                qs = [b - a for a, b in zip([0, *qs], qs, strict=False)]
            lists[name] = [zigzag(q) for q in qs]
    for name, stored in packet.stored.items():
        assert name in lists
        lists[name] = list(stored)
    return lists


def zigzag(q: int) -> int:
    """0, -1, 1, -2 ... become 0, 1, 2, 3 ..."""
    return 2 * q if q >= 0 else -2 * q - 1


def coding_for(values: Sequence[int]) -> int:
    """A coding byte that holds these integers."""
    bits = max(values, default=0).bit_length()
    if bits == 0:
        return 0
    low = next(width for width in (1, 2, 4, 8) if min(bits, 8) <= width)
    return low | max(0, (bits - 1) // 8) << 4


def planes_of(values: Sequence[int], coding: int) -> list[bytes]:
    """The planes of a list; none if the list is empty."""
    low, high = coding & 15, coding >> 4 & 3
    if not values:
        return []
    assert max(values) < 1 << (low + 8 * high), "the coding holds no such integers"
    planes = []
    if low in (1, 2, 4):
        packed = sum((v & ((1 << low) - 1)) << (low * i) for i, v in enumerate(values))
        planes.append(packed.to_bytes((len(values) * low + 7) // 8, "little"))
    elif low:
        planes.append(bytes(v & ((1 << low) - 1) for v in values))
    return planes + [bytes(v >> (low + 8 * k) & 255 for v in values) for k in range(high)]
