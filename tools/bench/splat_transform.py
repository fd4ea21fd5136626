"""splat-transform, the command line of PlayCanvas: SOG files, and decimation.

It is started as the command that it is given as, `npx @playcanvas/splat-transform` or one that is
installed; nothing else of it is needed.
"""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

from evogs_codec import SplatParams, read_ply, write_ply

__all__ = ["decimated", "read_sog", "write_sog"]


def write_sog(command: str, splats: SplatParams, path: Path) -> Path:
    """The path, where there is a SOG file of the splats now."""
    write_ply(path.with_suffix(".ply"), splats)
    _run(command, path.with_suffix(".ply"), path)
    return path


def read_sog(command: str, path: Path) -> SplatParams:
    """The splats of a SOG file, in an order of its own."""
    ply = path.with_suffix(".again.ply")
    _run(command, path, ply)
    return read_ply(ply)


def decimated(command: str, scene: Path, n: int) -> SplatParams:
    """The scene of a `.ply`, merged down to n splats."""
    ply = scene.with_name(f"{scene.stem}-{n}.ply")
    _run(command, scene, "--decimate", str(n), ply)
    return read_ply(ply)


def _run(command: str, *arguments: str | Path) -> None:
    """On the processor: graphics cards would make other files."""
    program = shlex.split(command)
    subprocess.run(
        [*program, "--quiet", "--overwrite", "--gpu", "cpu", *map(str, arguments)],
        check=True,
        capture_output=True,
    )
