"""A scene as many files: partition -> a file for each part -> overviews -> tileset.json."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from evogs_codec._generated import registry
from evogs_codec.common.printable import shown
from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.errors import InputError
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.encode import JobOptions
from evogs_codec.jobs.engines import Call, Engine, Workers
from evogs_codec.jobs.partition import rows_of
from evogs_codec.jobs.scratch import (
    do_missing,
    identity_of,
    partitioned,
    scratch_folder,
)
from evogs_codec.jobs.scratch_files import of_scratch
from evogs_codec.jobs.up import up_of_tiles
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64
from evogs_codec.scene.request import NO_NUMBA, with_generator
from evogs_codec.tileset.boxes import Box
from evogs_codec.tileset.contents import (
    as_glb,
    code_leaf,
    code_overview,
    made_of,
    with_place,
)
from evogs_codec.tileset.json_files import FOLDER, Frame, json_files, translation
from evogs_codec.tileset.nodes import Node, nodes_of

if TYPE_CHECKING:
    from evogs_codec.render import Up

__all__ = ["N_LEVELS", "TilesetOptions", "Written", "check_folder", "write_tileset"]

PER_FILE = 1 << 19  # splats
OVERVIEW = 1 << 17
N_LEVELS = 6  # of a file: overviews are made of the coarse ones
ENDING = ".evogs"
CRS = re.compile(r"EPSG:\d{1,10}$|[A-Za-z]\w*\[")  # WKT is a word with brackets
ERROR_RATIO = 1.25  # the error of a parent is at least so many times that of a child
METRES = {"metre": 1.0, "centimetre": 0.01, "millimetre": 0.001, "foot": 0.3048, "inch": 0.0254}


@dataclass(frozen=True)
class TilesetOptions:
    """How a tileset is made.

    Attributes:
        per_file: splats of a file, about.
        overview: splats of the overview of an inner node, at most about.
        job: how each file is encoded.
        crs: of the positions of the scene, or of those that `transform` makes of them: an EPSG
            code, or WKT.
        transform: 16 numbers, row by row, from the scene to the coordinates of that CRS; None: the
            scene has them already.
        content: streams, or glTF of their splats for clients that know no streams.
    """

    per_file: int = PER_FILE
    overview: int = OVERVIEW
    job: JobOptions = field(default_factory=lambda: JobOptions(levels=N_LEVELS))
    crs: str | None = None
    transform: tuple[float, ...] | None = None
    content: Literal["evogs", "glb"] = "evogs"


class Written(NamedTuple):
    """A tileset that was written."""

    root: Node
    up: Up


def write_tileset(
    paths: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    options: TilesetOptions | None = None,
    *,
    engine: Engine | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Written:
    """Write the splats of some files as an OGC 3D Tiles 1.1 tileset of streams.

    The bytes are the same for any number of workers, on any engine, in whatever order files are
    given, and after a run that was interrupted.

    Args:
        paths: scenes as of `read_scene`, all of one SH degree, which become one.
        out: the folder to make; it must not be there, or be empty.
        options: how.
        engine: where jobs run; by default in a process for each processor.
        resume: go on with what an earlier run of the same files and options left.
        progress: called with a stage and the part of it that is done.

    Returns:
        The root of the tiles, and what was up in the views.

    Raises:
        InputError: a file cannot be used, the folder has files, workers die again and again, or the
            scratch folder, `out` with `.parts` behind its name, is of another run or not ours.
        NotRepresentableError: values too large for any grid of the format.
        OSError: a disk is full, or the folder cannot be written.
    """
    if find_spec("numba") is None:
        raise InputError(f"scenes of any size are encoded by views: {NO_NUMBA}")
    check_folder(Path(out))
    options, report = options or TilesetOptions(), progress or no_progress
    _check_place(options)
    files = SplatFiles([Path(path) for path in paths], options.job.drop_invalid)
    folder = _scratch_of(Path(out))
    said = asdict(replace(options, job=replace(options.job, info=None)))
    degree = files.sh_degree  # files of several are refused before there is a folder
    identity = identity_of(files.paths, "tileset", degree, said, repr(options.job.info))
    outside = [Path(out), *files.paths]
    with scratch_folder(folder, identity, resume=resume, outside=outside):
        partition = partitioned(files, folder, report, options.per_file)
        info = with_generator(options.job.info or files.info)
        options = _with_place_of(info, options)
        up = up_of_tiles(partition, options.job.up, info)
        options = replace(options, job=replace(options.job, up=up.vector))
        root = nodes_of(partition)
        with Workers(engine or Engine()) as workers:
            run = _Run(folder, partition.sh_degree, options, info, workers, report)
            run.make_contents(root)
            run.finish(root, Path(out))
    return Written(root, up)


def _scratch_of(out: Path) -> Path:
    """`out` with `.parts` behind its name, which `.` and a `/` at the end do not have."""
    place = out.absolute()
    return place.with_name(f"{place.name}.parts")


def check_folder(folder: Path) -> None:
    """Refuse a folder that a tileset must not be written to.

    Raises:
        InputError: it has files, or is a file.
        OSError: the folder around it is not there, or cannot be written.
    """
    if folder.is_dir():
        if any(folder.iterdir()):
            raise InputError(f"{folder}: has files: name another folder, or empty it first")
    elif folder.exists() or folder.is_symlink():
        raise InputError(f"{folder}: is a file: name a folder")
    parent = folder.absolute().parent
    if not parent.is_dir():
        raise FileNotFoundError(2, "its folder does not exist: make it first", str(folder))
    if not os.access(parent, os.W_OK):
        said = "its folder may not be written to: name another output"
        raise PermissionError(13, said, str(folder))


def _check_place(options: TilesetOptions) -> None:
    if options.crs is not None and not CRS.match(options.crs):
        raise InputError(f"the CRS '{shown(options.crs)}' is neither EPSG: with a number nor WKT")
    if options.transform is not None and not _is_affine(options.transform):
        raise InputError("the transform is no matrix of 4 x 4, row by row, that ends in 0 0 0 1")


def _is_affine(numbers: Sequence[float]) -> bool:
    matrix = np.array(numbers, np.float64)
    is_right = matrix.size == 16 and matrix[12:].tolist() == [0, 0, 0, 1]
    if not is_right or not np.isfinite(matrix).all():
        return False
    return bool(abs(np.linalg.det(matrix.reshape(4, 4))) > 0)


def _with_place_of(info: SceneInfo, options: TilesetOptions) -> TilesetOptions:
    """The options, with the place that the scene says if they say none."""
    if options.crs is None and options.transform is None:
        crs, said = info.text.get("crs"), info.text.get("transform", "")
        try:
            numbers = tuple(map(float, said.split()))
        except ValueError:
            numbers = ()
        if _is_affine(numbers):
            return replace(options, crs=crs, transform=numbers)
        return replace(options, crs=crs)
    return options


@dataclass
class _Run:
    folder: Path
    sh_degree: int
    options: TilesetOptions
    info: SceneInfo
    workers: Workers
    report: Progress

    def make_contents(self, root: Node) -> None:
        """The streams of all nodes, and what is known of them."""
        made = self.folder / "tileset" / FOLDER
        made.mkdir(parents=True, exist_ok=True)
        nodes = list(root.all())
        leaves: list[Call] = [
            (str(rows_of(self.folder, node.tile)), self.sh_degree, *self._outputs(node))
            for node in nodes
            if node.tile is not None
        ]
        do_missing(self.workers, code_leaf, leaves, self.report, "encode")
        for height in range(1, root.height + 1):  # an overview is made of those below
            rank = [node for node in nodes if node.height == height]
            calls: list[Call] = [(self._below(node), *self._outputs(node)) for node in rank]
            do_missing(self.workers, code_overview, calls, self.report, "overviews")
        for node in reversed(nodes):
            self._measure(node)

    def finish(self, root: Node, out: Path) -> None:
        """Write the JSON, and give the folder its name."""
        made = self.folder / "tileset"
        ending = f".{self.options.content}"
        if ending != ENDING:
            self._convert(root, ending)
        for name, text in json_files(root, self._frame(root), ending).items():
            write_atomic(made / name, text)
        for path in made.glob(f"{FOLDER}/*.work"):
            shutil.rmtree(path)
        if out.is_symlink() or (out.is_dir() and out.samefile(Path.cwd())):
            for path in sorted(made.iterdir(), key=lambda path: path.suffix == ".json"):
                shutil.move(path, out / path.name)  # the JSON last: it needs the others
            made.rmdir()
            return
        if out.is_dir():
            out.rmdir()
        made.rename(out)

    def _convert(self, root: Node, ending: str) -> None:
        """Files of another format in place of streams, which stay in the scratch folder."""
        streams = self.folder / "streams"
        tiles = self.folder / "tileset" / FOLDER
        if not streams.exists():
            tiles.rename(streams)
        tiles.mkdir(exist_ok=True)
        nodes = list(root.all())
        calls: list[Call] = [
            (str(streams / f"{node.name}{ENDING}"), str(tiles / f"{node.name}{ending}"))
            for node in nodes
        ]
        do_missing(self.workers, as_glb, calls, self.report, "convert")
        for node, (_, path) in zip(nodes, calls, strict=True):
            node.n_bytes = Path(path).stat().st_size

    def _outputs(self, node: Node) -> tuple[JobOptions, str, str]:
        """The last arguments of a job."""
        to_scene = translation(node.origin)
        matrix = to_scene if self.options.transform is None else self._transform() @ to_scene
        info = replace(self.info, text=dict(self.info.text))
        options = with_place(self.options.job, info, matrix, self.options.crs)
        return options, str(self._content(node)), str(self._known(node))

    def _below(self, node: Node) -> tuple[tuple[str, tuple[float, ...], int], ...]:
        return tuple(
            (
                str(self._content(child)),
                tuple((child.origin - node.origin).tolist()),
                max(1, self.options.overview * child.weight // node.weight),
            )
            for child in node.children
        )

    def _measure(self, node: Node) -> None:
        """Box and error, once those of the children are known."""
        with of_scratch(self._known(node)):
            made = made_of(self._known(node))
        node.n_splats, node.n_bytes = made.n_splats, made.n_bytes
        boxes = [made.box]
        boxes += [child.box.moved(child.origin - node.origin) for child in node.children]
        node.box = Box.around(boxes).rounded()
        if node.children:
            least = max(ERROR_RATIO * child.error for child in node.children)
            node.error = max(made.size, least, 1e-9 * node.box.diagonal)

    def _content(self, node: Node) -> Path:
        return self.folder / "tileset" / FOLDER / f"{node.name}{ENDING}"

    def _known(self, node: Node) -> Path:
        return self.folder / f"{node.name}.made"

    def _transform(self) -> F64:
        return np.array(self.options.transform, np.float64).reshape(4, 4)

    def _frame(self, root: Node) -> Frame:
        extras = {
            "evogs": {
                "splats": root.weight,
                "files": sum(1 for _ in root.all()),
                "origin": root.origin.tolist(),
            }
        }
        if self.options.crs is not None:
            extras["evogs"]["crs"] = self.options.crs
        if self.options.transform is not None:
            matrix = self._transform()
            scale = float(np.linalg.norm(matrix[:3, :3], axis=0).max())
            return Frame(matrix, scale, extras)
        scale = METRES.get(registry.name(registry.UNITS, self.info.unit), 1.0)
        matrix = np.eye(4)
        matrix[:3, :3] = scale * turn_up(np.array(self.options.job.up, np.float64))
        return Frame(matrix, scale, extras)


def turn_up(up: F64) -> F64:
    """(3, 3) the shortest turn of a direction to +z."""
    x, y, z = (up / np.linalg.norm(up)).tolist()
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    a, b, c = 1 / (1 + z), x, y
    out = np.array([[1 - a * b * b, -a * b * c, -b], [-a * b * c, 1 - a * c * c, -c], [b, c, z]])
    return out + 0.0
