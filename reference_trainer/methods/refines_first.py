"""Whether levels of a mixed tree begin with refines of all their leaves.

With them, children have what they share in a number of its own; without, in psi and alpha alone.
Which takes fewer bytes for the same pictures depends on the scene, and shows at level 1, which is
the cheapest to train twice. There refines save 10 to 40 % of the bytes of an object seen from all
around. In a capture along a short path they save next to nothing there, and cost a third at level
3.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evogs_codec import encode
from evogs_codec.encoding.guess import PRICES
from evogs_codec.render.views import Views
from reference_trainer.config import Config, FrontierGrowth
from reference_trainer.methods.base import Done, Plan, Setting

__all__ = [
    "TRIED_LEVEL",
    "are_kept",
    "better",
    "growth_of",
    "is_tried",
    "saved_by",
    "second_attempt",
]

TRIED_LEVEL = 1  # level
# Part of the bits of level 1 that its refines have to save: finer levels lose by them.
MIN_SAVED = 0.05
# Finer than this, a bit is worth more than its price says: training corrects what rounding adds.
FINEST_DISTORTION = 0.07  # distortion


def is_tried(config: Config) -> bool:
    """Whether level 1 of a mixed tree is trained twice."""
    wanted = config.frontier.refines_first is None
    return wanted and config.integers.part > 0 and config.n_levels > TRIED_LEVEL


def second_attempt(plans: list[Plan]) -> list[Plan]:
    """Those of the stages of a tree, in floats and in integers, that are done again."""
    return [replace(plan, without_refines=True) for plan in plans if plan.level == TRIED_LEVEL]


def are_kept(saved: float) -> bool:
    """Whether levels have refines that save this part of the bits of level 1."""
    return saved > MIN_SAVED


def growth_of(setting: Setting, done: Done) -> FrontierGrowth:
    """How a level of a mixed tree grows."""
    growth = setting.config.frontier
    if growth.refines_first is not None:
        return growth
    saved = done.refines_save
    if not setting.plan.without_refines and (saved is None or are_kept(saved)):
        return replace(growth, refines_first=True)
    return replace(growth, refines_first=False, all_alphas=True)


def better(setting: Setting, done: Done) -> Done:
    """Of two attempts at level 1 the one with refines, if they are worth it, or the one without.

    Args:
        setting: of the second attempt.
        done: what it left, and the first one as its rival.

    Returns:
        One of them, which says what its refines save, or would have.
    """
    first = done.rival
    assert first is not None
    saved = saved_by(setting, first, done)
    return replace(first if are_kept(saved) else done, rival=None, refines_save=saved)


def saved_by(setting: Setting, first: Done, second: Done) -> float:
    """The part of the bits of level 1 that its refines save, for pictures as good.

    It is what the attempt without them takes more, and what the error that it has more is worth in
    bits. Negative: they cost more than they bring.

    Args:
        setting: of the second attempt.
        first: the level with refines.
        second: without.
    """
    n, m = (sum(x.psi.size for x in of.steps if x.level == TRIED_LEVEL) for of in (first, second))
    if not m:
        return 1.0 if n else 0.0
    errors = [_error(setting, attempt) for attempt in (first, second)]
    integers = setting.config.integers
    integers = replace(integers, distortion=max(integers.distortion, FINEST_DISTORTION))
    price = max(integers.price(errors[0], n), PRICES[0])
    roots = replace(
        first,
        steps=tuple(step for step in first.steps if step.level < TRIED_LEVEL),
        quanta=first.quanta[: 1 + TRIED_LEVEL],
    )
    bits = [8 * len(encode(of.tree)) for of in (first, second, roots)]
    saved = bits[1] - bits[0] + (errors[1] - errors[0]) / price
    return float(saved / max(bits[0] - bits[2], 1))


def _error(setting: Setting, done: Done) -> float:
    """Mean squared error of the leaves, over the photographs that they were trained on."""
    data = setting.data
    views = Views(done.tree.leaves(), [view.camera for view in data.train], data.background)
    errors = [
        float(np.mean(np.square(picture.clip(0, 1) - view.image)))
        for picture, view in zip(views.pictures, data.train, strict=True)
    ]
    return float(np.mean(errors))
