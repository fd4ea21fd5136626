"""A bad decoder: `python __main__.py NAME VECTORS`, then the options of the contract."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

if __name__ == "__main__":  # started by its path, in any folder and without an installation
    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from conformance.harness.bad.answers import ANSWERS
from conformance.harness.bad.endings import ENDINGS
from conformance.harness.bad.escapes import ESCAPES
from conformance.harness.bad.protocol import PROTOCOLS, question_of, serve, write
from conformance.harness.bad.right import Table
from conformance.harness.bad.talk import DEPTH, HOSTILE, TALKS, TALKS_IN_BATCH

__all__ = ["main"]

CAPABILITIES = {
    "name": "bad",
    "version": "0",
    "modes": ["file", "progressive"],
    "codes": True,
    "verify": True,
    "limits": True,
    "arrival": True,
    "dump_on_fault": True,
    "batch": True,
    "max_tier": 3,
    "max_sh_degree": 3,
}
OLD = {key: value for key, value in CAPABILITIES.items() if key != "dump_on_fault"}
MODEST = OLD | dict.fromkeys(("codes", "verify", "limits", "arrival"), False) | {"modes": ["file"]}
DECLARED = {"modest": MODEST, "of-before-dump-on-fault": OLD}  # by other decoders: CAPABILITIES


def main() -> int:
    """Run the decoder; returns the exit code."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    parser = argparse.ArgumentParser()
    for option in ("in", "out", "mode", "limits", "arrival"):
        parser.add_argument(f"--{option}")
    parser.add_argument("--level", type=int)
    for option in ("verify", "dump-on-fault", "capabilities", "batch"):
        parser.add_argument(f"--{option}", action="store_true")
    args = parser.parse_args(sys.argv[3:])
    if args.capabilities:
        return capabilities(name)
    table = Table(folder)
    answerer = {**ANSWERS, **ENDINGS, **ESCAPES, **TALKS}.get(name, ANSWERS["right"])
    if args.batch:
        protocols = {**PROTOCOLS, **TALKS_IN_BATCH}
        protocols[name](table) if name in protocols else serve(answerer, table)
        return 0
    question = question_of(vars(args))
    reply = write(question, answerer(table, question))
    if reply.code is not None:
        print(json.dumps({"code": reply.code, "offset": reply.offset}))
    return reply.exit


def capabilities(name: str) -> int:
    """What it says that it can do."""
    if name == "hangs-when-asked-what-it-can":
        time.sleep(60)
    elif name == "says-not-what-it-can":
        print("all of it")
    elif name == "says-deep-json":
        print("[" * DEPTH)
    else:
        said = {"name": HOSTILE if name == "strange-name-and-codes" else name}
        print(json.dumps(DECLARED.get(name, CAPABILITIES) | said))
    return 0


if __name__ == "__main__":
    sys.exit(main())
