"""The systems of the paper, by the names of `config.METHODS`."""

from __future__ import annotations

from reference_trainer.methods.base import Method
from reference_trainer.methods.evogs import Evogs
from reference_trainer.methods.l3gs import L3gs
from reference_trainer.methods.lapis import Lapis
from reference_trainer.methods.separate import Monolithic, Single

__all__ = ["method_named"]


def method_named(name: str) -> Method:
    """The method of a name of `config.METHODS`."""
    methods: dict[str, Method] = {
        "evogs": Evogs("D"),
        "evogs-mixed": Evogs("M"),
        "evogs-sym": Evogs("C"),
        "evogs-b": Evogs("B"),
        "evogs-a": Evogs("A"),
        "lapis": Lapis(),
        "l3gs": L3gs(),
        "mono": Monolithic(),
        "single": Single(),
    }
    return methods[name]
