"""The compiled way to apply a step: the integers, and the faults, of `apply_channel`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evogs_codec.encoding import apply_step as module
from evogs_codec.encoding.apply_step import apply_step
from evogs_codec.model.arithmetic import MAX_X, AlphaTable, Quantiser, StepPlan
from evogs_codec.model.tree import Kind

pytest.importorskip("numba", reason="the loops are compiled")

D, N_BEFORE, N_CLASSES, N_GROUPS = 14, 30, 8, 5


@pytest.mark.parametrize("is_small", [True, False])
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None)  # the first call loads the loops
def test_the_compiled_loop_does_what_numpy_does(is_small, seed):
    rng = np.random.default_rng(seed)
    size, shifts = (100, 8) if is_small else (int(2.0 ** rng.uniform(0, 23)), 28)
    slots = np.flatnonzero(rng.random(N_BEFORE) < 0.6).astype(np.int32)
    kinds = rng.choice([Kind.REFINE, Kind.SPLIT, Kind.DROP], len(slots)).astype(np.uint8)
    n_adds = int(rng.integers(0, 4))
    plan = StepPlan.of(slots, kinds, N_BEFORE, n_adds)
    n_psi = int(np.count_nonzero(kinds != Kind.DROP))
    quantisers = [
        Quantiser(int(rng.integers(1, 256)), int(rng.integers(0, shifts)))
        for _ in range(2 * N_CLASSES)
    ]
    tables = [
        AlphaTable(int(rng.integers(0, 9)), tuple(rng.integers(-64, 300, 3).tolist()))
        for _ in range(N_GROUPS)
    ]
    x = np.zeros((D, plan.n_after), np.int32)
    x[:, :N_BEFORE] = rng.integers(-MAX_X, MAX_X, (D, N_BEFORE)) // (1000 if is_small else 1)
    psi = rng.integers(-size, size + 1, (D, n_psi)).astype(np.int32)
    alpha = rng.integers(0, 3, (N_GROUPS, plan.n_splits)).astype(np.uint8)
    adds = rng.integers(-size, size + 1, (D, n_adds)).astype(np.int32)
    args = plan, quantisers[:N_CLASSES], quantisers[N_CLASSES:], tables, psi, alpha, adds
    compiled, plain = x.copy(), x.copy()
    broken = apply_step(compiled, *args)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(module, "loops", lambda: None)
        assert apply_step(plain, *args) == broken
    assert broken is None or not is_small
    if broken is None:
        assert np.array_equal(compiled, plain)


@pytest.mark.parametrize("q", [0, 1, -(1 << 22)])
def test_of_a_step_past_64_bits_0_alone_is_in_range(q):
    kinds = np.array([Kind.REFINE], np.uint8)
    plan = StepPlan.of(np.zeros(1, np.int32), kinds, 1, 0)
    quantisers, tables = [Quantiser(1, 62)] * N_CLASSES, [AlphaTable(0, (1,))] * N_GROUPS
    x, psi = np.zeros((D, 1), np.int32), np.full((D, 1), q, np.int32)
    alpha, adds = np.zeros((N_GROUPS, 0), np.uint8), np.zeros((D, 0), np.int32)
    broken = apply_step(x, plan, quantisers, quantisers, tables, psi, alpha, adds)
    assert broken == (None if q == 0 else 0)
