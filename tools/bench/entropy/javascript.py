"""The coders in JavaScript: `javascript.cjs` decodes what is written here."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

from tools.bench.entropy.costs import VARIANTS, Sample

__all__ = ["IN_JAVASCRIPT", "run_javascript"]

IN_JAVASCRIPT = tuple(VARIANTS)[:2]


def run_javascript(node: str, sample: Sample, turns: int) -> dict[str, float]:
    """Median seconds of each coder, in `turns` turns; those of Zstandard that `node` finds."""
    program = Path(__file__).with_suffix(".cjs")
    with tempfile.TemporaryDirectory() as folder:
        _write_job(sample, Path(folder))
        command = [node, str(program), folder, str(turns)]
        run = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds: dict[str, float] = json.loads(run.stdout)
    return seconds


def _write_job(sample: Sample, folder: Path) -> None:
    """What the program decodes: packets in `job.json`, the bytes of the sample and blocks."""
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
