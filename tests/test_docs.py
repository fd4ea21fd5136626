"""What the pages say to run runs, and what they link to is there."""

import csv
import io
import re
import shlex
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from conformance.harness.cli import VECTORS
from conformance.harness.reporting.explain import explain
from evogs_codec import encode_scene, write_ply
from evogs_codec.cli.commands import main as evogs
from evogs_codec.render.demo_scene import main as make_demo
from evogs_codec.render.demo_scene import make_scene
from tests.support.view_sizes import SMALL, views_of

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "conformance").glob("*.md"),
    *(ROOT / "spec").rglob("*.md"),
]
FAST_SCENE = ["--splats", "8000"]  # of 40,000


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


@pytest.mark.thorough
def test_the_examples_of_the_api_page_run(tmp_path, monkeypatch):
    found = blocks((ROOT / "docs" / "api.md").read_text(encoding="utf-8"), "python")
    assert len(found) >= 5
    write_ply(tmp_path / "scene.ply", make_scene(8000))
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(found), "docs/api.md", "exec"), {})


@pytest.mark.thorough
def test_the_examples_of_the_page_on_cuts_run(tmp_path, monkeypatch):
    found = blocks((ROOT / "docs" / "choosing-a-cut.md").read_text(encoding="utf-8"), "python")
    assert len(found) == 6
    monkeypatch.chdir(tmp_path)
    write_ply(tmp_path / "scene.ply", make_scene(3000, 4))
    assert evogs(["encode", "scene.ply", "scene.evogs", "--tiles", "4", "--levels", "5"]) == 0
    names: dict[str, Any] = {}
    exec(compile("\n".join(found), "docs/choosing-a-cut.md", "exec"), names)
    assert 0 < names["level"] < 5
    assert 0 < names["enough"] < 5
    assert len({tuple(row) for row in names["sharp"].steps.tolist()}) > 1


def test_the_example_of_the_page_on_edits_runs(tmp_path, monkeypatch):
    (found,) = blocks((ROOT / "docs" / "editing.md").read_text(encoding="utf-8"), "python")
    monkeypatch.chdir(tmp_path)
    scene = make_scene(300)
    write_ply(tmp_path / "scene.ply", scene)
    Path("scene.evogs").write_bytes(encode_scene(scene, preset="scene", cameras=(), effort=1))
    exec(compile(found, "docs/editing.md", "exec"), {})


def run_the_readme():
    """All that it says, with small views: what is tested is that it runs."""
    with views_of(SMALL):
        _run_the_readme()


def _run_the_readme():
    lines = next(block for block in blocks(README, "") if "pip install" in block).splitlines()
    assert len(lines) == 10
    for line in lines[1:]:
        words = shlex.split(line, comments=True)
        if words[0] == "python":
            assert words[1:3] == ["-m", "evogs_codec.render.demo_scene"]
            make_demo([*words[3:], *FAST_SCENE])
        else:
            assert words[0] == "evogs"
            assert evogs(words[1:]) == 0, line
    (program,) = blocks(README, "python")
    assert len([line for line in program.splitlines() if line]) == 5
    exec(compile(program, "README.md", "exec"), {})


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Where the commands and the Python of the README ran once, and what they printed."""
    pytest.importorskip("numba", reason="the rasterizer is compiled")
    folder, said = tmp_path_factory.mktemp("readme"), io.StringIO()
    with chdir(folder), redirect_stdout(said):
        run_the_readme()
    return folder, said.getvalue()


@pytest.mark.thorough
def test_the_commands_and_the_python_of_the_readme_run(ran):
    folder, said = ran
    assert "splats" in said
    assert (folder / "prefix.ply").is_file()


@pytest.mark.thorough
def test_they_run_a_second_time_over_what_they_made(ran, monkeypatch):
    folder, _ = ran
    monkeypatch.chdir(folder)
    made = {path.name: path.read_bytes() for path in folder.iterdir()}
    run_the_readme()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == made


def test_the_readme_is_short_and_begins_with_its_two_commands():
    assert len(README.splitlines()) <= 90
    first = blocks(README, "")[0]
    assert re.findall(r"^make ([a-z-]+)", first, re.MULTILINE) == ["demo", "test"]


def test_every_target_that_a_page_names_is_in_the_makefile():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"^make ([a-z-]+)", text, re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_links_to_is_there(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not link.startswith(("http:", "https:", "mailto:", "#")):
            assert (page.parent / link.partition("#")[0]).exists(), link


def test_files_and_tests_that_the_pages_name_are_there():
    tops = "evogs_codec|conformance|reference_trainer|tools|tests|docs|spec"
    tests = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    for page in PAGES:
        if page.name == "CHANGELOG.md" or page.parent.name == "decisions":  # files that were
            continue
        text = page.read_text(encoding="utf-8")
        for name in re.findall(rf"`((?:{tops})/[\w./*-]*)`", text):
            if "NAME" not in name:
                assert list(ROOT.glob(name)), f"{page.name}: {name}"
        if page.name == "CONTRIBUTING.md":
            assert all(f"def {name}(" in tests for name in re.findall(r"`(test_\w+)`", text))


def test_every_page_is_in_the_index():
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert f"({page.name})" in index or page.name == "README.md", page.name


def test_vectors_that_the_pages_explain_are_there():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    text += (ROOT / "conformance" / "harness" / "cli.py").read_text(encoding="utf-8")
    ids = re.findall(r"conformance explain ([a-z][a-z0-9@-]+)(?![a-z0-9@.-])", text)
    ids += re.findall(r"a case: ([a-z0-9@-]+)", text)
    assert len(ids) >= 2
    for name in ids:
        assert explain(VECTORS, name), name


def tables_of(text):
    """The rows of each table of a page, its head first."""
    found, before = [], ""
    for line in text.splitlines():
        cells = [cell.strip() for cell in line[1:-1].split("|")]
        if line.startswith("|---"):
            found.append([[cell.strip() for cell in before[1:-1].split("|")]])
        elif line.startswith("|") and before.startswith("|"):
            found[-1].append(cells)
        before = line
    return found


def test_files_of_figures_are_the_tables_of_the_page():
    tables = tables_of((ROOT / "docs" / "figures.md").read_text(encoding="utf-8"))
    paths = sorted((ROOT / "docs" / "figures").glob("*.csv"))
    assert len(paths) > 20
    for path in paths:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [[cell.strip() for cell in row] for row in csv.reader(file)]
        assert rows in tables, path.name
