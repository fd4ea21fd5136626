"""One step at the limits, by the compiled loops and by numpy: the same integers and faults."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec.encoding.write import write
from evogs_codec.format import pack
from evogs_codec.format.planes import Coding
from evogs_codec.model.arithmetic import MAX_X, SYMMETRIC, AlphaTable, Quantiser
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.tree import Kind
from tests.support.compiled_loops import both_verdicts, written_at_random

pytest.importorskip(
    "evogs_codec.decoding.compiled.channels", reason="numba is not installed: no kernels"
)

NO_SLOTS, NO_KINDS = np.zeros(0, np.int32), np.zeros(0, np.uint8)


def adding(adds):
    """A step of adds, (14, n) integers."""
    return CodedStep(
        0, NO_SLOTS, NO_KINDS, np.zeros((5, 0), np.uint8), np.zeros((14, 0), np.int32), adds
    )


def changing(slots, kinds, psi, alpha=None):
    """A step of records; (14, P) integers and (5, S) indices, all 0 by default."""
    n_splits = int(np.count_nonzero(kinds == Kind.SPLIT))
    indices = np.zeros((5, n_splits), np.uint8) if alpha is None else alpha
    return CodedStep(0, slots.astype(np.int32), kinds, indices, psi, np.zeros((14, 0), np.int32))


def tile_of(steps, *, of_adds, of_psi, table=SYMMETRIC, low=-MAX_X, high=MAX_X):
    """A tree of one tile and level."""
    return CodedTree(
        sh_degree=0,
        n_levels=1,
        grid_exponents=(0,) * 5,
        quantisers=((of_adds,) * 5, (of_psi,) * 5),
        alpha=dict.fromkeys([(0, group) for group in range(5)], table),
        tiles=(CodedTile((0, 0, 0), (low,) * 3, (high,) * 3, tuple(steps)),),
    )


def one_step(n, chosen, kinds, *, table, quantiser, psi, spread, seed):
    """A stream of n adds up to `spread` and a step of records; every channel draws its q."""
    rng = np.random.default_rng(seed)
    n_splits = int(np.count_nonzero(kinds == Kind.SPLIT))
    n_psi = int(np.count_nonzero(kinds != Kind.DROP))
    adds = rng.integers(-spread, spread + 1, (14, n)).astype(np.int32)
    q = rng.integers(-psi, psi + 1, (14, n_psi)).astype(np.int32)
    alpha = rng.integers(0, len(table.entries), (5, n_splits)).astype(np.uint8)
    steps = adding(adds), changing(chosen, kinds, q, alpha)
    tree = tile_of(steps, of_adds=Quantiser(64, 0), of_psi=quantiser, table=table)
    return written_at_random(tree, seed)


def filled(value, n=1):
    return np.full((14, n), value, np.int32)


def agreed_verdict(tree):
    """ "legal" or the fault code, however the stream is written."""
    found = set()
    for seed in range(6):
        of_numpy, of_kernels = both_verdicts(written_at_random(tree, seed))
        assert of_kernels == of_numpy
        found.add("legal" if isinstance(of_numpy, bytes) else of_numpy[0])
    (code,) = found
    return code


# --- bounds to the unit ---------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("n", [pytest.param(1, marks=pytest.mark.thorough), 3])
@pytest.mark.parametrize("n_splits", [0, pytest.param(1, marks=pytest.mark.thorough), 3])
def test_states_are_bounded_to_the_unit_on_both_sides(sign, n, n_splits):
    kinds = np.array([Kind.SPLIT] * min(n_splits, n) + [Kind.REFINE] * max(n - n_splits, 0))
    quarter, slots, coarse = 1 << 28, np.arange(n), Quantiser(64, 0)
    # From 2^28 on by the largest coarse steps, then a fine one to the bound or one over it.
    fourth, rest = divmod(MAX_X - 3 * quarter, coarse.step)
    refines = [
        changing(slots, np.full(n, Kind.REFINE, np.uint8), filled(sign * q, n))
        for q in (quarter // coarse.step, quarter // coarse.step, fourth)
    ]
    for over, expected in ((0, "legal"), (1, "E_RANGE")):
        last = changing(slots, kinds.astype(np.uint8), filled(sign * (rest + over), n))
        steps = [adding(filled(sign * (quarter >> 14), n)), *refines, replace(last, level=1)]
        tree = tile_of(steps, of_adds=Quantiser(1 << 14, 0), of_psi=coarse)
        finer = (*tree.quantisers, (Quantiser(1, 0),) * 5)
        assert agreed_verdict(replace(tree, n_levels=2, quantisers=finer)) == expected


@pytest.mark.parametrize("kind", [Kind.REFINE, Kind.SPLIT])
@pytest.mark.parametrize(("psi", "is_legal"), [(5, True), (-5, True), (6, False), (-6, False)])
def test_boxes_bound_positions_to_the_unit_on_both_sides(kind, psi, is_legal):
    step = changing(np.arange(2), np.full(2, kind, np.uint8), filled(psi, 2))
    unit = Quantiser(1, 0)
    tree = tile_of([adding(filled(0, 2)), step], of_adds=unit, of_psi=unit, low=-5, high=5)
    assert agreed_verdict(tree) == ("legal" if is_legal else "E_RANGE")
    added = tile_of([adding(filled(psi, 2))], of_adds=unit, of_psi=unit, low=-5, high=5)
    assert agreed_verdict(added) == ("legal" if is_legal else "E_RANGE")


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("n_refines", [pytest.param(0, marks=pytest.mark.thorough), 2])
@pytest.mark.parametrize(
    ("shift", "a", "mantissa", "q", "is_legal"),
    [
        (0, 4, 32768, 8192, True),  # 2^30
        (1, 7, 49981, 3069, True),  # 2^30 - 1, and 1 of rounding
        (1, 4, 32768, 8192, False),  # 2^30, and 1 of rounding
        (12, -32768, 1, 32768, False),
        (12, -32768, 1, 32767, True),
    ],
)
def test_products_are_bounded_to_the_unit(sign, n_refines, shift, a, mantissa, q, is_legal):
    kinds = np.array([Kind.SPLIT] + [Kind.REFINE] * n_refines, np.uint8)
    step = changing(np.arange(len(kinds)), kinds, filled(sign * q, len(kinds)))
    tree = tile_of(
        [adding(filled(sign, len(kinds))), step],  # C2 of the first row is at the bound of X
        of_adds=Quantiser(1, 0),
        of_psi=Quantiser(mantissa, 0),
        table=AlphaTable(shift, (a, 0)),
    )
    assert agreed_verdict(tree) == ("legal" if is_legal else "E_RANGE")


@pytest.mark.parametrize(("shift", "is_legal"), [(24, True), (25, False)])
def test_a_colour_may_be_larger_than_its_coding_says(shift, is_legal):
    psi = filled(0)
    psi[11:14, 0] = 16, 0, -16  # Y = 0, Co = 32, Cg = 0: nothing is stored in the place of R
    quantiser = Quantiser(1 << (shift - 24), 24)
    step = changing(np.arange(1), np.array([Kind.REFINE], np.uint8), psi)
    tree = tile_of([adding(filled(0)), step], of_adds=Quantiser(1, 0), of_psi=quantiser)
    assert agreed_verdict(tree) == ("legal" if is_legal else "E_RANGE")


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("last", "is_legal"), [(32, True), (33, False)])
def test_running_sums_are_refused_just_above_2_to_the_28(sign, last, is_legal):
    largest = (1 << 23) - 1
    q = sign * np.array([largest] * 32 + [last])  # 2^28 - 32 + last
    adds = np.tile(np.cumsum(q), (14, 1)).astype(np.int32)

    def with_delta(z, *, is_delta=False):
        return (Coding(8, 2, is_delta) if z.size else Coding(0, 0)), float(not is_delta)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pack, "choose_coding", with_delta)
        patch.setattr(pack, "decorrelate", lambda values, _sh: (values, False))
        data = write(
            tile_of([adding(adds)], of_adds=Quantiser(1, 0), of_psi=Quantiser(1, 0)), digests=False
        )
    of_numpy, of_kernels = both_verdicts(data)
    assert of_kernels == of_numpy
    assert isinstance(of_numpy, bytes) == is_legal


# --- steps of any size ----------------------------------------------------------------------------


def records(shape, n, rng):
    """Slots and kinds: all in a row or scattered, all split or mixed."""
    scattered, mixed = shape
    chosen = np.flatnonzero(rng.random(n) < 0.6) if scattered else np.arange(n // 3, n)
    some = rng.choice([Kind.REFINE, Kind.SPLIT, Kind.SPLIT, Kind.DROP], len(chosen))
    kinds = some if mixed else np.full(len(chosen), Kind.SPLIT)
    return chosen, kinds.astype(np.uint8)


@pytest.mark.thorough
@pytest.mark.parametrize("shift", range(13))
@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("mixed", [False, True])
def test_splits_agree_for_every_shift_up_to_the_bounds_of_products_and_states(
    shift, scattered, mixed
):
    accepted = refused = 0
    for seed in range(24):
        rng = np.random.default_rng(seed)
        chosen, kinds = records((scattered, mixed), 37 + seed % 8, rng)
        entries = tuple(rng.integers(-(1 << 15), 1 << 15, 1 + seed % 3).tolist())
        largest = max(1, *(abs(a) for a in entries))
        room = max(1, (1 << 30) // largest)  # |Delta| just within the product, or just over it
        step, n_steps = (room // 16, 16 + seed % 2) if room > 16 else (1, room)
        data = one_step(
            37 + seed % 8,
            chosen,
            kinds,
            table=AlphaTable(shift, entries if seed % 4 else (1,)),
            quantiser=Quantiser(min(max(step, 1), 65535), 0),
            psi=n_steps,
            spread=(1 << 22) if seed % 3 == 0 else 1000,
            seed=seed,
        )
        of_numpy, of_kernels = both_verdicts(data)
        assert of_kernels == of_numpy, seed
        accepted += isinstance(of_numpy, bytes)
        refused += not isinstance(of_numpy, bytes)
    assert accepted
    assert shift > 0 or refused


@pytest.mark.parametrize(
    "quantiser",
    [Quantiser(1, 24), Quantiser(255, 20), Quantiser(256, 20), Quantiser(65535, 24)],
    ids=lambda quantiser: f"step {quantiser.step}",
)
@pytest.mark.parametrize(
    "psi", [*(pytest.param(psi, marks=pytest.mark.thorough) for psi in (0, 1, 1000)), 16, 17]
)
def test_steps_up_to_the_largest_give_the_same_integers_and_faults(quantiser, psi):
    found = set()
    for seed in range(8):
        chosen, kinds = records((seed % 2, seed % 3), 21, np.random.default_rng(seed))
        data = one_step(
            21,
            chosen,
            kinds,
            table=SYMMETRIC,
            quantiser=quantiser,
            psi=psi,
            spread=100,
            seed=seed,
        )
        of_numpy, of_kernels = both_verdicts(data)
        assert of_kernels == of_numpy, seed
        found.add(isinstance(of_numpy, bytes))
    assert found == {psi <= quantiser.max_q}


@pytest.mark.parametrize("n_psi", [1, 4095, 4096, 4097, 9000])
@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("psi", [pytest.param(0, marks=pytest.mark.thorough), 300])
def test_steps_of_any_length_agree(n_psi, scattered, mixed, psi):
    rng = np.random.default_rng(n_psi)
    n = 2 * n_psi
    chosen = (
        np.sort(rng.permutation(n)[:n_psi])
        if scattered
        else np.arange(n_psi // 3, n_psi // 3 + n_psi)
    )
    some = rng.choice([Kind.REFINE, Kind.SPLIT, Kind.DROP], n_psi)
    data = one_step(
        n,
        chosen,
        (some if mixed else np.full(n_psi, Kind.SPLIT)).astype(np.uint8),
        table=AlphaTable(3, (5, -7, 8)),
        quantiser=Quantiser(3, 1),
        psi=psi,
        spread=1000,
        seed=n_psi,
    )
    of_numpy, of_kernels = both_verdicts(data)
    assert isinstance(of_numpy, bytes)
    assert of_kernels == of_numpy
