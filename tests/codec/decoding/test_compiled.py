"""The compiled loops against numpy: the same integers, the same faults, the same floats."""

import random
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import settings as budget
from hypothesis import strategies as st

from evogs_codec.decoding import float_view, replay
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.decoding.decode import Decoded, decode, decode_leaves
from evogs_codec.encoding.write import write
from evogs_codec.format import frames, pack
from evogs_codec.format.planes import (
    MAX_STORED,
    Coding,
    inverse_ycocg,
    split_planes,
    unzigzag,
    ycocg,
)
from evogs_codec.model.arithmetic import MAX_X, SYMMETRIC, AlphaTable, Quantiser
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.tree import Kind
from tests.support import damage
from tests.support.coded_strategies import coded_trees
from tests.support.verdicts import verdict

kernels = pytest.importorskip(
    "evogs_codec.decoding.compiled.channels", reason="numba is not installed: no kernels"
)

SEEDS = st.integers(0, 2**32)
ALWAYS, NEVER = 0, 1 << 62  # slots from which on the compiled loops are used
CODINGS = [
    Coding(low, high, is_delta)
    for low in range(9)
    for high in range(3)
    for is_delta in (False, True)
    if low or high
]


@contextmanager
def compiled_from(n_slots):
    """Use the compiled loops from so many slots on."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatch, "MIN_COMPILED", n_slots)
        yield


def both_verdicts(data):
    """[of numpy, of the compiled loops]: dump, or fault code and offset."""
    found = []
    for n_slots in (NEVER, ALWAYS):
        with compiled_from(n_slots):
            found.append(verdict(data))
    return found


def written_at_random(tree, seed):
    """A stream of the tree whose codings and flags are not the best ones; frames store planes."""

    def any_coding(z, *, is_delta=False):
        chance = random.Random(f"{seed} {is_delta} {z.tobytes()!r}")  # threads ask in any order
        bits = int(z.max()).bit_length() if z.size else 0
        able = [c for c in CODINGS if c.bits >= bits and c.delta == is_delta]
        return (chance.choice(able) if bits else Coding(0, 0)), chance.random()

    def any_turn(values, sh):
        rows = values[sh]
        small = rows.size > 0 and int(np.abs(rows).max()) < MAX_STORED // 8
        if not small or random.Random(f"{seed} {rows.tobytes()!r}").random() < 0.3:
            return values, False
        turned = values.copy()
        turned[sh] = ycocg(rows)
        return turned, True

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pack, "choose_coding", any_coding)
        patch.setattr(pack, "decorrelate", any_turn)
        patch.setattr(frames, "compress", lambda plane, _effort: frames.store(plane))
        return write(tree, digests=False)


# --- whole streams -------------------------------------------------------------------------------


@budget(max_examples=100)
@given(coded_trees(max_tiles=2, max_adds=20), SEEDS)
def test_compiled_loops_decode_legal_streams_to_the_same_integers(tree, seed):
    of_numpy, of_kernels = both_verdicts(written_at_random(tree, seed))
    assert isinstance(of_numpy, bytes)
    assert of_kernels == of_numpy


@budget(max_examples=60)
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


@budget(max_examples=30)
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


# --- one step at the limits ----------------------------------------------------------------------


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


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("n_splits", [0, 1, 3])
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
@pytest.mark.parametrize("n_refines", [0, 2])
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
@pytest.mark.parametrize("psi", [0, 1, 16, 17, 1000])
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


# --- lists and floats ----------------------------------------------------------------------------


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


@pytest.mark.parametrize("n_psi", [1, 4095, 4096, 4097, 9000])
@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("mixed", [False, True])
def test_steps_of_any_length_agree(n_psi, scattered, mixed):
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
        psi=300,
        spread=1000,
        seed=n_psi,
    )
    of_numpy, of_kernels = both_verdicts(data)
    assert isinstance(of_numpy, bytes)
    assert of_kernels == of_numpy


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


@budget(max_examples=30)
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
