"""Memory that is used again."""

from __future__ import annotations

import numpy as np
import pytest

from evogs_codec.common.buffers import CHUNK, HUGE_PAGE, Scratch, empty


@pytest.mark.parametrize("n", [0, 1, 1000, HUGE_PAGE, 2 * HUGE_PAGE, 3 * HUGE_PAGE + 1])
def test_large_arrays_begin_where_a_huge_page_does(n):
    array = empty((n, 3), np.float32)
    assert array.shape == (n, 3)
    assert array.dtype == np.float32
    assert array.flags.c_contiguous
    assert array.nbytes < HUGE_PAGE // 2 or array.ctypes.data % HUGE_PAGE == 0


def test_arrays_do_not_share_memory_until_it_is_rewound():
    scratch = Scratch()
    first = scratch.take((3, 5), np.int32)
    second = scratch.take((7,), np.bool_)
    large = scratch.take((CHUNK,), np.uint8)  # in a chunk of its own
    after = scratch.take((10,), np.int64)
    arrays = [first, second, large, after]
    for k, array in enumerate(arrays):
        array[...] = k % 2
    assert [(array == k % 2).all() for k, array in enumerate(arrays)] == [True] * 4
    assert after.ctypes.data % after.itemsize == 0
    scratch.rewind()
    assert scratch.take((3, 5), np.int32).ctypes.data == first.ctypes.data


def test_what_was_taken_before_is_taken_from_the_same_memory_again():
    scratch = Scratch()
    places = []
    for _ in range(3):
        arrays = [scratch.take((CHUNK // 3,), np.uint8) for _ in range(7)]
        places.append([array.ctypes.data for array in arrays])
        scratch.rewind()
    assert places[0] == places[1] == places[2]
