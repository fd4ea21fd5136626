"""Ranges of bytes against sets of bytes."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from evogs_codec.stores.ranges import length, merged, pieces, without

RANGES = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40)), max_size=8)


def there(ranges):
    return {at for begin, end in ranges for at in range(begin, end)}


@given(RANGES, st.integers(0, 5))
def test_merged_ranges_have_the_same_bytes_and_small_gaps(ranges, gap):
    found = merged(ranges, gap)
    assert there(merged(ranges)) == there(ranges) <= there(found)
    assert all(one[1] + gap < next_[0] for one, next_ in pairwise(found))
    assert all(begin < end for begin, end in found)


@given(RANGES, RANGES)
def test_what_is_there_is_taken_out(ranges, others):
    found = without(merged(ranges), merged(others))
    assert there(found) == there(ranges) - there(others)
    assert length(found) == len(there(found))


@given(RANGES, st.integers(1, 9))
def test_pieces_have_the_same_bytes_and_none_is_larger(ranges, size):
    found = pieces(merged(ranges), size)
    assert there(found) == there(ranges)
    assert length(found) == len(there(ranges))
    assert all(0 < end - begin <= size for begin, end in found)
