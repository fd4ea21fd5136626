"""Fresh vectors: made by another process, which needs more than the harness does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from conformance.harness.manifest import Suite, SuiteError, load

__all__ = ["LackingError", "make_fresh"]

SECONDS = 300
ROOT = Path(__file__).resolve().parents[3]


class LackingError(Exception):
    """What makes fresh vectors, or a library it needs, is not installed."""


def make_fresh(seed: int, count: int, folder: Path) -> Suite:
    """Vectors of a seed, written to a folder.

    Raises:
        LackingError: they cannot be made here.
        SuiteError: making them failed, say because the oracle and the reference decoder disagree.
    """
    command = [sys.executable, "-m", "conformance.fuzzing.fresh", "--seed", str(seed)]
    command += ["--count", str(count), "--out", str(folder)]
    try:
        # There `conformance` is found without an installation.
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, timeout=SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SuiteError(f"no fresh vectors: {error}") from None
    if done.returncode:
        says = f"no fresh vectors: {done.stderr.strip().rpartition(chr(10))[2]}"
        kind = LackingError if "No module named" in says else SuiteError
        raise kind(says)
    return load(folder)
