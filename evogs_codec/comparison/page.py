"""One HTML page of tables and pictures: it needs no server, no script and no network.

All text is escaped; the page may load nothing but the pictures inside it.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from evogs_codec.common.printable import shown
from evogs_codec.io.makers import generator_of
from evogs_codec.render.png import Real, png_bytes

__all__ = ["Bar", "Cell", "Figure", "Gallery", "Notes", "Section", "Table", "html_page"]

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --soft: #5b6675; --line: #d9dfe7;
  --paper: #fff; --band: #f4f6f9; --bar: #cfe0fa; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e9f0; --soft: #97a3b4; --line: #323a46;
  --paper: #14181e; --band: #1c222a; --bar: #27456f; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.5rem 1.25rem 4rem; max-width: 84rem; color: var(--ink);
  background: var(--paper); font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2.6rem 0 .7rem; }
p { margin: .3rem 0; max-width: 60rem; }
.lead, .note, figcaption, footer { color: var(--soft); }
.note, figcaption, footer { font-size: .87rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .38rem .8rem; border-bottom: 1px solid var(--line); text-align: right;
  white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: .2rem; white-space: normal;
  overflow-wrap: anywhere; min-width: 8rem; }
thead th { color: var(--soft); font-weight: 500; vertical-align: bottom; }
td.words, th.words { text-align: left; white-space: normal; min-width: 9rem; }
.wide + .wide, .wide + .row { margin-top: 1.5rem; }
tbody tr:hover { background: var(--band); }
.row { display: grid; gap: .9rem; margin: 0 0 1.4rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 15rem), 1fr)); }
figure { margin: 0; }
figure img { width: 100%; height: auto; display: block; border: 1px solid var(--line);
  border-radius: 4px; background: #fff; }
figcaption { padding: .3rem .1rem 0; overflow-wrap: anywhere; }
figcaption b { color: var(--ink); font-weight: 600; }
details { margin-top: 1rem; } summary { cursor: pointer; color: var(--soft); }
ul { padding-left: 1.2rem; } footer { margin-top: 3.5rem; border-top: 1px solid var(--line);
  padding-top: .8rem; }
@media print { body { max-width: none; } figure, tr { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class Bar:
    """A number of a table with a bar behind it; `share` is its length, of 1."""

    text: str
    share: float


Cell: TypeAlias = "str | Bar"


@dataclass(frozen=True)
class Table:
    """Rows under a head.

    Attributes:
        head: a word for each column.
        rows: cells for each column; the first names the row.
        words: columns that hold text, not numbers, besides the first.
        folded: a title under which the table is hidden until it is asked for; empty: it shows.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    words: frozenset[int] = frozenset()
    folded: str = ""


@dataclass(frozen=True, eq=False)
class Figure:
    """A picture of values 0..1, (H, W, 3), with its name and what is said of it."""

    picture: Real
    name: str
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Gallery:
    """Rows of pictures side by side."""

    rows: Sequence[Sequence[Figure]]


@dataclass(frozen=True)
class Notes:
    """Sentences, one to a line."""

    lines: Sequence[str]


Part: TypeAlias = "Table | Gallery | Notes"


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page: a title, and what is under it; `lead` says what it shows."""

    title: str
    parts: Sequence[Part] = field(default_factory=tuple)
    lead: str = ""


def html_page(
    title: str, lead: str, sections: Sequence[Section], *, command: str, made_with: str
) -> bytes:
    """The page, as it is written to a file.

    Args:
        title: of the page.
        lead: a sentence under it.
        sections: from the top.
        command: which names itself as the maker, as "evogs compare".
        made_with: for the foot, how to make the page again.
    """
    body = "\n".join(_section(section) for section in sections)
    text = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
{generator_of(command)}
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{_safe(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<header><h1>{_safe(title)}</h1><p class="lead">{_safe(lead)}</p></header>
{body}
<footer>{_safe(made_with)}</footer>
</body>
</html>
"""
    return text.encode("utf-8")


def _safe(text: str) -> str:
    """Text for a page; nothing in it is taken for a tag, and nothing moves its reading order."""
    return html.escape(shown(text, None), quote=True)


def _section(section: Section) -> str:
    lead = f'<p class="note">{_safe(section.lead)}</p>' if section.lead else ""
    parts = "\n".join(_part(part) for part in section.parts)
    return f"<section><h2>{_safe(section.title)}</h2>{lead}\n{parts}</section>"


def _part(part: Part) -> str:
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, Gallery):
        return "\n".join(_row(row) for row in part.rows)
    lines = "".join(f"<li>{_safe(line)}</li>" for line in part.lines)
    return f"<ul>{lines}</ul>"


def _table(table: Table) -> str:
    head = "".join(
        f'<th scope="col"{_kind(k in table.words)}>{_safe(word)}</th>'
        for k, word in enumerate(table.head)
    )
    rows = "\n".join(
        "<tr>" + "".join(_cell(cell, k in table.words) for k, cell in enumerate(row)) + "</tr>"
        for row in table.rows
    )
    text = (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table>'
        "</div>"
    )
    if not table.folded:
        return text
    return f"<details><summary>{_safe(table.folded)}</summary>{text}</details>"


def _cell(cell: Cell, is_words: bool) -> str:
    if isinstance(cell, Bar):
        length = 100 * min(max(cell.share, 0.0), 1.0)
        back = f"linear-gradient(to left, var(--bar) {length:.1f}%, transparent 0)"
        return f'<td style="background: {back}">{_safe(cell.text)}</td>'
    return f"<td{_kind(is_words)}>{_safe(cell)}</td>"


def _kind(is_words: bool) -> str:
    return ' class="words"' if is_words else ""


def _row(row: Sequence[Figure]) -> str:
    return f'<div class="row">{"".join(_figure(figure) for figure in row)}</div>'


def _figure(figure: Figure) -> str:
    height, width, _ = figure.picture.shape
    data = base64.b64encode(png_bytes(figure.picture)).decode()
    said = f": {_safe(figure.caption)}" if figure.caption else ""
    return (
        f'<figure><img alt="{_safe(figure.name)}{said}" width="{width}" height="{height}"'
        f' src="data:image/png;base64,{data}">'
        f"<figcaption><b>{_safe(figure.name)}</b>{said}</figcaption></figure>\n"
    )
