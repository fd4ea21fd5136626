"""`python -m conformance.mutants`: what the vectors make of the mutants; `run`: be one."""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from conformance.mutants.fingerprint import Fingerprint, fingerprints
from conformance.mutants.library import MUTANTS
from conformance.mutants.serve import serve

__all__ = ["alike", "main", "report"]

VECTORS = Path(__file__).resolve().parents[1] / "vectors"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the report, or act as one mutant; exit 1 if mutants survive."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["run"]:
        return serve(arguments[1:])
    parser = argparse.ArgumentParser(prog="python -m conformance.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="mutants (default: all)")
    parser.add_argument("--vectors", type=Path, default=VECTORS, help="folder of the vectors")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    args = parser.parse_args(arguments)
    mutants = [mutant for mutant in MUTANTS if not args.names or mutant.name in args.names]
    vectors = json.loads((args.vectors / "manifest.json").read_bytes())["vectors"]
    files = {vector["file"]: (args.vectors / vector["file"]).read_bytes() for vector in vectors}
    found = fingerprints(vectors, files, mutants, jobs=args.jobs)
    print("\n".join(report(found)))
    return any(not entry["outcomes"] and not entry["codes"] for entry in found.values())


def report(found: Mapping[str, Fingerprint]) -> list[str]:
    """Lines: kills of each mutant, survivors, and mutants that no vector tells apart."""
    lines = [f"{'runs':>6} {'codes':>6}  mutant"]
    for name, entry in found.items():
        n_runs, n_codes = len(entry["outcomes"]), len(entry["codes"])
        lines.append(f"{n_runs:6} {n_codes:6}  {name}: {entry['says']}")
    survivors = [n for n, entry in found.items() if not entry["outcomes"] and not entry["codes"]]
    coded = [n for n, entry in found.items() if entry["codes"] and not entry["outcomes"]]
    lines.append(f"{len(found)} mutants, {len(coded)} killed by fault codes alone")
    lines.append(f"{len(survivors)} survive: {', '.join(survivors) or 'none'}")
    groups = alike(found)
    lines.append(f"{len(groups)} groups that no vector tells apart")
    lines += [f"  {', '.join(names)}" for names in groups]
    return lines


def alike(found: Mapping[str, Any]) -> list[list[str]]:
    """Mutants that were killed, with the same fingerprint."""
    groups: defaultdict[str, list[str]] = defaultdict(list)
    for name, entry in found.items():
        if entry["outcomes"] or entry["codes"]:
            groups[json.dumps([entry["outcomes"], entry["codes"]])].append(name)
    return [names for names in groups.values() if len(names) > 1]


if __name__ == "__main__":
    sys.exit(main())
