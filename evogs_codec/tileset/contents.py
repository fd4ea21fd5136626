"""Jobs: a content is made of the splats of a leaf, or of the coarse levels of other contents.

A job needs its arguments and nothing else, and gives the same bytes wherever it runs.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.editing.byte_stats import levels
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.io.files import write_atomic
from evogs_codec.io.interchange import gltf
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.io.ply import write_ply
from evogs_codec.jobs.encode import JobOptions, encode_files
from evogs_codec.jobs.engines import Engine
from evogs_codec.jobs.scratch_files import of_scratch
from evogs_codec.jobs.tile_job import sorted_rows
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.tileset.boxes import Box, covered, size_of

__all__ = ["Made", "as_glb", "code_leaf", "code_overview", "made_of", "with_place"]

OF_SCENE = ("camera", "cameras", "psnr")  # metadata in coordinates of the scene, or of all of it
CONTENT = "content.ply"
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from z up


@dataclass(frozen=True)
class Made:
    """What is known of a content.

    Attributes:
        box: what the splats of any of its levels cover, from its origin.
        size: of its splats (`size_of`), scene units.
        n_splats: of its last level.
        n_bytes: of the file.
    """

    box: Box
    size: float
    n_splats: int
    n_bytes: int


def made_of(path: Path) -> Made:
    """What a job left beside the content that it made."""
    found = json.loads(path.read_text())
    box = Box(tuple(found["box"]["low"]), tuple(found["box"]["high"]))
    return Made(box, found["size"], found["n_splats"], found["n_bytes"])


def code_leaf(rows: str, sh_degree: int, options: JobOptions, out: str, done: str) -> None:
    """Make the content of a leaf.

    Args:
        rows: file of its splats, as `partition` makes it.
        sh_degree: of them.
        options: how it is encoded.
        out: the stream.
        done: what is known of it; it is there when all is done.
    """
    work = _work_of(Path(out))
    write_ply(work / CONTENT, SplatParams.from_channels(sorted_rows(rows, sh_degree).T))
    _code(work, options, Path(out), Path(done))


def code_overview(
    children: Sequence[tuple[str, tuple[float, float, float], int]],
    options: JobOptions,
    out: str,
    done: str,
) -> None:
    """Make the content of an inner node.

    Args:
        children: of each child the content, where its origin is from that of the node, and how many
            splats of it are taken at most: the last level that has no more, but at least the first.
        options: how it is encoded.
        out: the stream.
        done: what is known of it; it is there when all is done.
    """
    work = _work_of(Path(out))
    write_ply(work / CONTENT, _coarse(children))
    _code(work, options, Path(out), Path(done))


def as_glb(stream: str, out: str) -> None:
    """Make glTF of a content, for clients that know no streams.

    They turn what they read of glTF from y up to z up: so it is turned the other way.
    """
    with of_scratch(Path(stream)):
        data = np.memmap(stream, np.uint8, "r").data
        directory = read_directory(data)
        splats = decode_leaves(data, sh_degree=directory.sh_degree, directory=directory)
    turned = transformed(splats, Y_UP)
    write_atomic(out, gltf.write(turned, directory.info, "evogs tileset"))


def _coarse(children: Sequence[tuple[str, tuple[float, float, float], int]]) -> SplatParams:
    """The splats of an overview (`code_overview`)."""
    parts = []
    for path, way, most in children:
        with of_scratch(Path(path)):
            data = np.memmap(path, np.uint8, "r").data
            directory = read_directory(data)
            level = _level_of(directory, most)
            splats = decode_leaves(
                data, level=level, sh_degree=directory.sh_degree, directory=directory
            )
        rows = splats.channels()
        rows[0:3] += np.array(way, np.float32)[:, None]
        parts.append(rows)
    return SplatParams.from_channels(np.concatenate(parts, axis=1))


def _level_of(directory: Directory, most: int) -> int:
    counts = [level.n_leaves for level in levels(directory)]
    fitting = [k for k, n in enumerate(counts) if n <= most]
    return fitting[-1] if fitting else 0


def _work_of(out: Path) -> Path:
    """A new folder beside a content, for what is in work."""
    work = out.with_suffix(".work")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    return work


def _code(work: Path, options: JobOptions, out: Path, done: Path) -> None:
    """Encode the splats in a folder for what is in work; none of them are in memory meanwhile."""
    serial = Engine("serial")
    options = replace(options, palette="never")  # contents share nothing, nor overviews with them
    encode_files([work / CONTENT], out, options, engine=serial, scratch=work / "parts")
    made = _measured(out)
    shutil.rmtree(work)
    write_atomic(done, json.dumps(asdict(made)).encode())


def _measured(path: Path) -> Made:
    data = np.memmap(path, np.uint8, "r").data
    directory = read_directory(data)
    boxes, size, n_splats = [], 0.0, 0
    for level in range(directory.n_levels):
        splats = decode_leaves(data, level=level, sh_degree=0, directory=directory)
        boxes.append(covered(splats))
        size, n_splats = size_of(splats), len(splats)
    return Made(Box.around(boxes), size, n_splats, path.stat().st_size)


def with_place(options: JobOptions, info: SceneInfo, matrix: F64, crs: str | None) -> JobOptions:
    """Options of a content whose positions `matrix` (4, 4) takes to the scene, or to its CRS."""
    numbers = (repr(x).removesuffix(".0") for x in matrix.ravel().tolist())
    text = {key: value for key, value in info.text.items() if key not in OF_SCENE}
    text["transform"] = " ".join(numbers)
    if crs is not None:
        text["crs"] = crs
    return replace(options, info=replace(info, text=text))
