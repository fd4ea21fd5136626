"""A mutant behind the command of a decoder under test (conformance/README.md)."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from conformance.decoders import oracle
from conformance.decoders.outcomes import Outcome, Run
from conformance.mutants.library import MUTANTS
from conformance.mutants.mutant import load
from conformance.mutants.trial import CRASH, limit_memory, outcome

__all__ = ["serve"]

MODES = ["file", "progressive"]
CAPABILITIES = {
    "version": "1.0-draft 2",
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


def serve(arguments: Sequence[str]) -> int:
    """Decode as the mutant NAME does, or as the oracle if that is the name; returns the exit."""
    parser = argparse.ArgumentParser(prog="python -m conformance.mutants run", description=__doc__)
    parser.add_argument("name", metavar="NAME", choices=["oracle", *(m.name for m in MUTANTS)])
    parser.add_argument("--in", dest="source", metavar="FILE")
    parser.add_argument("--out", dest="target", metavar="OUT")
    parser.add_argument("--mode", choices=MODES, default="file")
    parser.add_argument("--level", type=int)
    parser.add_argument("--limits", metavar="FILE.json")
    parser.add_argument("--verify", action="store_true")
    parser.add_argument("--arrival", metavar="FILE.json")
    parser.add_argument("--dump-on-fault", action="store_true")
    parser.add_argument("--capabilities", action="store_true")
    parser.add_argument("--batch", action="store_true")
    args = vars(parser.parse_args(arguments))
    named = {mutant.name: mutant for mutant in MUTANTS}
    module = load(named[args["name"]]) if args["name"] in named else oracle
    if args["capabilities"]:
        print(json.dumps({"name": args["name"]} | CAPABILITIES))
        return 0
    limit_memory()
    if args["batch"]:
        for line in sys.stdin:
            entry = json.loads(line)
            came = _answer(module, entry | {"source": entry["in"], "target": entry["out"]})
            reply = {"id": entry["id"], "exit": came.exit} | came.fault()
            print(json.dumps(reply), flush=True)
        return 0
    came = _answer(module, args)
    if came.code is not None:
        print(json.dumps(came.fault()))
    return came.exit


def _answer(module: ModuleType, request: Mapping[str, Any]) -> Outcome:
    """Decode, and write the dump if there is one; a mutant that crashes takes its process along."""
    arrival = _json(request.get("arrival"))
    run = Run(
        request.get("mode", "file"),
        request.get("level"),
        _json(request.get("limits")),
        bool(request.get("verify")),
        None if arrival is None else tuple((at, size) for at, size in arrival),
        bool(request.get("dump_on_fault")),
    )
    came = outcome(module, Path(request["source"]).read_bytes(), run)
    if came == CRASH:
        os.abort()
    if came.dump is not None:
        Path(request["target"]).write_bytes(came.dump)
    return came


def _json(path: str | None) -> Any:  # noqa: ANN401 - what a file says
    return None if path is None else json.loads(Path(path).read_bytes())
