"""Costs of codings: compiled, they are those of numpy."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="the costs are compiled")

from evogs_codec.format import planes


@pytest.mark.parametrize("n", [1, 2, 7, 300, 5000, 40_000])
@pytest.mark.parametrize("scale", [0.5, 20.0, 3e3, 1e6])
def test_compiled_costs_are_those_of_numpy(n, scale, monkeypatch):
    drawn = np.abs(np.random.default_rng(n).standard_cauchy(n) * scale)
    z = np.minimum(drawn, planes.MAX_STORED - 1).astype(np.uint32)
    bits = int(z.max()).bit_length()
    found = planes.huffman_costs(z, bits)
    monkeypatch.setattr(planes, "MAY_COMPILE", False)
    assert np.array_equal(found, planes.huffman_costs(z, bits))


def test_zeros_and_one_value_cost_nothing():
    assert planes.choose_coding(np.zeros(9, np.uint32)) == (planes.ABSENT, 0.0)
    assert planes.choose_coding(np.full(16, 3, np.uint32))[1] == 0.0
