"""Boxes of what splats cover."""

import numpy as np
import pytest

from evogs_codec import SplatParams
from evogs_codec.tileset.boxes import Box, covered, size_of


def one(means, scales, quat=(1, 0, 0, 0), logit=5.0):
    return SplatParams(
        np.array([means], np.float32),
        np.array([quat], np.float32),
        np.log(np.array([scales], np.float32)),
        np.array([logit], np.float32),
        np.zeros((1, 1, 3), np.float32),
    )


def test_a_box_reaches_at_least_three_standard_deviations_along_every_axis():
    box = covered(one((1, 2, 3), (0.1, 0.2, 0.4)))
    half = (np.array(box.high) - np.array(box.low)) / 2
    assert (half >= 3 * np.array([0.1, 0.2, 0.4])).all()
    assert (half <= 3.4 * np.array([0.1, 0.2, 0.4])).all()
    assert (np.array(box.high) + np.array(box.low)) / 2 == pytest.approx([1, 2, 3])


def test_a_turned_splat_is_inside_its_box_and_touches_it():
    rng = np.random.default_rng(4)
    for _ in range(20):
        quat, scales = rng.normal(size=4), rng.uniform(0.01, 1, 3)
        box = covered(one((0, 0, 0), scales, quat))
        w, x, y, z = quat / np.linalg.norm(quat)
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        on = rng.normal(size=(20_000, 3))
        on *= 3.329 / np.linalg.norm(on, axis=1, keepdims=True)
        reached = np.abs((on * scales) @ turn.T).max(axis=0)
        assert (reached <= np.array(box.high) * (1 + 1e-4)).all()
        assert (reached >= np.array(box.high) * 0.95).all()


def test_a_splat_that_no_renderer_draws_does_not_count():
    pair = one((0, 0, 0), (0.1, 0.1, 0.1)), one((900, 0, 0), (9, 9, 9), logit=-6)
    both = SplatParams.from_channels(np.concatenate([s.channels() for s in pair], axis=1))
    assert covered(both) == covered(pair[0])
    assert size_of(both) == pytest.approx(0.1)
    assert covered(pair[1]).low == (900, 0, 0)


def test_a_rounded_box_holds_what_it_held_and_has_numbers_of_few_digits():
    box = Box((-0.1, 3.3, 1e-9), (7.7, 3.3, 2e-9))
    found = box.rounded()
    assert found.holds(box)
    assert not box.holds(found)
    assert all(x * 2**20 == int(x * 2**20) for x in (*found.low, *found.high))
    assert all(a < b for a, b in zip(found.low, found.high, strict=True))
