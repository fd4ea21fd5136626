"""The command that a page names: it makes the same again, and names no folder of this machine."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

__all__ = ["command_again"]


def command_again(command: str, args: argparse.Namespace, defaults: Mapping[str, Any]) -> str:
    """A command with the options that are not their defaults.

    Args:
        command: without arguments.
        args: parsed; `input` is the folder of photographs.
        defaults: of options, by their names in `args`.
    """
    parts = [command, "--data", args.input.resolve().name, "--out OUT"]
    for name, default in defaults.items():
        value = getattr(args, name)
        if value != default:
            values = value if isinstance(value, list) else [] if value is True else [value]
            words = [f"{v:g}" if isinstance(v, float) else str(v) for v in values]
            parts += [f"--{name.replace('_', '-')}", *words]
    return " ".join(parts)
