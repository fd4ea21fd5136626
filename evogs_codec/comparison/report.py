"""What a stream kept of a scene and what that cost, level by level, as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.common.progress import Progress
from evogs_codec.comparison.compared import ERRORS_HEAD, UNITS_LEAD, decibels, error_rows, number
from evogs_codec.comparison.group_errors import group_errors
from evogs_codec.comparison.likeness import (
    DIFFERENCE_GAIN,
    MAX_PSNR,
    Likeness,
    Look,
    difference,
    evenly,
    look,
)
from evogs_codec.comparison.page import Bar, Cell, Figure, Gallery, Notes, Section, Table, html_page
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.byte_stats import LevelStats, bytes_by_group, levels
from evogs_codec.editing.omissions import omissions
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.components import CORE, PALETTE, PICKS
from evogs_codec.model.splats import I64, SplatParams
from evogs_codec.render import Camera
from evogs_codec.render.framing import background_for

__all__ = ["Encoded", "report_page"]

N_VIEWS = 6  # that levels are measured on, of those given
NAMES = {CORE: "core", PICKS: "picks", PALETTE: "palette"}
Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Encoded:
    """A stream and what it was made of.

    Attributes:
        source: name of the scene.
        n_bytes: of the scene.
        scene: N splats.
        name: of the stream.
        data: the stream.
        notes: what was said meanwhile.
    """

    source: str
    n_bytes: int
    scene: SplatParams
    name: str
    data: bytes
    notes: Sequence[str] = ()


def report_page(
    of: Encoded,
    cameras: Sequence[Camera],
    *,
    views: str,
    command: str,
    made_with: str,
    progress: Progress,
) -> bytes:
    """The page.

    Args:
        of: the stream.
        cameras: at most `N_VIEWS` of them are taken, evenly.
        views: says what cameras these are, for people.
        command: what makes the page.
        made_with: how, for its foot.
        progress: called with a stage and the part of it that is done.

    Raises:
        StreamError: the stream is not legal.
    """
    directory = read_directory(of.data)
    scenes = [of.scene]
    for level in range(directory.n_levels):
        progress("decode levels", level / directory.n_levels)
        cut = Cut.of_level(directory, level)
        scenes.append(decode(of.data, cut, directory=directory).leaves())
    taken = [cameras[k] for k in evenly(len(cameras), N_VIEWS)]
    background = background_for(of.scene)
    seen = look(scenes, taken, background, shown=[len(taken) // 2], progress=progress)
    last = seen.likeness[-1]
    each = len(of.data) / max(len(of.scene), 1)
    lead = (
        f"{len(of.scene):,} splats of {of.source}, {of.n_bytes:,} bytes, in {len(of.data):,} bytes:"
        f" {each:.2f} a splat, {_said(last)}"
    )
    stats = levels(directory)
    sections = [
        Section(
            "Levels",
            [_level_table(directory, stats, seen.likeness[1:]), _gallery(of, stats, seen)],
            f"PSNR and SSIM are means of {len(taken)} {views}, against {of.source}. To move: root"
            " mean square of the way that splats still have to go, in scene units.",
        ),
        Section("Bytes", [_group_table(directory, of.data), _component_table(directory)]),
        *_errors(of, scenes[-1]),
        *_left_out(directory, of.data),
    ]
    if of.notes:
        sections.append(Section("Said meanwhile", [Notes(of.notes)]))
    return html_page(
        f"{of.name}: what was kept, and what it cost",
        lead,
        sections,
        command=command,
        made_with=made_with,
    )


def _said(likeness: Likeness) -> str:
    if likeness.is_equal:
        return "with the same pictures"
    return f"at {decibels(likeness.mean_psnr)} dB, SSIM {likeness.mean_ssim:.4f}"


# --- levels ---------------------------------------------------------------------------------------


def _level_table(
    directory: Directory, stats: Sequence[LevelStats], likeness: Sequence[Likeness]
) -> Table:
    head = ("level", "adds", "splats", "bytes", "so far", "of all", "to move", "PSNR", "SSIM")
    size = max(directory.size, 1)
    so_far = directory.data_offset
    rows: list[list[Cell]] = []
    for one, like in zip(stats, likeness, strict=True):
        so_far += one.n_bytes
        rows.append(
            [
                str(one.level),
                one.adds,
                f"{one.n_leaves:,}",
                Bar(f"{one.n_bytes:,}", one.n_bytes / size),
                f"{so_far:,}",
                f"{100 * so_far / size:.1f} %",
                "unknown" if np.isnan(one.error) else number(one.error),
                decibels(like.mean_psnr),
                f"{like.mean_ssim:.4f}",
            ]
        )
    return Table(head, rows, words=frozenset({1}))


def _gallery(of: Encoded, stats: Sequence[LevelStats], seen: Look) -> Gallery:
    """A picture of each level, then the scene and where the last level differs."""
    (view,) = seen.shown
    pictures = [mine[0] for mine in seen.pictures]
    figures = []
    for one, picture, like in zip(stats, pictures[1:], seen.likeness[1:], strict=True):
        said = decibels(like.psnr[view]) + (" dB" if like.psnr[view] < MAX_PSNR else "")
        figures.append(Figure(picture, f"level {one.level}", f"{one.n_leaves:,} splats, {said}"))
    figures += [
        Figure(pictures[0], of.source),
        Figure(
            difference(pictures[-1], pictures[0]),
            "difference",
            f"last level, {DIFFERENCE_GAIN} times as large: white where it is equal",
        ),
    ]
    return Gallery([figures])


# --- bytes ----------------------------------------------------------------------------------------


def _group_table(directory: Directory, data: bytes) -> Table:
    parts = bytes_by_group(directory, memoryview(data))
    n = max(levels(directory)[-1].n_leaves, 1)
    rows: list[list[Cell]] = []
    for name, part in parts.items():
        over = f"{100 * (part.n_bytes / part.entropy - 1):+.1f} %" if part.entropy else ""
        share = part.n_bytes / directory.size
        row: list[Cell] = [name, Bar(f"{part.n_bytes:,.0f}", share), f"{100 * share:.1f} %"]
        rows.append([*row, f"{part.n_bytes / n:.3f}", over])
    return Table(("planes of", "bytes", "of all", "a splat", "over order-0"), rows)


def _component_table(directory: Directory) -> Table:
    """Bytes of the packets of each component, per level."""
    rows, numbers = directory.packets, directory.components.numbers
    sizes: dict[int, I64] = {}
    for component in numbers:
        mine = rows["component"] == component
        sums = np.bincount(
            directory.labels[mine], rows["size"][mine].astype(np.float64), directory.n_levels
        )
        sizes[component] = sums.astype(np.int64)
    head = ["bytes of packets", *(NAMES.get(k, f"SH band {k}") for k in numbers)]
    table = [
        [f"level {level}", *(f"{sizes[k][level]:,}" for k in numbers)]
        for level in range(directory.n_levels)
    ]
    table.append(["all", *(f"{int(sizes[k].sum()):,}" for k in numbers)])
    return Table(head, table)


# --- what is not as it was ------------------------------------------------------------------------


def _errors(of: Encoded, decoded: SplatParams) -> list[Section]:
    rows = error_rows([of.name], [group_errors(decoded, of.scene)])
    if not rows:
        return []
    table = Table(ERRORS_HEAD, rows, words=frozenset({len(ERRORS_HEAD) - 1}))
    return [Section("Errors per group", [table], UNITS_LEAD)]


def _left_out(directory: Directory, data: bytes) -> list[Section]:
    """What the stream could hold and does not."""
    rows = [
        [
            one.part,
            ", ".join(map(str, one.levels)),
            "unknown" if one.change is None else number(one.change),
            one.reason,
        ]
        for one in omissions(directory, memoryview(data))
    ]
    if not rows:
        return []
    table = Table(("part", "levels", "change", "why"), rows, words=frozenset({3}))
    return [Section("Left out", [table], "Changes are root mean squares, in units of the part.")]
