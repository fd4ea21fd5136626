"""Prefixes of streams: what their first bytes are worth, in the order of the file and by level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evogs_codec import Cut, EvolutionTree, decode, read_directory
from evogs_codec.format.directory import Directory
from evogs_codec.format.layout import PACKET_ENTRY, size_of
from tools.bench.page import Rows
from tools.bench.paper.runs import find_runs
from tools.bench.subjects import Gauge, Subject

__all__ = ["by_level", "ends_of_packets", "prefixes", "rivals", "sizes_of_packets"]

N_CUTS = 20
MAX_VIEWS = 6  # views that a prefix is judged by
BUDGET, METHODS = "equal", {"evogs": "EvoGS", "lapis": "LapisGS"}
I64 = npt.NDArray[np.int64]
F64 = npt.NDArray[np.float64]


def rivals(of: Sequence[Subject], runs: Path | None) -> tuple[Subject, ...]:
    """The subjects, and the first EvoGS and LapisGS trees of `runs`, judged as the last subject."""
    trees: dict[str, EvolutionTree] = {}
    for run in find_runs(runs) if runs else ():
        name = METHODS.get(run.method)
        if run.budget == BUDGET and name and name not in trees:
            trees[name] = run.tree()
    return (*of, *(replace(of[-1], name=name, tree=tree) for name, tree in trees.items()))


def prefixes(of: Sequence[Subject]) -> Rows:
    """PSNR of 20 prefixes of each stream: of a twentieth of its bytes, two twentieths, and on.

    The same packets in two orders: of the file, which is that of gain per byte, and level by level,
    in a level the core of all steps before their SH bands. A prefix has whole packets only. PSNR is
    over 6 views, of photographs where there are any. The mean is over the bytes from a twentieth to
    the whole; the deepest fall is from a cut to the next. Above LapisGS: in the mean over the same
    bytes of both streams, from a twentieth of the longer, where the shorter one stays as it is.
    """
    curves = {(s.name, order): curve for s in of for order, curve in _curves(s).items()}
    rows: Rows = []
    for (scene, order), curve in curves.items():
        rival = curves.get((METHODS["lapis"], order))
        above = ""
        if rival and scene == METHODS["evogs"]:
            end = max(curve.total, rival.total)
            above = f"{curve.mean(end) - rival.mean(end):.2f}"
        row: dict[str, object] = {
            "scene": scene,
            "order": order,
            "bytes": curve.total,
            "mean, dB": f"{curve.mean(curve.total):.2f}",
            "deepest fall, dB": f"{max(0.0, float(-np.diff(curve.decibels).min())):.2f}",
            "above LapisGS, dB": above,
        }
        parts = [f"{100 * k // N_CUTS} %" for k in range(1, N_CUTS + 1)]
        worth = [f"{number:.2f}" for number in curve.decibels]
        rows.append(row | dict(zip(parts, worth, strict=True)))
    return rows


@dataclass(frozen=True, eq=False)
class _Curve:
    """Bytes of a stream, and (20,) dB of its prefixes."""

    total: int
    decibels: F64

    def mean(self, end: int) -> float:
        """Mean dB of what is there after each byte from a twentieth of `end` to `end`."""
        at = np.linspace(end // N_CUTS, end, 1001) * N_CUTS // self.total - 1
        return float(self.decibels[np.clip(at, 0, N_CUTS - 1).astype(int)].mean())


def _curves(subject: Subject) -> dict[str, _Curve]:
    """Those of a stream in both orders."""
    data = subject.stream
    directory = read_directory(data)
    gauge = _some_views(subject.gauge)
    found: dict[tuple[bytes, int], float] = {}
    out = {}
    for name, order in (
        ("file", np.arange(len(directory.packets))),
        ("by level", by_level(directory)),
    ):
        ends = ends_of_packets(data, sizes_of_packets(directory, order))
        decibels = []
        for k in range(1, N_CUTS + 1):
            n = int(np.searchsorted(ends, len(data) * k // N_CUTS, side="right"))
            cut = Cut.of_rows(directory, order[:n])
            key = cut.steps.tobytes(), cut.palette
            if key not in found:
                found[key], _ = gauge(decode(data, cut).leaves())
            decibels.append(found[key])
        out[name] = _Curve(len(data), np.array(decibels))
    return out


def _some_views(gauge: Gauge) -> Gauge:
    every = -(-len(gauge.cameras) // MAX_VIEWS)
    return replace(gauge, cameras=gauge.cameras[::every], targets=gauge.targets[::every])


def sizes_of_packets(directory: Directory, order: I64) -> I64:
    """(n,) bytes of each packet with its entry in the directory."""
    sizes: I64 = directory.packets["size"][order].astype(np.int64) + size_of(PACKET_ENTRY)
    return sizes


def ends_of_packets(data: bytes, sizes: I64) -> I64:
    """(n,) bytes of the shorter stream that ends with each packet: it lists no later ones."""
    return len(data) - int(sizes.sum()) + np.cumsum(sizes)


def by_level(directory: Directory) -> I64:
    """Packets by level; in a level core, the palette, then bands, in the order of the steps."""
    packets = directory.packets
    rank = np.where(packets["component"] == 0, 0, 2)
    rank[directory.palette_packets] = 1
    order: I64 = np.lexsort(
        (packets["component"], packets["tile"], directory.steps, rank, directory.labels)
    )
    return order
