"""The command line of conformance/README.md, for the decoders of this package and of `mutants`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from conformance.decoders.outcomes import Run

__all__ = ["CAPABILITIES", "MODES", "add_options", "run_of_request"]

MODES = ["file", "progressive"]
CAPABILITIES = {  # all there are; a decoder adds its name
    "version": "1.0-draft 5",
    "modes": MODES,
    "codes": True,
    "verify": True,
    "limits": True,
    "arrival": True,
    "dump_on_fault": True,
    "batch": True,
    "max_tier": 3,
    "max_sh_degree": 3,
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of the contract."""
    parser.add_argument("--in", dest="source", type=Path, metavar="FILE")
    parser.add_argument("--out", dest="target", type=Path, metavar="OUT")
    parser.add_argument("--mode", choices=MODES, default="file")
    parser.add_argument("--level", type=int, metavar="K", help="cut by level K")
    parser.add_argument("--limits", type=Path, metavar="FILE.json", help="limits by name")
    parser.add_argument("--verify", action="store_true", help="check digests")
    parser.add_argument("--arrival", type=Path, metavar="FILE.json", help="[[offset, size], ...]")
    parser.add_argument("--dump-on-fault", action="store_true", help="OUT has a dump then too")
    parser.add_argument("--capabilities", action="store_true", help="print them and end")
    parser.add_argument("--batch", action="store_true", help="a JSON request per line of input")


def run_of_request(request: Mapping[str, Any]) -> Run:
    """The run that a line of a batch asks for, or the options of a command line as a dictionary."""
    arrival = _json(request.get("arrival"))
    return Run(
        request["mode"],
        request.get("level"),
        _json(request.get("limits")),
        request.get("verify", False),
        None if arrival is None else tuple((at, size) for at, size in arrival),
        request.get("dump_on_fault", False),
    )


def _json(path: str | Path | None) -> Any:  # noqa: ANN401 - limits, or ranges
    return None if path is None else json.loads(Path(path).read_bytes())
