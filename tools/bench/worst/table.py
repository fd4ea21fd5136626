"""The table of worst cases: per command the stream that costs most, before a change and now."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from random import Random

from conformance.fuzzing import memory
from conformance.fuzzing.costly import Shape, stream_of
from evogs_codec import InputError, StreamError, read_directory
from evogs_codec.model.channels import n_channels
from tools.bench.page import Rows
from tools.bench.worst.known import KNOWN
from tools.bench.worst.processes import Codec, Measure
from tools.bench.worst.search import uphill

__all__ = ["COMMANDS", "worst"]

ROOT = Path(__file__).resolve().parent.parent.parent.parent
COMMANDS = (
    "decode to .ply", "decode to arrays", "validate", "info", "info --json", "extract --level",
    "extract --max-bytes", "extract --box", "extract --sh-degree", "feed 1", "feed 1 backward",
    "feed 100", "feed 100 interleaved", "feed 100 overlapping", "feed 100, the first packet last",
    "feed 4096", "feed 4096 backward", "feed all, one packet missing",
)  # fmt: skip
TURNS, CANDIDATES = 3, 3  # of those that cost most at the first turn
SEED = 1


def worst(before: Path | None = None, tries: int = 0, only: Collection[str] = ()) -> Rows:
    """Streams of 100,000 bytes that cost most, for each command the worst that was found.

    A search makes shapes at random and climbs from the worst: SH degree or palette, tiles, levels,
    what the steps do (adds, splits of all, of the newest or of one, refinements, drops, nothing),
    which lists are stored and in how many planes and frames, bands and picks that come late,
    digests up to their bound, alpha tables, metadata, unknown chunks, and a fault at the very end.
    What it found stands in `tools/bench/worst/known.py`; `--tries N` searches on from there, and
    `--rows WORD` makes only the rows of commands with this word.
    Seconds are those of the processor, the least of 3 turns, start of Python and imports included;
    a stream that takes more than 60 s is stopped.
    Memory is the peak above a process that only imports, and the model is that of spec 8.3
    (`conformance/fuzzing/memory.py`) with the float view. No stream of this size loads compiled
    loops. What is over it is memory in huge pages, and planes that are copied while they are
    joined.
    "Before" is the worst of the same streams with the codec of another checkout. A virtual machine
    may take up to a second more for memory that nobody used before: the largest streams make 1.6
    million splats, 386 MB of integers and as much of floats.
    """
    commands = _chosen(only)
    with tempfile.TemporaryDirectory() as folder, Codec(ROOT) as codec:
        stream = Path(folder) / "worst.evogs"
        shapes = dict(KNOWN)
        if tries:
            shapes |= _found(codec, commands, stream, tries)
        now = _costliest(codec, commands, shapes, stream)
        earlier: dict[str, dict[str, object]] = {}
        if before is not None:
            with Codec(before) as old:
                earlier = _costliest(old, commands, shapes, stream)
        start = f"{codec.start:.2f}"
    rows: Rows = []
    for command in commands:
        row: dict[str, object] = {"command": command}
        if before is not None:
            of_old = earlier[command]
            row |= {"before, s": of_old["s"], "worst before": of_old["shape"]}
        row |= {key: value for key, value in now[command].items() if key != "shape"}
        row |= {"start, s": start, "worst": now[command]["shape"]}
        rows.append(row)
    return rows


def _chosen(words: Collection[str]) -> list[str]:
    """The commands that have one of these words, or all for none.

    Raises:
        InputError: none has.
    """
    chosen = [name for name in COMMANDS if not words or {name, *name.split()} & set(words)]
    if not chosen:
        raise InputError(f"no row has {' or '.join(words)}; there are: {', '.join(COMMANDS)}")
    return chosen


def _found(codec: Codec, commands: Sequence[str], stream: Path, tries: int) -> dict[str, Shape]:
    """What the search finds for each command, by a description."""
    rng = Random(SEED)
    found: dict[str, Shape] = {}
    for command in commands:
        cost = partial(_cost, codec, command, stream)
        known = max(KNOWN.values(), key=cost)
        seconds, shape = uphill(cost, known, rng, tries // 2, tries - tries // 2)
        print(f"{command}: {seconds:.2f} s, {_described(shape)}", file=sys.stderr, flush=True)
        found[_described(shape)] = shape
    return {name: shape for name, shape in found.items() if shape not in KNOWN.values()}


def _cost(codec: Codec, command: str, stream: Path, shape: Shape) -> float:
    try:
        stream.write_bytes(stream_of(shape))
    except ValueError:  # its chunks take all the room
        return 0.0
    return codec.measure(command, stream).seconds


def _costliest(
    codec: Codec, commands: Sequence[str], shapes: dict[str, Shape], stream: Path
) -> dict[str, dict[str, object]]:
    """By command: seconds of the slowest shape, and memory of the one that most needs it."""
    by_command: dict[str, list[tuple[str, Measure, int]]] = {name: [] for name in commands}
    for name, shape in shapes.items():
        print(name, file=sys.stderr, flush=True)
        data = stream_of(shape)
        stream.write_bytes(data)
        for command in commands:
            found = codec.measure(command, stream)
            by_command[command].append((name, found, _model(data, command)))
    rows: dict[str, dict[str, object]] = {}
    for command, measures in by_command.items():
        measures.sort(key=lambda item: -item[1].seconds)
        again = []
        for name, once, _ in measures[:CANDIDATES]:
            stream.write_bytes(stream_of(shapes[name]))
            more = codec.measure(command, stream, TURNS - 1)
            again.append((min(more, once, key=lambda measure: measure.seconds), name))
        slowest, shape_name = max(again, key=lambda item: item[0].seconds)
        _, largest, model = max(measures, key=lambda item: item[1].peak)
        rows[command] = {
            "s": f"{slowest.seconds:.2f}",
            "shape": shape_name if slowest.ended != "killed" else f"{shape_name} (stopped)",
            "peak MiB": f"{largest.peak / 2**20:.0f}",
            "model MiB": f"{model / 2**20:.0f}",
            "most over the model, MiB": f"{max(0, max(m.peak - b for _, m, b in measures)) >> 20}",
        }
    return rows


def _model(data: bytes, command: str) -> int:
    """Bytes that a command may take: the state by spec 8.3, and the float view."""
    try:
        directory = read_directory(data)
    except StreamError:
        return memory.bound(data)
    rows = directory.packets
    live = int((rows["n_adds"].astype(int) + rows["n_splits"] - rows["n_drops"]).sum())
    view = 4 * n_channels(directory.sh_degree) * live
    has_view = command.startswith(("decode", "feed"))
    return memory.bound(data, grows=command.startswith("feed")) + view * has_view


def _described(shape: Shape) -> str:
    """The fields that are not usual."""
    usual = Shape()
    return ", ".join(
        f"{field.name} {getattr(shape, field.name)}"
        for field in fields(Shape)
        if getattr(shape, field.name) != getattr(usual, field.name)
    )
