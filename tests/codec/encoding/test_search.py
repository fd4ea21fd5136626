"""The search for a target, on functions that cost nothing."""

import math

import numpy as np
import pytest

from evogs_codec.encoding.search import Goal, Start, nearest


@pytest.mark.parametrize(("most", "found"), [(math.inf, 1.006), (1.0, 0.98), (0.5, 1.006)])
def test_what_is_below_a_limit_is_better_than_what_is_nearer_above_it(most, found):
    def jump(at):
        value = 1.006 if at < 3 else 0.98
        return value, value

    assert nearest(jump, Goal(0.995, 0.005, most), Start(1.0, -0.1), (0.01, 100.0)).what == found


def test_a_target_that_only_the_middle_of_the_range_reaches_is_found_though_the_first_is_far():
    tries = []

    def measure(at):
        tries.append(at)
        return 10 - math.log10(at), at

    found = nearest(measure, Goal(30.0, 0.01), Start(1.0, -0.1), (1e-40, 1e40), far=5)
    assert found.value == pytest.approx(30, abs=0.01)
    assert not found.is_end
    assert tries[1] == 1e-40


@pytest.mark.parametrize(("start", "target"), [(1e-4, 100.0), (1e4, -100.0)])
def test_a_search_that_begins_at_the_end_beyond_which_the_target_lies_ends_there(start, target):
    tries = []

    def measure(at):
        tries.append(at)
        return -math.log(at), at

    found = nearest(measure, Goal(target, 0.01), Start(start, -1.0), (1e-4, 1e4))
    assert found.is_end
    assert found.at == start
    assert len(tries) == 1


@pytest.mark.parametrize("target", [100, -100])
def test_a_value_that_no_place_has_is_given_up_after_a_few_tries(target):
    tries = []

    def measure(at):
        tries.append(at)
        return math.tanh(-math.log(at)), at

    found = nearest(measure, Goal(target, 0.01), Start(1.0, -0.1), (1e-4, 1e4))
    assert found.is_end
    assert len(tries) <= 4
    assert abs(found.value) > 0.99


def test_where_a_value_jumps_over_the_target_the_nearest_above_is_known_after_few_tries():
    tries = []

    def measure(at):
        tries.append(at)
        return (80.3 if at < 2 else 79.1) - math.log(at), at

    above = nearest(measure, Goal(79.0, 0.1), Start(1.0, -1.0), (1e-4, 1e4), narrow=0.05).above
    assert len(tries) <= 6
    assert above is not None
    assert above.at < 2
    assert above.value == pytest.approx(80.3 - math.log(2), abs=0.06)


@pytest.mark.parametrize(("probes", "n_tries"), [(0, 4), (2, 6), (9, 12)])
def test_places_around_a_jump_are_tried_where_asked(probes, n_tries):
    tries = []

    def measure(at):
        tries.append(at)
        x = math.log(at)
        is_met = len(tries) == 12
        return 5.0 if is_met else (5.3 if x < 0.123 else 4.6) - x, at

    found = nearest(measure, Goal(5.0, 0.1), Start(1.0, -1.0), (1e-4, 1e4), probes, narrow=0.05)
    assert len(tries) == n_tries
    assert (found.value == 5.0) == (n_tries == 12)
    around = np.log(tries[4:])
    assert np.all(np.abs(around - 0.123) < 0.15)
    assert len(set(around)) == len(around)


def test_no_place_around_a_jump_is_outside():
    tries = []

    def measure(at):
        tries.append(at)
        return (1.0 if at < 0.999 else -1.0), at

    nearest(measure, Goal(0.0, 0.1), Start(0.9, -1.0), (1e-4, 1.0), 6, narrow=0.09)
    assert len(tries) > 6
    assert max(tries) <= 1.0


def test_the_end_of_the_range_is_tried_once_a_line_meets_the_target_beyond_it():
    tries = []

    def measure(at):
        tries.append(at)
        return -0.01 * math.log(at), at

    found = nearest(measure, Goal(1.0, 0.01), Start(1.0, -0.2), (1e-4, 1e4))
    assert found.is_end
    assert tries == [1.0, pytest.approx(math.exp(-5)), 1e-4]


def test_the_end_is_not_tried_where_rough_values_are_near_the_target():
    tries = []

    def measure(at):
        tries.append(at)
        rough = 2.1 if len(tries) == 3 else 0.0
        return 2.9 - 2.0 * math.log(at) + rough, at

    found = nearest(measure, Goal(0.0, 0.1), Start(1.0, -3.0), (1e-9, 1e9), far=15)
    assert abs(found.value) <= 0.1
    assert max(tries) < 100


def test_what_was_measured_before_gives_the_slope():
    tried = []

    def measure(at):
        tried.append(at)
        return -0.2 * math.log(at), at

    start = Start(math.exp(2.0), -3.0, known=(math.exp(3.0), -0.6))
    found = nearest(measure, Goal(1.0, 0.01), start, (1e-4, 1e4))
    assert found.value == pytest.approx(1.0)
    assert len(tried) == 2
    tried.clear()
    nearest(measure, Goal(1.0, 0.01), Start(math.exp(2.0), -3.0), (1e-4, 1e4))
    assert len(tried) > 2
