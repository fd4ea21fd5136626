"""The pseudo-code of the spec as a decoder, behind the tables of the oracle."""

import re
import struct
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace

import zstandard

from conformance.decoders import oracle

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "spec" / "evogs.md").read_text(encoding="utf-8")


@cache
def pseudo_code() -> ModuleType:
    """The `python` blocks of the text, as one module (4.3)."""
    blocks = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 9
    module = ModuleType("spec_pseudo_code")
    module.__dict__["FaultError"] = _FaultError
    module.__dict__["group_of"] = oracle.group_of
    for block in blocks:
        exec(block, module.__dict__)
    return module


class _FaultError(oracle.FaultError):
    """`FaultError` of the text, which says no more than the code."""

    def __init__(self, code: str, offset: int = -1) -> None:
        super().__init__(code, "pseudo-code", offset)


def decode_with_pseudo_code(data: bytes) -> bytes:
    """The dump, from the oracle's tables and the functions of section 7."""
    spec, scene = pseudo_code(), oracle.read_tables(data, {})
    cores: dict[tuple[int, int], SimpleNamespace] = {}
    sizes: list[tuple[int, int]] = []  # level and entries of each packet of the palette
    for p in scene.packets:
        tile = scene.tiles[p.tile]
        if p.component == 0:
            cores[p.tile, p.step] = core = SimpleNamespace(packet=p, n_adds=p.n_adds)
        body = data[p.start : p.start + p.size]
        if p.component == oracle.PALETTE:
            spec.palette_step(scene.palette, stored_entries(spec, scene, p, body))
            sizes.append((p.level, p.n_adds))
            continue
        core = cores[p.tile, p.step]
        if p.component == oracle.PICKS:
            of_changed = bool(body) and body[0] >> 2 & 1 == 1
            n_picks = core.packet.n_splits + core.packet.n_adds
            n_picks += core.packet.n_psi if of_changed else 0
            picks = unpacked(spec, [n_picks], 1, body)[0] if body else None
            n_entries = sum(n for level, n in sizes if level <= core.packet.level)
            spec.picks_step(tile, core, picks, of_changed, scene.palette, n_entries)
            continue
        lists = stored_lists(spec, tile, p, core, body)
        channels = oracle.channels_of(p.component)
        if p.component == 0:
            read_coded_tree(spec, scene, core, lists[:7])
            lists = lists[7:]
        qs = iter(lists)
        psi, adds = (
            [[spec.delta_of(q, *row[oracle.class_of(c)]) for q in next(qs)] for c in channels]
            for row in (scene.quantisers[1 + core.packet.level], scene.quantisers[0])
        )
        if p.component == 0:
            spec.core_step(tile, core.slots, core.kinds, psi, core.alpha, adds)
        else:
            spec.band_step(tile, p.component, core, psi, adds)
    return dump(spec, scene)


def stored_lists(spec, tile, p, step, body: bytes) -> list[list[int]]:
    """The lists of 5.9 after 7.1: side lists as stored, psi and adds as q."""
    core, n_channels = step.packet, len(oracle.channels_of(p.component))
    n_kinds = core.n_records if [core.n_splits, core.n_refines, core.n_drops].count(0) < 2 else 0
    sides = [core.n_records, n_kinds, *[core.n_splits] * 5] if p.component == 0 else []
    lengths = [*sides, *[core.n_psi] * n_channels, *[core.n_adds] * n_channels]
    first_psi, first_add = len(sides), len(sides) + n_channels
    lists = unpacked(spec, lengths, len(sides), body, first_delta=first_add)
    first_sh = 11 if p.component == 0 else 0
    for bit, begin in ((1, first_psi), (2, first_add)):
        if body and body[0] & bit:
            undo_ycocg(spec, lists, range(begin + first_sh, begin + n_channels, 3))
    for k in range(first_psi, first_add):
        if body and body[2 + k] & 64:
            slots = spec.slots_of(lists[0]) if p.component == 0 else step.slots
            lists[k] = spec.add_siblings(lists[k], slots, tile.born_from)
    return lists


def stored_entries(spec, scene, p, body: bytes) -> list[list[int]]:
    """The entries of a packet of the palette, Delta by channel (7.4)."""
    channels = scene.header.above_core
    lists = unpacked(spec, [p.n_adds] * len(channels), 0, body)
    if body and body[0] & 2:
        undo_ycocg(spec, lists, range(0, len(lists), 3))
    steps = [scene.quantisers[0][oracle.class_of(channel)] for channel in channels]
    return [[spec.delta_of(q, *step) for q in qs] for step, qs in zip(steps, lists, strict=True)]


def unpacked(
    spec, lengths: list[int], n_sides: int, body: bytes, first_delta: int = 0
) -> list[list[int]]:
    """The lists of a packet; those after `n_sides` as q, before YCoCg-R is undone.

    Lists from number `first_delta` on with `delta` are of differences from the one before.
    """
    codings = body[2 : 2 + len(lengths)] if body else bytes(len(lengths))
    content = contents(body, 2 + len(lengths)) if body else b""
    lists = []
    for number, (c, n) in enumerate(zip(codings, lengths, strict=True)):
        low, high = c & 15, (c >> 4) & 3
        sizes = [-(-n * low // 8) if low in (1, 2, 4) else n] if low else []
        planes = []
        for size in [*sizes, *[n] * high]:
            planes.append(content[:size])
            content = content[size:]
        values = spec.unpack(low, high, planes, n) if c else [0] * n
        if number >= n_sides:
            values = [spec.unzigzag(z) for z in values]
        lists.append(spec.undelta(values) if c & 64 and number >= first_delta else values)
    assert content == b""
    return lists


def undo_ycocg(spec, lists: list[list[int]], firsts: range) -> None:
    """Y, Co and Cg of each SH triple become R, G and B, in place; `firsts` are the lists of Y."""
    for k in firsts:
        triples = [spec.inverse_ycocg(*t) for t in zip(*lists[k : k + 3], strict=True)]
        lists[k : k + 3] = [[t[i] for t in triples] for i in range(3)]


def contents(body: bytes, entries_at: int) -> bytes:
    """All planes of a packet."""
    at, out = entries_at + 5 * body[1], b""
    for _, size in struct.iter_unpack("<BI", body[entries_at:at]):
        out += zstandard.ZstdDecompressor().decompress(body[at : at + size])
        at += size
    return out


def read_coded_tree(spec, scene, core, lists: list[list[int]]) -> None:
    """Slots, kinds and (a, K) of a core packet (7.2)."""
    p = core.packet
    core.slots = spec.slots_of(lists[0])
    only = 1 if p.n_splits else 2 if p.n_drops else 0
    core.kinds = lists[1] or [only] * p.n_records
    core.alpha = []
    for group, indices in enumerate(lists[2:]):
        k, table = scene.alphas.get((p.level, group), (0, [1]))
        core.alpha.append([(table[index], k) for index in indices])


def dump(spec, scene) -> bytes:
    """7.7, with the SH as shown (7.5)."""
    for tile in scene.tiles:
        tile.channels = spec.dumped_channels(tile)
    out: bytes = scene.dump()
    return out
