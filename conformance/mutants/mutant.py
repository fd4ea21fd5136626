"""A wrong decoder: the text of the oracle with one line of meaning changed."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from conformance.decoders import oracle

__all__ = ["Mutant", "load", "module_of", "original"]


@dataclass(frozen=True)
class Mutant:
    """A decoder that differs from the oracle in one thing.

    Attributes:
        name: what reports call it.
        section: requirement or section of the spec that it breaks.
        says: what an implementer is told whose decoder behaves like it.
        edits: (old, new) lines; old lines are in the oracle exactly once. Most mutants have one
            edit; a few take more places for one meaning.
    """

    name: str
    section: str
    says: str
    edits: tuple[tuple[str, str], ...]

    def text(self, text: str) -> str:
        """The text of the wrong decoder, from that of the right one.

        Raises:
            ValueError: the lines of an edit are not in the text exactly once.
        """
        for old, new in self.edits:
            if f"\n{text}".count(f"\n{old}") != 1:
                raise ValueError(f"{self.name}: not once in the oracle:\n{old}")
            text = f"\n{text}".replace(f"\n{old}", f"\n{new}")[1:]
        return text


@cache
def load(mutant: Mutant) -> ModuleType:
    """The mutant as a module of its own, with the functions of `conformance.decoders.oracle`."""
    code = compile(mutant.text(original()), f"oracle.py as {mutant.name}", "exec")
    return module_of(mutant.name, code, {})


def module_of(name: str, code: CodeType, names: Mapping[str, Any]) -> ModuleType:
    """A module that runs `code`, and has `names` from the beginning."""
    module = ModuleType(f"conformance.mutants.{name}")
    sys.modules[module.__name__] = module  # dataclasses look their module up
    module.__dict__.update(names)
    exec(code, module.__dict__)
    return module


@cache
def original() -> str:
    """The text of the oracle."""
    return Path(oracle.__file__).read_text(encoding="utf-8")
