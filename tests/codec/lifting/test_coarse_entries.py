"""Entries for coarse splats: their picks cost least, and few bits buy much."""

import numpy as np
import pytest

from evogs_codec.lifting import coarse_entries
from evogs_codec.lifting.coarse_entries import MAX_ENTRIES, CoarseEntries


def some_sh(n=4000, n_channels=9, seed=0):
    """(C, N) SH as of a scene: most are small."""
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(n_channels, n)) * rng.exponential(0.1, n)).astype(np.float32)


def errors_of(entries, x, picks):
    shown = np.concatenate([np.zeros((len(x), 1)), entries.values], axis=1)[:, picks]
    return np.square(x - shown).sum(axis=0)


def bits_of(picks):
    shares = np.bincount(picks) / len(picks)
    return -np.sum(shares[shares > 0] * np.log2(shares[shares > 0]))


def test_what_is_picked_costs_least():
    x = some_sh(300)
    entries = CoarseEntries.of(some_sh(seed=1), 40)
    n = entries.values.shape[1]
    costs = [errors_of(entries, x, np.full(300, k)) + entries.costs[k] for k in range(1 + n)]
    np.testing.assert_array_equal(entries.cheapest(x), np.argmin(costs, axis=0))


def test_picks_take_fewer_bits_than_those_of_the_nearest_at_no_larger_error(monkeypatch):
    x = some_sh()
    entries = CoarseEntries.of(x, MAX_ENTRIES)
    picks = entries.cheapest(x)
    monkeypatch.setattr(coarse_entries, "BIT_PRICE", 0.0)
    few = CoarseEntries.of(x, 32)
    nearest = few.cheapest(x)
    assert errors_of(entries, x, picks).sum() <= errors_of(few, x, nearest).sum()
    assert bits_of(picks) < 0.6 * bits_of(nearest)


def test_entries_are_picked_and_those_picked_most_cost_least():
    x = some_sh()
    entries = CoarseEntries.of(x, MAX_ENTRIES)
    counts = np.bincount(entries.cheapest(x), minlength=len(entries.costs))
    assert np.count_nonzero(counts) > 0.9 * len(counts)
    assert np.corrcoef(entries.costs[1:], np.log2(counts[1:] + 1))[0, 1] < -0.8


@pytest.mark.parametrize("most", [1, 7, 1000])
def test_there_are_no_more_entries_than_asked_for(most):
    assert CoarseEntries.of(some_sh(50), most).values.shape[1] <= min(most, 50, MAX_ENTRIES)


def test_of_no_coarse_splats_there_are_no_entries():
    nothing = np.zeros((9, 0), np.float32)
    entries = CoarseEntries.of(nothing, 5)
    assert entries.values.shape == (9, 0)
    assert entries.cheapest(nothing).shape == (0,)


@pytest.mark.parametrize("scale", [1e-12, 1e30])
def test_numbers_at_the_ends_of_float32_overflow_nothing(scale):
    x = some_sh(200) * np.float32(scale)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        entries = CoarseEntries.of(x, 8)
        picks = entries.cheapest(x)
    assert np.isfinite(entries.values).all()
    assert picks.max() <= entries.values.shape[1]


def test_a_loud_splat_takes_no_sh_from_others():
    x = some_sh()
    right = errors_of(found := CoarseEntries.of(x, MAX_ENTRIES), x, found.cheapest(x)).sum()
    x[:, 7] = 100
    entries = CoarseEntries.of(x, MAX_ENTRIES)
    errors = errors_of(entries, x, entries.cheapest(x))
    assert np.delete(errors, 7).sum() < 1.1 * right
