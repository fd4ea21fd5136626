"""Entropy coders on the integers of streams: what is stored now, what could be, and how fast.

Sizes are those of whole streams: the directory and the packet headers are added to what another
coder spends on the lists.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from evogs_codec import decode_leaves, read_directory
from evogs_codec.packets import read_planes
from evogs_codec.splats import I32
from evogs_codec.stats import bytes_by_group
from tools.bench.entropy import parts, rans
from tools.bench.entropy.contexts import CONTEXTS
from tools.bench.entropy.costs import Sample, samples
from tools.bench.entropy.javascript import run_javascript
from tools.bench.entropy.lists import ListPacket
from tools.bench.entropy.parts import put_together
from tools.bench.measure import take_turns

__all__ = ["TABLES", "samples"]

Rows = list[dict[str, object]]
TURNS = 9
FORMAT = "the format: planes, Zstandard 19"


def sizes(of: Sequence[Sample]) -> Rows:
    """Sizes of whole streams to that of the format; and its bytes a splat."""
    columns = {}
    for sample in of:
        n_bytes = {
            "planes, Zstandard 3": len(sample.fast),
            "planes by context, Zstandard 19": sample.head
            + sum(packet.n_bytes for packet in sample.parted),
            **{name: sample.head + sum(map(len, found)) for name, found in sample.blocks.items()},
            "ideal: order 0 of the planes": sample.total("planes"),
            "ideal: order 0 of the integers": sample.total("integers"),
            "ideal: a context, static tables": sample.total("static"),
            "ideal: a context, adaptive": sample.total("adaptive"),
            "ideal: two contexts, adaptive": sample.total("adaptive, two"),
        }
        base = len(sample.data)
        ratios = {coder: f"{size / base:.3f}" for coder, size in n_bytes.items()}
        columns[sample.name] = {FORMAT: f"{base / sample.n:.2f} B", **ratios}
    return _table("coder", columns)


def contexts(of: Sequence[Sample]) -> Rows:
    """Sizes to that of the format where no other context is used."""
    columns = {
        sample.name: {
            f"{context}, {tables}": f"{sample.total(f'{tables} {context}') / len(sample.data):.3f}"
            for tables in ("static", "adaptive")
            for context in CONTEXTS
        }
        for sample in of
    }
    return _table("context, tables", columns)


def groups(of: Sequence[Sample]) -> Rows:
    """Bytes a splat of what the lists hold: stored, and by the best context with static tables."""
    columns = {}
    for sample in of:
        view, n = memoryview(sample.data), sample.n
        stored = bytes_by_group(read_directory(view), view)
        columns[sample.name] = {
            name: f"{stored[name].n_bytes / n:.3f} > {costs['static'] / n:.3f}"
            for name, costs in sample.costs.items()
        }
    return _table("part", columns)


def decoding(of: Sequence[Sample]) -> Rows:
    """Time from bytes to integers, in one thread; and the whole decode of the format, in all."""
    columns = {}
    for sample in of:
        coders: dict[str, Callable[[], list[list[I32]]]] = {
            FORMAT: partial(_of_frames, sample),
            "planes by context, Zstandard 19": partial(_of_parts, sample),
            **{name: partial(_of_blocks, sample, b) for name, b in sample.blocks.items()},
        }
        for run in coders.values():
            _check(sample, run())
        whole = {"the format, to floats": partial(decode_leaves, sample.data)}
        columns[sample.name] = _speeds(sample, take_turns({**coders, **whole}, TURNS))
    return _table("coder", columns)


def javascript(of: Sequence[Sample]) -> Rows:
    """The same in JavaScript; says so where node is not there, and measures what it finds."""
    node = shutil.which("node")
    if node is None:
        return [{"coder": "not measured: no node"}]
    columns = {}
    for sample in of:
        columns[sample.name] = _speeds(sample, run_javascript(node, sample, TURNS))
    rows = _table("coder", columns)
    if not any("Zstandard" in str(row["coder"]) for row in rows):
        rows.append({**dict.fromkeys(rows[0], ""), "coder": "Zstandard: no library for node"})
    return rows


TABLES: dict[str, tuple[str, Callable[[Sequence[Sample]], Rows]]] = {
    "entropy": ("Entropy coders: size, to that of the format", sizes),
    "entropy-contexts": ("Entropy coders: one context for all lists, to the format", contexts),
    "entropy-groups": ("Entropy coders: bytes a splat, stored > best context", groups),
    "entropy-decoding": ("Entropy coders: from bytes to integers, ns an integer", decoding),
    "entropy-javascript": ("Entropy coders: the same in JavaScript, ns an integer", javascript),
}


def _table(corner: str, columns: Mapping[str, Mapping[str, str]]) -> Rows:
    """A row for everything that a column has."""
    names = dict.fromkeys(name for column in columns.values() for name in column)
    return [
        {corner: name, **{stream: column.get(name, "") for stream, column in columns.items()}}
        for name in names
    ]


def _speeds(sample: Sample, seconds: Mapping[str, float]) -> dict[str, str]:
    n = sum(len(one.values) for packet in sample.packets for one in packet.lists)
    return {coder: f"{1e9 * value / n:.2f}" for coder, value in seconds.items()}


def _of_frames(sample: Sample) -> list[list[I32]]:
    """The lists of each packet, from its frames, by the compiled code of the codec."""
    found = []
    for packet in sample.packets:
        head, planes = packet.header, read_planes(packet.body, packet.header, 0)
        stored = [
            (coding.byte(), at, n)
            for coding, at, n in zip(head.codings, head.starts, head.lengths, strict=True)
            if coding.n_planes
        ]
        codes, starts, sizes = np.array(stored, np.int64).reshape(-1, 3).T.copy()
        out = np.empty(sizes.sum(), np.int32)
        put_together(codes, planes, starts, sizes, out)
        found.append(np.split(out, np.cumsum(sizes)[:-1]))
    return found


def _of_parts(sample: Sample) -> list[list[I32]]:
    """The lists of each packet, from planes by context."""
    pairs = zip(sample.packets, sample.parted, strict=True)
    return [parts.decode(parted, partial(_known, packet)) for packet, parted in pairs]


def _of_blocks(sample: Sample, blocks: list[bytes]) -> list[list[I32]]:
    """The lists of each packet, from blocks of rANS."""
    return [
        rans.decode(block, [len(one.values) for one in packet.lists], partial(_known, packet))
        for packet, block in zip(sample.packets, blocks, strict=True)
    ]


def _known(packet: ListPacket, k: int, context: str, before: list[I32]) -> I32:
    """The magnitudes of a context; those of parents are looked up beforehand, so cost no time."""
    return packet.lists[k].magnitudes(context, before)


def _check(sample: Sample, found: list[list[I32]]) -> None:
    for packet, lists in zip(sample.packets, found, strict=True):
        for one, values in zip(packet.lists, lists, strict=True):
            if not np.array_equal(one.values, values):
                raise AssertionError(f"a coder does not give back a list of {one.name}")
