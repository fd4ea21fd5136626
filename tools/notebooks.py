"""Run the notebooks of docs/notebooks and write them again, with what they print and draw.

python -m tools.notebooks
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import nbformat
from nbclient import NotebookClient

COMMAND = "python -m tools.notebooks"
FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
TIMEOUT = 280  # seconds for a cell: the first that renders compiles


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all notebooks in their places; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog=COMMAND, description=__doc__.split("\n")[0], epilog="It needs the extra dev."
    )
    parser.parse_args(arguments)
    for path in sorted(FOLDER.glob("*.ipynb")):
        nbformat.write(executed(path), path)
        print(f"{path}: {path.stat().st_size:,} bytes")
    return 0


def executed(path: Path) -> nbformat.NotebookNode:
    """A notebook after a run, without what differs from run to run or machine to machine.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell failed.
    """
    book = nbformat.read(path, as_version=4)
    NotebookClient(book, timeout=TIMEOUT, kernel_name="python3").execute()
    book.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in book.cells:
        cell.metadata = {}
        if cell.cell_type == "code":
            cell.outputs = [one for one in cell.outputs if one.get("name") != "stderr"]
    return book


if __name__ == "__main__":
    sys.exit(main())
