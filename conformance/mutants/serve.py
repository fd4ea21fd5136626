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
from conformance.decoders.contract import CAPABILITIES, add_options, run_of_request
from conformance.decoders.outcomes import Outcome
from conformance.mutants.library import MUTANTS
from conformance.mutants.mutant import load
from conformance.mutants.trial import CRASH, limit_memory, outcome

__all__ = ["serve"]


def serve(arguments: Sequence[str]) -> int:
    """Decode as the mutant NAME does, or as the oracle if that is the name; returns the exit."""
    parser = argparse.ArgumentParser(prog="python -m conformance.mutants run", description=__doc__)
    parser.add_argument("name", metavar="NAME", choices=["oracle", *(m.name for m in MUTANTS)])
    add_options(parser)
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
    came = outcome(module, Path(request["source"]).read_bytes(), run_of_request(request))
    if came == CRASH:
        os.abort()
    if came.dump is not None:
        Path(request["target"]).write_bytes(came.dump)
    return came
