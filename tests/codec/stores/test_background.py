"""Threads that wait for servers: order, errors, ends."""

import threading

import pytest

from evogs_codec.stores.background import apart, each_apart


def test_results_come_when_they_are_done():
    first = threading.Event()

    def call(n):
        if n == 0:
            assert first.wait(20)
        return n

    results = each_apart(call, range(9), 2)
    assert sorted([next(results) for _ in range(8)]) == list(range(1, 9))
    first.set()
    assert list(results) == [0]


def test_an_error_is_raised_and_nothing_new_is_begun():
    begun = []

    def call(n):
        begun.append(n)
        raise ValueError(f"number {n}")

    with pytest.raises(ValueError, match="number 0"):
        list(each_apart(call, range(1000), 1))
    assert begun == [0]


def test_a_single_call_has_its_result():
    assert apart(threading.current_thread) is not threading.current_thread()
    assert list(each_apart(str, [], 3)) == []
