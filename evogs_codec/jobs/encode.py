"""A stream of any number of splats: partition, survey, a job for each tile, merge."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.encoding.grids import TooFineError
from evogs_codec.encoding.layers import N_LAYERS
from evogs_codec.errors import InputError
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.jobs.distinct import Distinct, Vectors
from evogs_codec.jobs.engines import Call, Engine, Workers
from evogs_codec.jobs.merge import merge
from evogs_codec.jobs.partition import (
    PER_TILE,
    Partition,
    drawn_of,
    panes_of,
    rows_of,
    stand_ins_of,
    vectors_of,
)
from evogs_codec.jobs.picks import Entries, number_picks, numbered_of, palette_pays, unnumbered_of
from evogs_codec.jobs.plan import Plan, Survey, surveyed
from evogs_codec.jobs.scratch import do_missing, identity_of, partitioned, scratch_folder
from evogs_codec.jobs.stages import code_tile, draw_tile, survey_tile
from evogs_codec.jobs.tile_job import TileJob
from evogs_codec.jobs.tile_tree import Split
from evogs_codec.jobs.up import up_of_tiles
from evogs_codec.jobs.weighed import Weighed
from evogs_codec.lifting.lift import default_levels
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.scene.effort import Effort
from evogs_codec.scene.request import NO_NUMBA, with_generator

if TYPE_CHECKING:
    from evogs_codec.render import Up

__all__ = ["JobOptions", "encode_files"]


@dataclass(frozen=True)
class JobOptions:
    """How files are encoded.

    Attributes:
        levels: of the tree of each tile; None: `default_levels` of the whole scene.
        layers: of precision; None: 2, and the last level may come late (`late_level`).
        up: what is up in views, an axis or a vector; None: what the first file says, or else what
            the splats show.
        effort: as of `encode_scene`.
        per_tile: splats of a tile, about.
        drop_invalid: leave out splats with a NaN or an infinite number.
        palette: as of `encode_scene`.
        info: metadata; None: what the first file says.
    """

    levels: int | None = None
    layers: int | None = None
    up: str | tuple[float, float, float] | None = None
    effort: str | int = "default"
    per_tile: int = PER_TILE
    drop_invalid: bool = False
    palette: Literal["auto", "never"] = "auto"
    info: SceneInfo | None = None


def encode_files(
    paths: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    options: JobOptions | None = None,
    *,
    engine: Engine | None = None,
    scratch: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Up:
    """Write the stream of the splats of some files, with memory for a few tiles alone.

    The bytes are the same for any number of workers, on any engine, in whatever order jobs end and
    files are given, and after a run that was interrupted.

    Args:
        paths: scenes as of `read_scene`, all of one SH degree, which become one.
        out: the stream to make or replace.
        options: how.
        engine: where jobs run; by default in a process for each processor.
        scratch: folder for what is in work, up to 1.5 times the input; by default beside `out`.
            It is deleted at the end, and stays if the run fails.
        resume: go on with what an earlier run of the same files and options left there.
        progress: called with a stage and the part of it that is done.

    Returns:
        What was up in the views.

    Raises:
        InputError: a file cannot be used, workers die again and again, or the scratch folder is of
            another run or not ours.
        NotRepresentableError: values too large for any grid of the format.
        OSError: a disk is full, or `out` cannot be written.
    """
    if find_spec("numba") is None:
        raise InputError(f"scenes of any size are encoded by views: {NO_NUMBA}")
    run = _Run(
        SplatFiles([Path(path) for path in paths], (options or JobOptions()).drop_invalid),
        options or JobOptions(),
        Workers(engine or Engine()),
        Path(f"{os.fspath(out)}.parts") if scratch is None else Path(scratch),
        progress or no_progress,
    )
    with run.scratch(Path(out), resume):
        run.begin()
        with run.workers:
            parts, entries = run.parts()
        merge(parts, Path(out), entries)
    return run.up


@dataclass
class _Run:
    files: SplatFiles
    options: JobOptions
    workers: Workers
    folder: Path
    report: Progress
    partition: Partition = field(init=False)
    up: Up = field(init=False)
    neighbourhoods: dict[int, Split] = field(init=False)

    def scratch(self, out: Path, resume: bool) -> AbstractContextManager[None]:
        """While the run has its scratch folder."""
        options = asdict(replace(self.options, info=None))
        degree = self.files.sh_degree  # files of several are refused before there is a folder
        identity = identity_of(self.files.paths, degree, options, repr(self.options.info))
        outside = [out, *self.files.paths]
        return scratch_folder(self.folder, identity, resume=resume, outside=outside)

    def begin(self) -> None:
        """Make the partition, or find it there, and what is up."""
        per_tile = self.options.per_tile
        distinct = Distinct(self.files.n_declared) if self.options.palette == "auto" else None
        self.partition = partitioned(self.files, self.folder, self.report, per_tile, distinct)
        info = self.options.info or self.files.info
        self.up = up_of_tiles(self.partition, self.options.up, info)
        self.neighbourhoods = self.partition.tree.neighbourhoods()

    def parts(self) -> tuple[list[Path], Entries | None]:
        """The streams of all tiles that have splats, in order, and the entries of a palette."""
        self._draw()
        info = with_generator(self.options.info or self.files.info)
        surveys = self._surveys()
        has_palette = palette_pays(self.partition, surveys)
        plan = Plan.of(self.partition, surveys, self._n_levels, info, has_palette=has_palette)
        tiles = np.flatnonzero(self.partition.counts).tolist()
        while True:
            parts = [self.folder / f"{tile:06d}.{plan.name}.evogs" for tile in tiles]
            calls: list[Call] = [
                (self._job(tile), plan, str(path)) for tile, path in zip(tiles, parts, strict=True)
            ]
            code = self._knowing(code_tile) if plan.coarse is None else code_tile
            too_fine = self._do("encode", code, calls)
            entries = None
            if too_fine is None:
                try:
                    entries = self._entries(plan, parts)
                except TooFineError as error:
                    too_fine = error
            if too_fine is None:
                plan.warn_if_coarser()
                return parts, entries
            plan = plan.with_less_of(too_fine)

    @property
    def _n_levels(self) -> int:
        return self.options.levels or default_levels(int(self.partition.counts.sum()))

    def _draw(self) -> None:
        """Panes of each tile that has splats and is not alone in its neighbourhood."""
        jobs = map(self._job, np.flatnonzero(self.partition.counts).tolist())
        calls: list[Call] = [
            (job, str(panes_of(self.folder, job.tile))) for job in jobs if job.panes
        ]
        self._do("draw", draw_tile, calls)

    def _surveys(self) -> list[Survey]:
        """Of some tiles."""
        tiles = self._surveyed
        paths = [self.folder / f"{tile:06d}.survey" for tile in tiles]
        calls: list[Call] = [
            (self._job(tile), str(path)) for tile, path in zip(tiles, paths, strict=True)
        ]
        self._do("survey", self._knowing(survey_tile), calls)
        return [Survey.read(path) for path in paths]

    @cached_property
    def _surveyed(self) -> list[int]:
        found: list[int] = surveyed(self.partition).tolist()
        return found

    def _entries(self, plan: Plan, parts: Sequence[Path]) -> Entries | None:
        """The palette of the plan, if it has one, when all tiles are encoded; and their picks."""
        if plan.coarse is None:
            return None
        vectors, effort = Vectors.read(vectors_of(self.folder)), Effort.of(self.options.effort)
        picks = [unnumbered_of(part) for part in parts]
        entries = Entries.of(plan, vectors, picks, effort.zstd_level)
        path = self.folder / "entries.npz"
        entries.write(path)
        calls: list[Call] = [
            (str(own), str(path), effort.zstd_level, str(numbered_of(part)))
            for own, part in zip(picks, parts, strict=True)
        ]
        self._do("encode", number_picks, calls)
        return entries

    def _do(
        self, stage: str, function: Callable[..., Any], calls: Sequence[Call]
    ) -> TooFineError | None:
        workers = Workers(Engine("serial")) if self._is_alone else self.workers
        return do_missing(workers, function, calls, self.report, stage)

    def _knowing(self, job: Callable[..., Any]) -> Callable[..., Any]:
        """The job, of one tile with what is known of it."""
        return partial(job, known=self._alone) if self._is_alone else job

    @property
    def _is_alone(self) -> bool:
        """Whether there is one tile. This process does it, so that it is weighed once."""
        is_local = self.workers.engine.name != "dask"
        return is_local and int(np.count_nonzero(self.partition.counts)) == 1

    @cached_property
    def _alone(self) -> Weighed:
        """The one tile."""
        return Weighed.of(self._job(int(np.flatnonzero(self.partition.counts)[0])))

    def _job(self, tile: int) -> TileJob:
        tree = self.partition.tree
        x, y, z = tree.origins[tile].tolist()
        block = np.flatnonzero(tree.blocks == tree.blocks[tile]).tolist()
        offsets = tree.origins[block] - tree.origins[block[0]]
        drawn = str(drawn_of(self.folder, tile)) if tile in self._surveyed else None
        return TileJob(
            rows=str(rows_of(self.folder, tile)),
            sh_degree=self.partition.sh_degree,
            origin=(x, y, z),
            tile=tile,
            block=tuple(
                (other, str(stand_ins_of(self.folder, other)), tuple(offset))
                for other, offset in zip(block, offsets.tolist(), strict=True)
            ),
            panes=tuple(
                (other, str(panes_of(self.folder, other)))
                for other in block
                if other != tile and self.partition.counts[other]
            ),
            split=self.neighbourhoods[int(tree.blocks[tile])],
            n_around=int(self.partition.counts[block].sum()),
            n_levels=self._n_levels,
            n_layers=self.options.layers or N_LAYERS,
            may_be_late=self.options.layers is None,
            up=self.up.vector,
            effort=self.options.effort,
            shares=self.partition.n_vectors > 0,
            n_tiles=int(np.count_nonzero(self.partition.counts)),
            drawn=None if self._is_alone else drawn,
        )
