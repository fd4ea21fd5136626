"""The pages as a site: `make docs` builds it into build/site with MkDocs; a broken link stops it.

    python -m tools.site build/site

Pages, pictures and other files are collected by following links from README.md and docs/README.md,
and keep their places to each other, so that links work as they do in a checkout. The sections of
the menu are those of docs/README.md.
"""

from __future__ import annotations

import argparse
import logging
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FIRST = (Path("README.md"), Path("docs/README.md"))
CODE = re.compile(r"```.*?```", re.DOTALL)
LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]*)?\)")
ELSEWHERE = ("http:", "https:", "mailto:")


def main(arguments: list[str] | None = None) -> int:
    """Build the site; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.site")
    parser.add_argument("out", type=Path, help="the folder to make or replace")
    out = parser.parse_args(arguments).out.resolve()
    from mkdocs.commands.build import build
    from mkdocs.config import load_config
    from mkdocs.exceptions import Abort

    logging.basicConfig(format="%(message)s", level=logging.WARNING)  # why a build is refused
    with tempfile.TemporaryDirectory(prefix="evogs-site-") as folder:
        pages = Path(folder) / "pages"
        collect(pages)
        config = Path(folder) / "mkdocs.yml"
        config.touch()
        try:
            build(load_config(str(config), **settings(pages, out)))
        except Abort as error:
            print(error, file=sys.stderr)
            return 1
    return 0


def settings(pages: Path, out: Path) -> dict[str, Any]:
    """Those of MkDocs: every doubt about a link is a warning, and every warning an error."""
    from markdown.extensions.toc import slugify_unicode

    doubts = ("not_found", "absolute_links", "unrecognized_links", "anchors")
    return {
        "site_name": "EvoGS",
        "docs_dir": str(pages),
        "site_dir": str(out),
        "theme": {"name": "readthedocs", "highlightjs": False},
        "use_directory_urls": False,  # so that it opens from a disk
        "strict": True,
        "validation": {"links": dict.fromkeys(doubts, "warn"), "nav": {"not_found": "warn"}},
        "markdown_extensions": ["sane_lists", {"toc": {"slugify": slugify_unicode}}],
        "nav": menu(),
    }


def collect(pages: Path) -> list[Path]:
    """Copy all that links lead to; returns the files, as paths in the checkout.

    Raises:
        FileNotFoundError: a link leads to nothing.
    """
    found: list[Path] = []
    waiting = list(FIRST)
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.append(path)
        target = pages / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix != ".md":
            shutil.copyfile(ROOT / path, target)
            continue
        text, linked = _page(path)
        target.write_text(text, encoding="utf-8")
        waiting += linked
    return found


def menu() -> list[dict[str, Any]]:
    """The sections of docs/README.md with their pages, whose titles MkDocs takes from the pages."""
    sections: list[dict[str, Any]] = [{"Start": [str(path) for path in FIRST]}]
    for line in (ROOT / FIRST[1]).read_text(encoding="utf-8").splitlines():
        title = re.match(r"\| \*\*(.+)\*\* \|", line)
        if title:
            sections.append({title[1]: []})
        for link, _ in LINK.findall(line):
            path = _resolved(FIRST[1], link)
            if (ROOT / path).is_dir():
                path = path / "README.md"
            if path.suffix == ".md":
                sections[-1][next(iter(sections[-1]))].append(str(path))
    return sections


def _page(path: Path) -> tuple[str, list[Path]]:
    """The text of a page, and the files it links to; a folder gets a page that lists its pages."""
    if path.name == "README.md" and not (ROOT / path).exists():
        inside = sorted((ROOT / path.parent).glob("*.md"))
        rows = [f"- [{_title(one)}]({one.name})" for one in inside]
        text = "\n".join([f"# {path.parent.name.capitalize()}", "", *rows, ""])
        return text, [path.parent / one.name for one in inside]
    text = (ROOT / path).read_text(encoding="utf-8")
    linked = []
    for link, anchor in LINK.findall(CODE.sub("", text)):
        if link.startswith(ELSEWHERE):
            continue
        at = _resolved(path, link)
        if not (ROOT / at).exists():
            raise FileNotFoundError(f"{path} links to {link}, which is not there")
        if (ROOT / at).is_dir():
            text = text.replace(f"]({link}{anchor})", f"]({link.rstrip('/')}/README.md)")
            at = at / "README.md"
        linked.append(at)
    return text, linked


def _resolved(page: Path, link: str) -> Path:
    """Where a link of a page leads, from the root of the checkout."""
    return (ROOT / page.parent / link).resolve().relative_to(ROOT)


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


if __name__ == "__main__":
    sys.exit(main())
