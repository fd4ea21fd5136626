"""What a decoder says it can do, and which runs need something it does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from conformance.harness.manifest import MODES, Case
from conformance.harness.running.oneshot import died, last_words
from conformance.harness.running.plain import plain, read_json
from conformance.harness.running.process import Bounds, run
from conformance.harness.running.scratch import scratch

__all__ = ["Capabilities", "CapabilityError", "ask_capabilities", "lacking", "not_asked"]

OPTIONAL = {"dump_on_fault": False}  # keys that may be left out, and what that means

MAX_NAME = 80  # characters


class CapabilityError(Exception):
    """The decoder does not say what it can do."""


@dataclass(frozen=True)
class Capabilities:
    """The answer to --capabilities, by its names; `OPTIONAL` ones may be left out."""

    name: str
    version: str
    modes: tuple[str, ...]
    codes: bool
    verify: bool
    limits: bool
    arrival: bool
    dump_on_fault: bool
    batch: bool
    max_tier: int
    max_sh_degree: int

    def as_json(self) -> dict[str, Any]:
        """As the decoder gave it."""
        return asdict(self) | {"modes": list(self.modes)}


def ask_capabilities(
    command: Sequence[str], environment: Mapping[str, str], bounds: Bounds
) -> Capabilities:
    """Run `CMD --capabilities`.

    Raises:
        CapabilityError: it fails, or its answer is of another form.
    """
    with scratch() as folder:
        try:
            ended = run([*command, "--capabilities"], folder, environment, bounds, written=[folder])
        except OSError as error:
            raise CapabilityError(f"the command cannot be started: {error}") from None
    trouble, detail = died(ended, bounds)
    if trouble or ended.status:
        detail = detail or f"exit status {ended.status}{last_words(ended.stderr)}"
        raise CapabilityError(f"--capabilities: {detail}")
    try:
        return _parse(read_json(ended.stdout))
    except (ValueError, TypeError) as error:
        said = plain(ended.stdout, 60)
        raise CapabilityError(
            f'--capabilities: standard output has "{said}", not one JSON object: {error}'
        ) from None


def lacking(capabilities: Capabilities, case: Case) -> list[str]:
    """What the run needs and the decoder says it does not have."""
    run, vector = case.run, case.vector
    needs = {
        f"{run.mode} mode": run.mode not in capabilities.modes,
        "verify": run.verify and not capabilities.verify,
        "limits": bool(run.limits) and not capabilities.limits,
        "arrival": run.arrival is not None and not capabilities.arrival,
        f"tier {vector.tier}": vector.tier > capabilities.max_tier,
        f"SH degree {vector.sh_degree}": vector.sh_degree > capabilities.max_sh_degree,
    }
    return [name for name, is_lacking in needs.items() if is_lacking]


def not_asked(capabilities: Capabilities, case: Case) -> bool:
    """Whether the run has an option that the decoder may not know: then it is not put to it."""
    return case.run.dump_on_fault and not capabilities.dump_on_fault


def _parse(entry: object) -> Capabilities:
    if not isinstance(entry, dict):
        raise TypeError("not an object")
    names = Capabilities.__dataclass_fields__
    entry = dict[str, Any](OPTIONAL) | entry
    wrong = set(entry) ^ set(names)
    if wrong:
        raise ValueError(f"keys unknown or missing: {plain(', '.join(sorted(wrong)))}")
    for key in ("codes", "verify", "limits", "arrival", "dump_on_fault", "batch"):
        if type(entry[key]) is not bool:
            raise TypeError(f"{key} is not true or false")
    for key, low, high in (("max_tier", 1, 3), ("max_sh_degree", 0, 3)):
        if type(entry[key]) is not int or not low <= entry[key] <= high:
            raise ValueError(f"{key} is not in {low}..{high}")
    modes = entry["modes"]
    if not isinstance(modes, list) or not 0 < len(modes) <= len(MODES):
        raise ValueError("modes is a list of file, progressive")
    if not all(mode in MODES for mode in modes):
        raise ValueError("modes is a list of file, progressive")
    if not all(isinstance(entry[key], str) for key in ("name", "version")):
        raise TypeError("name and version are strings")
    said = {key: plain(entry[key], MAX_NAME) for key in ("name", "version")}
    return Capabilities(**{**entry, **said, "modes": tuple(modes)})
