"""The compiled loops against numpy on whole streams, lists and floats: the same results."""

import random
import sys

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from evogs_codec.decoding import float_view, replay
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.decoding.decode import Decoded, decode, decode_leaves
from evogs_codec.format.planes import MAX_STORED, inverse_ycocg, split_planes, unzigzag
from evogs_codec.model.arithmetic import MAX_X
from tests.support import damage
from tests.support.coded_strategies import coded_trees
from tests.support.compiled_loops import (
    ALWAYS,
    CODINGS,
    NEVER,
    both_verdicts,
    compiled_from,
    written_at_random,
)
from tests.support.examples import examples

kernels = pytest.importorskip(
    "evogs_codec.decoding.compiled.channels", reason="numba is not installed: no kernels"
)

SEEDS = st.integers(0, 2**32)


# --- when they are used ---------------------------------------------------------------------------


def test_compiled_loops_are_loaded_for_a_large_stream_or_the_second_of_a_process(monkeypatch):
    some = dispatch.MIN_COMPILED

    def found(*streams):
        monkeypatch.setattr(dispatch, "_n_decoded", 0)
        return [dispatch.kernels_for(n_slots, n_bytes) for n_slots, n_bytes in streams]

    assert found((some, 0), (some - 1, 1 << 30)) == [kernels, None]  # somebody loaded them
    monkeypatch.delitem(sys.modules, dispatch.KERNELS)
    assert dispatch.loaded_kernels(some) is None
    for n in (dispatch.SLOTS_OF_MANY_WITH_NUMBA, dispatch.SLOTS_OF_MANY):  # numba is loaded here
        monkeypatch.setattr(dispatch, "SLOTS_OF_MANY_WITH_NUMBA", n)
        assert found((some - 1, 1 << 30), (n, 0), (some, 0)) == [None, None, kernels]
        assert found(*[(n // 2, 0)] * 3) == [None, None, kernels]
        assert found((n, 8 << 20)) == found((2_000_000, 0)) == [kernels]


# --- whole streams --------------------------------------------------------------------------------


@examples(100)
@given(coded_trees(max_tiles=2, max_adds=20), SEEDS)
def test_compiled_loops_decode_legal_streams_to_the_same_integers(tree, seed):
    of_numpy, of_kernels = both_verdicts(written_at_random(tree, seed))
    assert isinstance(of_numpy, bytes)
    assert of_kernels == of_numpy


@pytest.mark.thorough
@examples(60)
@given(coded_trees(max_tiles=2, max_adds=7), SEEDS)
def test_compiled_loops_find_the_same_faults_in_damaged_streams(tree, seed):
    data = written_at_random(tree, seed)
    assume(len(data) > 64)
    chance = random.Random(seed)
    for _ in range(8):
        damaged = data
        for _ in range(chance.choice((1, 1, 3))):
            damaged = damage.flipped(damaged, chance.randrange(8 * 64, 8 * len(data)))
        of_numpy, of_kernels = both_verdicts(damage.repaired(damaged))
        assert of_kernels == of_numpy


@examples(30)
@given(coded_trees(max_tiles=2, max_adds=20), SEEDS)
def test_compiled_loops_give_up_on_no_legal_stream(tree, seed):
    found = []

    def watched(*args):
        found.append(dispatch.apply_compiled(*args))
        return found[-1]

    data = written_at_random(tree, seed)
    with compiled_from(ALWAYS), pytest.MonkeyPatch.context() as patch:
        patch.setattr(replay, "apply_compiled", watched)
        patch.setattr(dispatch, "MAX_PLANES", seed % 2000)  # packets in parts
        decode(data)
    assert found == [True] * len(tree.tiles)


# --- lists and floats -----------------------------------------------------------------------------


@pytest.mark.parametrize("coding", CODINGS, ids=lambda c: f"{c.low}+{c.high}{'d' * c.delta}")
def test_lists_of_every_coding_and_length_are_the_same_integers(coding):
    for n in (1, 2, 3, 5, 7, 8, 9, 31, 64, 257):
        z = np.random.default_rng(n).integers(0, 1 << coding.bits, n)
        z[0] = (1 << coding.bits) - 1
        data = np.frombuffer(b"".join(split_planes(z, coding)), np.uint8)
        out = np.full(n, -1, np.int32)
        kernels.unpack(coding.byte(), data, 0, n, 0, n, out)
        np.testing.assert_array_equal(out, z)
        for begin in range(0, n, 8):  # a part of the list
            size = min(16, n - begin)
            kernels.unpack(coding.byte(), data, 0, n, begin, size, out)
            np.testing.assert_array_equal(out[:size], z[begin : begin + size])


def test_transforms_are_those_of_numpy():
    z = np.random.default_rng(0).integers(0, MAX_STORED, 1000).astype(np.int32)
    q = z.copy()
    kernels.unzigzag(q, len(q))
    np.testing.assert_array_equal(q, unzigzag(z))
    rows = np.random.default_rng(1).integers(-(1 << 28), 1 + (1 << 28), (3, 1000)).astype(np.int32)
    expected = inverse_ycocg(rows)
    kernels.inverse_ycocg(rows, 1000)
    np.testing.assert_array_equal(rows, expected)


@pytest.mark.parametrize("n", [0, 1, 127, 128, 129, 4095, 4097])
@pytest.mark.parametrize("exponent", [-16, 0, 12, 40])
@pytest.mark.parametrize("origin", [0, 1, -1, 1 << 52, -(1 << 52), (1 << 24) + 1])
def test_float_rows_are_those_of_numpy_bit_for_bit(n, exponent, origin):
    rng = np.random.default_rng(n)
    x = rng.integers(-MAX_X, MAX_X + 1, (48, 5000)).astype(np.int32)
    x[1] = rng.integers(-4, 5, 5000)  # ties, and sums of 0
    x[2, ::2] = MAX_X
    x[3] = 0
    origins, none = np.array([origin, origin, 0], np.int64), np.zeros(48, np.int64)
    for c, own in (
        (3, origins),
        (1, none),
        (3, none),
        (4, none),
        (12, none),
        (27, none),
        (48, none),
    ):
        of_numpy, of_kernels = (np.empty((n, c), np.float32) for _ in range(2))
        float_view.float_rows(x[:c, :n], own[:c], 2.0**-exponent, of_numpy)
        kernels.float_rows(x[:c, :n], own[:c], 2.0**-exponent, of_kernels)
        assert of_kernels.tobytes() == of_numpy.tobytes()


@examples(30)
@given(coded_trees(max_tiles=2), SEEDS)
def test_the_float_view_of_a_stream_is_the_same_bit_for_bit(tree, seed):
    data = written_at_random(tree, seed)
    views: list[bytes] = []
    for n_slots in (NEVER, ALWAYS):
        with compiled_from(n_slots):
            decoded: Decoded = decode(data)
            views.append(decoded.leaves(sh_degree=3).channels().tobytes())
            views.append(decode_leaves(data, sh_degree=3).channels().tobytes())
    assert len(set(views)) == 1
