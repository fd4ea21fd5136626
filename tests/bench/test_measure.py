"""Texts of measurements."""

import pytest

from tools.bench.measure import seconds_text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.0412, "0.041"), (0.96, "0.96"), (1.0, "1.0"), (36.94, "36.9")]
)
def test_short_times_keep_two_digits(seconds, text):
    assert seconds_text(seconds) == text
