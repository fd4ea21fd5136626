"""`evogs encode` of one scene in files of several programs: what reading them adds."""

from __future__ import annotations

import shutil
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

from evogs_codec import SplatParams, read_scene, write_ply, write_scene
from tools.bench.measure import cost
from tools.bench.page import Rows
from tools.bench.sog_set import write_set

__all__ = ["inputs"]

EFFORTS, TURNS = ("fast", "default"), 2
SAME = {"spz": "ply of the .spz", "sog": "ply of the .sog"}  # the same splats
SAME |= {source: source for source in ("ply", *SAME.values())}
BEFORE = "from evogs_codec.cli.commands import main"
ENCODE = "assert main(['encode', {source!r}, {out!r}, '--force', '--effort', {effort!r}]) == 0"


def inputs(
    name: str,
    splats: SplatParams,
    folder: Path,
    efforts: Sequence[str] = EFFORTS,
    turns: int = TURNS,
) -> Rows:
    """`evogs encode` of one scene from a `.ply`, an `.spz` and a `.sog`, each in its own process.

    Seconds are of the processor, of all threads, the least of two turns that all inputs take one
    after the other. `evogs convert` writes the `.spz`, and `tools.bench.sog_set` the pictures of
    the `.sog`. Both round, so that streams and the work on prefixes
    differ; a `.ply` that `evogs convert` made of each has the same splats.
    """
    files = _files(name, splats, folder)
    rows: Rows = []
    for effort in efforts:
        seconds: dict[str, list[float]] = {ending: [] for ending in files}
        sizes = {}
        for turn in range(turns):
            for ending, path in files.items():
                print(f"{path.name}, {effort}, turn {turn + 1} ...", file=sys.stderr)
                out = folder / "inputs.evogs"
                words = {"source": str(path), "out": str(out), "effort": effort}
                seconds[ending].append(cost(ENCODE.format(**words), BEFORE).processor)
                sizes[ending] = out.stat().st_size
        least = {source: min(all_) for source, all_ in seconds.items()}
        rows += [
            {
                "scene": name,
                "splats": len(splats),
                "effort": effort,
                "from": f".{ending}",
                "bytes of the file": path.stat().st_size,
                "processor, s": f"{least[ending]:.1f}",
                "to .ply": f"{least[ending] / least['ply']:.2f}",
                "to .ply of the same splats": f"{least[ending] / least[SAME[ending]]:.2f}",
                "bytes of the stream": sizes[ending],
            }
            for ending, path in files.items()
        ]
    return rows


def _files(name: str, splats: SplatParams, folder: Path) -> dict[str, Path]:
    """The scene as files, by their endings."""
    files = {ending: folder / f"{name}-input.{ending}" for ending in ("ply", "spz", "sog")}
    write_ply(files["ply"], splats)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what an .spz does not hold
        write_scene(files["spz"], splats)
    pictures = folder / f"{name}-sog"
    write_set(splats, pictures)
    packed = shutil.make_archive(str(files["sog"]), "zip", pictures)
    Path(packed).replace(files["sog"])
    for ending in ("spz", "sog"):
        same = SAME[ending]
        files[same] = folder / f"{name}-of-{ending}.ply"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of opacities that bytes round to 1
            write_ply(files[same], read_scene(files[ending]).splats)
    return files
