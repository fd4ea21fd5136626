"""Time and memory of scenes that are encoded tile by tile, all processes together."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from evogs_codec import read_directory, write_ply
from tools.bench.page import Rows
from tools.bench.scale import tiled

__all__ = ["Together", "large", "together"]

SIZES = (100_000, 1_000_000, 3_000_000, 10_000_000, 30_000_000)  # splats
WORKERS = 2
PAUSE = 0.2  # s, between two looks at the memory


class Together(NamedTuple):
    """What a command and all that it started took.

    Attributes:
        processor: s.
        peak: bytes of memory at most, of all processes together; what they share counts once.
        scratch: bytes of a folder at most.
    """

    processor: float
    peak: int
    scratch: int


def large(folder: Path) -> Rows:
    """`evogs encode --workers 2` of more and more splats.

    Copies of the procedural scene at SH degree 1. Memory is that of all processes together, with
    the libraries that they load; pages that two share count once. Seconds are those of the
    processor, of all processes.
    """
    rows: Rows = []
    scene, out = folder / "large.ply", folder / "large.evogs"
    for n in SIZES:
        print(f"large {n}", file=sys.stderr)
        write_ply(scene, tiled(n))
        command = [sys.executable, "-m", "evogs", "encode", scene, out, "--workers", str(WORKERS)]
        found = together([*map(str, command), "--force"], Path(f"{out}.parts"))
        size = out.stat().st_size
        directory = read_directory(out.read_bytes())
        rows.append(
            {
                "splats": n,
                "tiles": len(directory.tiles),
                "processor s": f"{found.processor:.0f}",
                "us a splat": f"{1e6 * found.processor / n:.0f}",
                "peak MiB": f"{found.peak / 2**20:.0f}",
                "scratch, of the input": f"{found.scratch / scene.stat().st_size:.2f}",
                "bytes a splat": f"{size / n:.2f}",
                "directory": f"{directory.data_offset / size:.2%}",
            }
        )
    return rows


def together(command: list[str], scratch: Path) -> Together:
    """What a command takes; Linux only.

    Raises:
        CalledProcessError: it failed.
    """
    before = os.times()
    peak = most = 0
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:
            peak = max(peak, sum(_memory(one) for one in _family(process.pid)))
            most = max(most, _size(scratch))
            time.sleep(PAUSE)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    after = os.times()
    children = after.children_user + after.children_system
    return Together(children - before.children_user - before.children_system, peak, most)


def _family(process: int) -> list[int]:
    """A process and all below it."""
    found = [process]
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            children = task.read_text().split()
        except OSError:  # it has ended
            continue
        for child in children:
            found += _family(int(child))
    return found


def _memory(process: int) -> int:
    """Bytes, of pages that several processes have a part each."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_text()
    except OSError:  # it has ended
        return 0
    lines = [line.split() for line in text.splitlines() if line.startswith("Pss:")]
    return sum(int(line[1]) * 1024 for line in lines)


def _size(folder: Path) -> int:
    """Bytes of the files in a folder."""
    try:
        return sum(file.stat().st_size for file in folder.iterdir())
    except OSError:  # it is not there yet, or a file is gone
        return 0
