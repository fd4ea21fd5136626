"""Sibling differences: whole arrays, compiled, and one after the other give the same integers."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec.model.arithmetic import RangeError
from evogs_codec.model.siblings import MAX_SIBLING, Siblings, parent_records

SMALL = st.integers(-40, 40)


@st.composite
def steps_of_refines(draw, values=SMALL):
    """(slots, born_from, differences) of a step."""
    n = draw(st.integers(1, 30))
    born_from = np.array([draw(st.integers(-1, k - 1)) for k in range(n)])
    is_named = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    slots = np.flatnonzero(is_named)
    return slots, born_from, np.array([draw(values) for _ in slots], np.int32)


def one_by_one(slots, born_from, differences):
    """The pseudo-code of spec 7.1; None where a sum leaves its range."""
    place, values = {}, []
    for i, (slot, d) in enumerate(zip(slots.tolist(), differences.tolist(), strict=True)):
        place[slot] = i
        first = place.get(int(born_from[slot])) if born_from[slot] >= 0 else None
        if first is None:
            values.append(d)
            continue
        values.append(values[first] - d)
        values[first] += d
        if max(abs(values[i]), abs(values[first])) > MAX_SIBLING:
            return None
    return values


@pytest.mark.parametrize("few", [32, -1], ids=["round by round", "by doubling"])
@given(step=steps_of_refines())
def test_whole_arrays_give_what_the_text_gives(few, step):
    slots, born_from, differences = step
    with patch("evogs_codec.model.siblings.FEW_ROUNDS", few):
        found = Siblings.of(slots, born_from).sums(differences[None])
    assert found.tolist() == [one_by_one(*step)]


LARGE = st.sampled_from([0, 1, -1, 1 << 25, -(1 << 25)])  # what YCoCg-R makes of 24 bits, at most


@given(steps_of_refines(LARGE))
def test_a_sum_out_of_its_range_is_refused_also_where_it_comes_back(step):
    slots, born_from, differences = step
    siblings, right = Siblings.of(slots, born_from), one_by_one(*step)
    if right is None:
        with pytest.raises(RangeError, match="2\\^28"):
            siblings.sums(differences[None])
    else:
        assert siblings.sums(differences[None])[0].tolist() == right


def compiled_runs(slots, born_from):
    """(runs of siblings, the most differences in a sum) as compiled code finds them."""
    channels = pytest.importorskip("evogs_codec.decoding.compiled.channels")
    runs = np.empty((3, len(slots)), np.int32)
    places = np.full(len(born_from), len(slots) - 1, np.int32)  # as left over from another step
    args = slots.astype(np.int32), born_from.astype(np.int32), places
    n_runs, terms = channels.sibling_runs(*args, runs, 0)
    return runs[:, :n_runs], terms


@given(steps_of_refines())
def test_runs_of_siblings_are_the_parents_in_order_and_hold_no_record_twice(step):
    slots, born_from, _ = step
    runs, _ = compiled_runs(slots, born_from)
    pairs = []
    for begin, other, length in runs.T.tolist():
        assert other + length <= begin
        pairs += [(begin + k, other + k) for k in range(length)]
    parents = parent_records(slots, born_from).tolist()
    assert pairs == [(k, parent) for k, parent in enumerate(parents) if parent >= 0]


def test_rows_of_siblings_are_one_run_and_chains_are_many():
    doubled = np.concatenate([np.full(8, -1), np.arange(8), np.arange(16)])
    runs, terms = compiled_runs(np.arange(32), doubled)
    assert runs.T.tolist() == [[8, 0, 8], [16, 0, 16]]
    assert terms == 3
    chain = np.arange(-1, 9)  # each from the one before it
    runs, terms = compiled_runs(np.arange(10), chain)
    assert runs[2].tolist() == [1] * 9
    assert terms == 10


@given(steps_of_refines(LARGE))
def test_compiled_loops_give_the_same(step):
    values = pytest.importorskip("evogs_codec.decoding.compiled.values")
    slots, born_from, differences = step
    found, right = differences.copy(), one_by_one(*step)
    runs, terms = compiled_runs(slots, born_from)
    is_good = values.add_siblings(found, runs, 0, runs.shape[1])
    assert is_good == (right is not None)
    assert right is None or found.tolist() == right
    largest = int(np.abs(differences).max(initial=0)) * int(terms)
    assert right is None or int(np.abs(found).max(initial=0)) <= largest
    if largest <= MAX_SIBLING:
        found = differences.copy()
        values.sum_siblings(found, runs, 0, runs.shape[1])
        assert found.tolist() == right


def test_a_chain_leaves_the_range_or_just_does_not():
    born_from = np.full(20, 0)
    born_from[0] = -1  # all others from slot 0
    for last, is_good in ((1 << 25, True), ((1 << 25) + 1, False)):
        d = np.array([1 << 25] * 7 + [last], np.int32)
        siblings = Siblings.of(np.arange(8), born_from)
        if is_good:
            assert siblings.sums(d[None])[0, 0] == MAX_SIBLING
        else:
            with pytest.raises(RangeError, match="2\\^28"):
                siblings.sums(d[None])


def test_the_example_of_the_text():
    born_from = np.full(13, -1)
    born_from[[7, 12, 9]] = 4, 4, 7
    slots, differences = np.array([4, 7, 9, 12]), np.array([[10, 3, 1, 2]], np.int32)
    assert Siblings.of(slots, born_from).sums(differences).tolist() == [[15, 8, 6, 11]]


def test_time_does_not_grow_with_the_square_of_a_chain():
    n = 200_000
    born_from = np.arange(-1, n - 1)  # each slot from the one before it
    sums = Siblings.of(np.arange(n), born_from).sums(np.ones((1, n), np.int32))
    assert sums[0, -1] == -(n - 2)
    assert sums[0, 0] == 2


@given(steps_of_refines(), st.lists(SMALL, min_size=30, max_size=30))
def test_slopes_of_differences_are_those_of_psi_turned_back(step, numbers):
    slots, born_from, differences = step
    siblings = Siblings.of(slots, born_from)
    slopes = np.array([numbers[: len(slots)]], np.float32)
    psi = siblings.sums(differences[None])
    # <S d, g> = <d, S^T g>
    assert float((psi * slopes).sum()) == float((differences * siblings.slopes(slopes)).sum())
