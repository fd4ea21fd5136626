"""Entropy coders on the integers of streams: what is stored now, what could be, and how fast.

A bound is what an ideal coder spends on the lists. The directory and the packet headers of the
present stream are added to all but it, so that sizes are those of whole streams.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from evogs_codec import decode_leaves, read_directory
from evogs_codec.packets import read_planes
from evogs_codec.splats import I32
from evogs_codec.stats import bytes_by_group
from tools.bench import parts, rans
from tools.bench.contexts import CONTEXTS
from tools.bench.costs import VARIANTS, Sample, samples
from tools.bench.lists import ListPacket
from tools.bench.measure import take_turns
from tools.bench.parts import put_together

__all__ = ["TABLES", "samples"]

Rows = list[dict[str, object]]
TURNS = 9
IN_JAVASCRIPT = tuple(VARIANTS)[:2]


def sizes(of: Sequence[Sample]) -> Rows:
    """Bytes per splat of whole streams, stored and bounds."""
    rows: Rows = []
    for sample in of:
        n_bytes = {
            "the format: planes, Zstandard 19": len(sample.data),
            "the format: planes, Zstandard 3": len(sample.fast),
            "planes by context, Zstandard 19": sample.head
            + sum(packet.n_bytes for packet in sample.parted),
            **{name: sample.head + sum(map(len, found)) for name, found in sample.blocks.items()},
            "bound: order 0 of the planes": sample.total("planes"),
            "bound: order 0 of the integers": sample.total("integers"),
            "bound: a context, static tables": sample.total("static"),
            "bound: a context, adaptive": sample.total("adaptive"),
            "bound: two contexts, adaptive": sample.total("adaptive, two"),
        }
        rows += [
            {
                "stream": sample.name,
                "coder": coder,
                "bytes a splat": f"{size / sample.n:.3f}",
                "to the format": f"{size / len(sample.data):.3f}",
            }
            for coder, size in n_bytes.items()
        ]
    return rows


def contexts(of: Sequence[Sample]) -> Rows:
    """What each context gains where it is the only one."""
    rows: Rows = []
    for sample in of:
        for context in CONTEXTS:
            static, adaptive = (
                sample.total(f"static {context}"),
                sample.total(f"adaptive {context}"),
            )
            rows.append(
                {
                    "stream": sample.name,
                    "context": context,
                    "static tables, bytes a splat": f"{static / sample.n:.3f}",
                    "to the format": f"{static / len(sample.data):.3f}",
                    "adaptive, bytes a splat": f"{adaptive / sample.n:.3f}",
                    "adaptive to the format": f"{adaptive / len(sample.data):.3f}",
                }
            )
    return rows


def groups(of: Sequence[Sample]) -> Rows:
    """Bytes per splat of what the lists hold: stored, and by the bounds."""
    rows: Rows = []
    for sample in of:
        view = memoryview(sample.data)
        stored = bytes_by_group(read_directory(view), view)
        for name, costs in sample.costs.items():
            rows.append(
                {
                    "stream": sample.name,
                    "part": name,
                    "the format": f"{stored[name].n_bytes / sample.n:.3f}",
                    "order 0 of the integers": f"{costs['integers'] / sample.n:.3f}",
                    "static tables": f"{costs['static none'] / sample.n:.3f}",
                    "a context, static tables": f"{costs['static'] / sample.n:.3f}",
                    "two contexts, adaptive": f"{costs['adaptive, two'] / sample.n:.3f}",
                }
            )
    return rows


def decoding(of: Sequence[Sample]) -> Rows:
    """Time from bytes to integers, a thread each, and the whole decode of the format beside it."""
    rows: Rows = []
    for sample in of:
        coders: dict[str, Callable[[], list[list[I32]]]] = {
            "planes, Zstandard": partial(_of_frames, sample),
            "planes by context, Zstandard": partial(_of_parts, sample),
            **{name: partial(_of_blocks, sample, b) for name, b in sample.blocks.items()},
        }
        for run in coders.values():
            _check(sample, run())
        whole = {"decode to floats, the format": partial(decode_leaves, sample.data)}
        seconds = take_turns({**coders, **whole}, TURNS)
        n = sum(len(one.values) for packet in sample.packets for one in packet.lists)
        rows += _speeds(sample, n, seconds)
    return rows


def javascript(of: Sequence[Sample]) -> Rows:
    """The same in JavaScript; says so where node or a library is not there."""
    node = shutil.which("node")
    if node is None:
        return [{"stream": "", "coder": "not measured: node is not on this machine"}]
    rows: Rows = []
    for sample in of:
        with tempfile.TemporaryDirectory() as folder:
            _write_job(sample, Path(folder))
            program = Path(__file__).parent / "entropy.cjs"
            run = subprocess.run(
                [node, str(program), folder, str(TURNS)],
                check=True,
                capture_output=True,
                text=True,
            )
        n = sum(len(one.values) for packet in sample.packets for one in packet.lists)
        rows += _speeds(sample, n, json.loads(run.stdout))
    return rows


TABLES: dict[str, tuple[str, Callable[[Sequence[Sample]], Rows]]] = {
    "entropy": ("Entropy coders: bytes of a stream", sizes),
    "entropy-contexts": ("Entropy coders: what contexts gain", contexts),
    "entropy-groups": ("Entropy coders: bytes of each part", groups),
    "entropy-decoding": ("Entropy coders: time from bytes to integers", decoding),
    "entropy-javascript": ("Entropy coders: time in JavaScript", javascript),
}


def _speeds(sample: Sample, n: int, seconds: dict[str, float]) -> Rows:
    base = next(iter(seconds.values()))
    return [
        {
            "stream": sample.name,
            "coder": coder,
            "ns an integer": f"{1e9 * value / n:.2f}",
            "to the first": f"{value / base:.2f}",
        }
        for coder, value in seconds.items()
    ]


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


def _write_job(sample: Sample, folder: Path) -> None:
    """What `entropy.cjs` decodes: packets in `job.json`, the bytes of the sample and blocks."""
    data, jobs = bytearray(), []
    for k, packet in enumerate(sample.packets):
        head, at = packet.header, packet.header.size
        frames, plane = [], 0
        for n_planes, size in head.frames:
            content = sum(head.plane_sizes[plane : plane + n_planes])
            frames.append([len(data) + at, size, content])
            at, plane = at + size, plane + n_planes
        data += packet.body
        places = {}
        for name in IN_JAVASCRIPT:
            data += bytes(-len(data) % 4)
            places[name] = [len(data), len(sample.blocks[name][k])]
            data += sample.blocks[name][k]
        jobs.append(
            {
                "frames": frames,
                "blocks": places,
                "lists": [
                    {
                        "n": len(one.values),
                        "low": one.coding.low,
                        "high": one.coding.high,
                        "sums": {context: list(before) for context, before in one.sums.items()},
                    }
                    for one in packet.lists
                ],
            }
        )
    (folder / "job.json").write_text(json.dumps(jobs), encoding="utf-8")
    (folder / "job.bin").write_bytes(data)


def _check(sample: Sample, found: list[list[I32]]) -> None:
    for packet, lists in zip(sample.packets, found, strict=True):
        for one, values in zip(packet.lists, lists, strict=True):
            if not np.array_equal(one.values, values):
                raise AssertionError(f"a coder does not give back a list of {one.name}")
