"""The examples of docs/api.md run, in order, as one program."""

import re
from pathlib import Path

import pytest

from conformance.harness.cli import VECTORS
from conformance.harness.reporting.explain import explain
from evogs_codec import write_ply
from evogs_codec.render.demo_scene import make_scene

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.thorough
def test_the_examples_of_the_api_page_run(tmp_path, monkeypatch):
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) >= 5
    write_ply(tmp_path / "scene.ply", make_scene(3000))
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(blocks), "docs/api.md", "exec"), {})


def test_vectors_that_the_pages_explain_are_there():
    pages = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("conformance/*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    text += (ROOT / "conformance" / "harness" / "cli.py").read_text(encoding="utf-8")
    ids = re.findall(r"conformance explain ([a-z][a-z0-9@-]+)(?![a-z0-9@.-])", text)
    ids += re.findall(r"a case: ([a-z0-9@-]+)", text)
    assert len(ids) >= 2
    for name in ids:
        assert explain(VECTORS, name), name


def test_every_command_of_the_readme_is_a_target_or_a_command():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^make ([a-z-]+)", text, re.MULTILINE)
    assert {"demo", "test"} <= set(targets)
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)
