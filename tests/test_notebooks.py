"""The notebooks: small, without what is of one machine, and they run."""

import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_small_and_names_no_machine(path):
    text = path.read_text(encoding="utf-8")
    assert len(text) < 100_000
    book = json.loads(text)
    code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert not [one for one in outputs if one["output_type"] == "error" or "stderr" in one.values()]
    assert any("image/png" in one.get("data", {}) for one in outputs)
    assert not re.search(r"/(home|tmp|root|Users)/", text)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_what_a_notebook_links_to_is_there(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    text = "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert links
    assert all((path.parent / link).exists() for link in links)


@pytest.mark.thorough
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
# A kernel is a process of its own, which talks to this one over this machine's network.
@pytest.mark.filterwarnings("default")
def test_a_notebook_runs_and_prints_what_it_did(path):
    for name in ("nbclient", "ipykernel", "matplotlib", "numba"):
        pytest.importorskip(name, reason="the notebook needs it")
    from tools.notebooks import executed

    def printed(cells):
        return [
            "".join(output["text"])
            for cell in cells
            for output in cell.get("outputs", [])
            if output["output_type"] == "stream"
        ]

    before = printed(json.loads(path.read_text(encoding="utf-8"))["cells"])
    after = printed(executed(path).cells)
    words = [re.sub(r"[\d.,]+", "0", text) for text in before]
    assert words == [re.sub(r"[\d.,]+", "0", text) for text in after]
    assert len(words) >= 2
