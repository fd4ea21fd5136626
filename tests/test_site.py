"""The pages as a site: whole, and no link is broken."""

import re
from pathlib import Path

import pytest

from tools import site

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def collected(tmp_path_factory):
    pages = tmp_path_factory.mktemp("pages")
    return pages, site.collect(pages)


def test_every_page_and_picture_that_links_lead_to_is_collected(collected):
    pages, found = collected
    assert {path.relative_to(ROOT) for path in (ROOT / "docs").glob("*.md")} <= {*found}
    assert Path("spec/evogs.md") in found
    assert Path("docs/figures/stream.gif") in found
    assert all((pages / path).is_file() for path in found)
    page = (pages / "docs" / "README.md").read_text(encoding="utf-8")
    assert "](../spec/decisions/README.md)" in page  # a folder, which a site has no page for
    decisions = (pages / "spec" / "decisions" / "README.md").read_text(encoding="utf-8")
    assert len(re.findall(r"^- \[.+\]\(.+\.md\)$", decisions, re.MULTILINE)) >= 10


def test_every_page_of_the_documentation_is_in_the_menu(collected):
    sections = [(title, pages) for part in site.menu() for title, pages in part.items()]
    assert [title for title, _ in sections][:3] == ["Start", "Use", "The format"]
    listed = {Path(page) for _, pages in sections for page in pages}
    assert {path for path in collected[1] if path.parent == Path("docs")} - listed == {
        path for path in collected[1] if path.parent == Path("docs") and path.suffix != ".md"
    }
    assert all(pages for _, pages in sections)


def test_a_link_that_leads_to_nothing_is_refused(tmp_path, monkeypatch):
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("# A\n\n[gone](docs/gone.md)\n")
    (tmp_path / "docs" / "README.md").write_text("# B\n")
    monkeypatch.setattr(site, "ROOT", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"README\.md links to docs/gone\.md"):
        site.collect(tmp_path / "pages")


@pytest.mark.thorough
def test_the_site_is_built_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="it builds the site")
    assert site.main([str(tmp_path / "site")]) == 0
    for name in ("index.html", "docs/api.html", "spec/evogs.html", "docs/figures/stream.gif"):
        assert (tmp_path / "site" / name).is_file()
    page = (tmp_path / "site" / "docs" / "command-line.html").read_text(encoding="utf-8")
    assert 'href="interchange.html"' in page
    assert not re.search(r'(?:src|<link[^>]* href)="https?:', page)  # it asks nobody for anything


@pytest.mark.thorough
def test_a_broken_anchor_stops_the_build(tmp_path, monkeypatch):
    pytest.importorskip("mkdocs", reason="it builds the site")
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("# A\n\n[B](docs/README.md#no-such)\n")
    (tmp_path / "docs" / "README.md").write_text("# B\n")
    monkeypatch.setattr(site, "ROOT", tmp_path)
    assert site.main([str(tmp_path / "site")]) == 1
