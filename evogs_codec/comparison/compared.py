"""Scenes compared with a reference: bytes, likeness of views, errors per group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from evogs_codec.common.progress import Progress
from evogs_codec.comparison.group_errors import GroupErrors, group_errors
from evogs_codec.comparison.likeness import (
    DIFFERENCE_GAIN,
    MAX_PSNR,
    Look,
    difference,
    evenly,
    look,
)
from evogs_codec.comparison.page import Bar, Figure, Gallery, Section, Table, html_page
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.splats import SplatParams
from evogs_codec.render import Camera

__all__ = [
    "ERRORS_HEAD",
    "UNITS_LEAD",
    "Compared",
    "Subject",
    "as_json",
    "as_page",
    "as_text",
    "compare",
    "decibels",
    "error_rows",
    "number",
]

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene that is compared.

    Attributes:
        name: for people, different from that of the others.
        format: of the file.
        n_bytes: that hold it.
        splats: N splats.
    """

    name: str
    format: str
    n_bytes: int
    splats: SplatParams

    @property
    def bytes_per_splat(self) -> float:
        """Of a scene without splats, its bytes."""
        return self.n_bytes / max(len(self.splats), 1)


@dataclass(frozen=True, eq=False)
class Compared:
    """What is known of scenes, the first of which is the reference.

    Attributes:
        subjects: the scenes.
        look: their views.
        errors: per scene against the reference, in groups; None of the reference, and where one has
            no splats.
        views: says what views, for people.
    """

    subjects: tuple[Subject, ...]
    look: Look
    errors: tuple[GroupErrors | None, ...]
    views: str


def compare(
    subjects: Sequence[Subject],
    cameras: Sequence[Camera],
    background: Colour,
    *,
    views: str,
    n_shown: int,
    progress: Progress,
) -> Compared:
    """Compare scenes with the first of them.

    Args:
        subjects: the reference, and others.
        cameras: of the views, at least one.
        background: behind the splats.
        views: says what views these are, for people.
        n_shown: views whose pictures are kept.
        progress: called with a stage and the part of it that is done.
    """
    scenes = [subject.splats for subject in subjects]
    seen = look(scenes, cameras, background, shown=evenly(len(cameras), n_shown), progress=progress)
    errors = [None, *(group_errors(scene, scenes[0]) for scene in scenes[1:])]
    return Compared(tuple(subjects), seen, tuple(errors), views)


# --- as text --------------------------------------------------------------------------------------


def decibels(value: float) -> str:
    """A PSNR for people."""
    return "equal" if value >= MAX_PSNR else f"{value:.2f}"


def number(value: float) -> str:
    """A number for people, of three digits."""
    return "0" if value == 0 else f"{value:.3g}"


SUMMARY = (
    "file", "format", "bytes", "a splat", "splats", "SH", "PSNR", "least", "SSIM", "least"
)  # fmt: skip


def _summary(found: Compared) -> list[list[str]]:
    rows = []
    for k, (subject, likeness) in enumerate(zip(found.subjects, found.look.likeness, strict=True)):
        rows.append(
            [
                subject.name,
                subject.format,
                f"{subject.n_bytes:,}",
                f"{subject.bytes_per_splat:.2f}",
                f"{len(subject.splats):,}",
                f"{subject.splats.sh_degree}",
                *(
                    (
                        decibels(likeness.mean_psnr),
                        decibels(min(likeness.psnr)),
                        f"{likeness.mean_ssim:.4f}",
                        f"{min(likeness.ssim):.4f}",
                    )
                    if k
                    else ("reference", "", "", "")
                ),
            ]
        )
    return rows


ERRORS_HEAD = (
    "errors, RMS (largest)",
    *("SH" if name == "sh" else name for name in GROUPS),
    "corresponding",
)


def error_rows(names: Sequence[str], errors: Sequence[GroupErrors | None]) -> list[list[str]]:
    """A row of a table for each scene that has errors."""
    rows = []
    for name, found in zip(names, errors, strict=True):
        if found is not None:
            cells = [f"{number(one.rms)} ({number(one.largest)})" for one in found.groups]
            rows.append([name, *cells, found.matching])
    return rows


def as_text(found: Compared) -> str:
    """Tables for a terminal."""
    names = [subject.name for subject in found.subjects]
    tables = [(SUMMARY, _summary(found)), (ERRORS_HEAD, error_rows(names, found.errors))]
    texts = [_columns(head, rows) for head, rows in tables if rows]
    units = "position in scene units, rotation in degrees, scale as ln, opacity of 1"
    return "\n\n".join([*texts, f"{units}\nviews: {found.views}"])


def _columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lines whose columns are as wide as they need to be; the first is at the left."""
    widths = [max(len(line[k]) for line in [head, *rows]) for k in range(len(head))]
    lines = []
    for line in [head, *rows]:
        cells = [cell.rjust(width) for cell, width in zip(line, widths, strict=True)]
        lines.append("  ".join([line[0].ljust(widths[0]), *cells[1:]]).rstrip())
    return "\n".join(lines)


# --- as JSON --------------------------------------------------------------------------------------


def as_json(found: Compared) -> dict[str, Any]:
    """For JSON; the PSNR of equal pictures is null."""
    rows = []
    for k, subject in enumerate(found.subjects):
        likeness, errors = found.look.likeness[k], found.errors[k]
        row: dict[str, Any] = {
            "file": subject.name,
            "format": subject.format,
            "bytes": subject.n_bytes,
            "bytes_per_splat": round(subject.bytes_per_splat, 3),
            "splats": len(subject.splats),
            "sh_degree": subject.splats.sh_degree,
        }
        if k:
            row |= {
                "psnr": _or_none(likeness.mean_psnr),
                "ssim": likeness.mean_ssim,
                "views": [
                    {"psnr": _or_none(p), "ssim": s}
                    for p, s in zip(likeness.psnr, likeness.ssim, strict=True)
                ],
                "errors": errors and asdict(errors),
            }
        rows.append(row)
    return {"reference": rows[0], "compared": rows[1:], "views": found.views}


def _or_none(value: float) -> float | None:
    return None if value >= MAX_PSNR else value


# --- as a page ------------------------------------------------------------------------------------


def as_page(found: Compared, *, command: str, made_with: str) -> bytes:
    """A page of HTML; `command` is what makes it, `made_with` says how, for its foot."""
    names = [subject.name for subject in found.subjects]
    others = " and ".join(names[1:]) if len(names) < 4 else f"{len(names) - 1} files"
    sections = [
        Section("Files", [_files_table(found)], lead=f"Views: {found.views}."),
        Section("Views", [_gallery(found), *_view_tables(found)], lead=_gallery_lead()),
    ]
    rows = error_rows(names, found.errors)
    if rows:
        table = Table(ERRORS_HEAD, rows, words=frozenset({len(ERRORS_HEAD) - 1}))
        sections.insert(1, Section("Errors per group", [table], lead=UNITS_LEAD))
    return html_page(
        f"{others} against {names[0]}",
        f"{len(found.look.likeness[0].psnr)} views, {len(found.subjects)} files",
        sections,
        command=command,
        made_with=made_with,
    )


UNITS_LEAD = (
    "Root mean square, and the largest: distance of positions in scene units; degrees of the turn"
    " from one ellipsoid to the other, whatever its axes are called; natural logarithm of scales;"
    " opacity of 1; SH coefficients."
)


def _files_table(found: Compared) -> Table:
    largest = max(subject.n_bytes for subject in found.subjects)
    rows: list[list[str | Bar]] = []
    for row, subject in zip(_summary(found), found.subjects, strict=True):
        cells: list[str | Bar] = [*row]
        cells[2] = Bar(row[2], subject.n_bytes / max(largest, 1))
        rows.append(cells)
    return Table(SUMMARY, rows, words=frozenset({1}))


def _gallery_lead() -> str:
    return (
        f"Each picture beside its difference to the first, {DIFFERENCE_GAIN} times as large:"
        " white where they are equal."
    )


def _gallery(found: Compared) -> Gallery:
    rows = []
    for place, view in enumerate(found.look.shown):
        reference = found.look.pictures[0][place]
        row = [Figure(reference, found.subjects[0].name, f"view {view}")]
        for k, subject in enumerate(found.subjects[1:], 1):
            picture, likeness = found.look.pictures[k][place], found.look.likeness[k]
            said = f"{decibels(likeness.psnr[view])} dB, SSIM {likeness.ssim[view]:.4f}"
            said = "equal" if likeness.psnr[view] >= MAX_PSNR else said
            row.append(Figure(picture, subject.name, f"view {view}, {said}"))
            shown = difference(picture, reference)
            row.append(Figure(shown, "difference", f"{subject.name}, {DIFFERENCE_GAIN} times"))
        rows.append(row)
    return Gallery(rows)


def _view_tables(found: Compared) -> list[Table]:
    n_views = len(found.look.likeness[0].psnr)
    tables = []
    for what in ("PSNR", "SSIM"):
        rows = [
            [
                str(view),
                *(
                    decibels(one.psnr[view]) if what == "PSNR" else f"{one.ssim[view]:.4f}"
                    for one in found.look.likeness[1:]
                ),
            ]
            for view in range(n_views)
        ]
        head = ["view", *(subject.name for subject in found.subjects[1:])]
        tables.append(Table(head, rows, folded=f"{what} of every view"))
    return tables
