"""Whether levels of a mixed tree begin with refines of all their leaves.

With them, children have what they share in a number of its own; without, in psi and alpha alone.
Which takes fewer bytes for the same pictures depends on the scene, and shows at level 1, which is
the cheapest to train twice. There refines are worth 10 to 40 % of the bytes of an object seen from
all around, and next to nothing in a capture along a short path, where they lose 16 % at level 3.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evogs_codec import encode
from evogs_codec.render.views import Views
from reference_trainer.config import Config, FrontierGrowth
from reference_trainer.methods.base import Done, Plan, Setting

__all__ = ["TRIED", "better", "growth_of", "is_tried", "second_attempt"]

TRIED = 1  # level
WORTH = 0.05  # of the bits of level 1 is what its refines have to save: finer levels lose by them


def is_tried(config: Config) -> bool:
    """Whether level 1 of a mixed tree is trained twice."""
    wanted = config.frontier.refines_first is None
    return wanted and config.integers.part > 0 and config.n_levels > TRIED


def second_attempt(plans: list[Plan]) -> list[Plan]:
    """Those of the stages of a tree, in floats and in integers, that are done again."""
    return [replace(plan, without_refines=True) for plan in plans if plan.level == TRIED]


def growth_of(setting: Setting, done: Done) -> FrontierGrowth:
    """How a level of a mixed tree grows."""
    growth = setting.config.frontier
    if growth.refines_first is not None:
        return growth
    if setting.plan.without_refines or done.refines_first is False:
        return replace(growth, refines_first=False, all_alphas=True)
    return replace(growth, refines_first=True)


def better(setting: Setting, done: Done) -> Done:
    """Of two attempts at level 1 the one with refines, if they are worth it, or the one without.

    What refines save is bits that the other attempt takes more, and bits that are worth what its
    pictures lack, at the price of the run (`Integers.price`).

    Args:
        setting: of the second attempt.
        done: what it left, and the first one as its rival.

    Returns:
        One of them, which says what it was made with.
    """
    first = done.rival
    assert first is not None
    errors = [_error(setting, attempt) for attempt in (first, done)]
    n = sum(step.psi.size for step in first.steps if step.level == TRIED)
    price = setting.config.integers.price(errors[0], n)
    before = replace(
        done,
        steps=tuple(step for step in done.steps if step.level < TRIED),
        quanta=done.quanta[: 1 + TRIED],
    )
    bits = [8 * len(encode(found.tree)) for found in (first, done, before)]
    saved = price * (bits[1] - bits[0]) + errors[1] - errors[0]
    chosen = first if saved > WORTH * price * (bits[0] - bits[2]) else done
    return replace(chosen, rival=None, refines_first=chosen is first)


def _error(setting: Setting, done: Done) -> float:
    """Mean squared error of the leaves, over the photographs that they were trained on."""
    data = setting.data
    views = Views(done.tree.leaves(), [view.camera for view in data.train], data.background)
    errors = [
        float(np.mean(np.square(picture.clip(0, 1) - view.image)))
        for picture, view in zip(views.pictures, data.train, strict=True)
    ]
    return float(np.mean(errors))
