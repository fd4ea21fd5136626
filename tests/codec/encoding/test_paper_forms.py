"""The constructions of the paper and of the layered methods, and what each of them costs."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from conformance.decoders import oracle
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.settings import PRESETS, FixedSteps
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.packet_header import read_packet_header
from evogs_codec.format.planes import ABSENT
from evogs_codec.model.channels import GROUP_CHANNELS, n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step

NEAR_LOSSLESS = replace(PRESETS["near-lossless"], zstd_level=1)
TRAINED = replace(PRESETS["trained"], zstd_level=1)
STEPS = cast(FixedSteps, TRAINED.accuracy)
ROTATION, OPACITY = GROUP_CHANNELS[1], GROUP_CHANNELS[3]
# Lists of a core packet (spec 5.9).
GAPS, KINDS, ALPHAS, PSI, ADDS = 0, 1, range(2, 7), range(7, 21), range(21, 35)


def splats(n, degree=0, seed=0):
    """(D, n) float32, multiples of 2**-12: they are on the grids, so that nothing is corrected."""
    rng = np.random.default_rng(seed)
    return (rng.integers(-4096, 4096, (n_channels(degree), n)) / 4096).astype(np.float32)


def records(level, slots, kind, psi, alpha=1.0, adds=None):
    """A step of one kind; alpha is one number or (5, S)."""
    d = len(psi)
    n_splits = len(slots) if kind == Kind.SPLIT else 0
    return Step(
        level,
        np.asarray(slots, np.int32),
        np.full(len(slots), kind, np.uint8),
        psi[:, : 0 if kind == Kind.DROP else None],
        np.broadcast_to(np.float32(alpha), (5, n_splits)),
        np.zeros((d, 0), np.float32) if adds is None else adds,
    )


def independent_children(parents, first, second):
    """Options A and B: a split with alpha 0 makes P + psi and P; a refine of P makes the other."""
    n = parents.shape[1]
    return EvolutionTree(
        0,
        (
            Step.of_adds(0, parents),
            records(1, range(n), Kind.SPLIT, first - parents, alpha=0.0),
            records(1, range(n, 2 * n), Kind.REFINE, second - parents),
        ),
    )


def assert_leaves(data: bytes, expected: SplatParams, level: int | None = None) -> None:
    """The leaves at a level, in any order, are the expected ones within 1.01 grid units."""
    directory = read_directory(data)
    cut = Cut.full(directory) if level is None else Cut.of_level(directory, level)
    decoded = decode(data, cut)
    assert decoded.dump() == oracle.decode(data, cut=cut.steps.tolist()).dump()
    got = decoded.leaves(sh_degree=directory.sh_degree).channels().T
    wanted = expected.channels().T
    assert len(got) == len(wanted)
    units = np.concatenate(
        [
            np.full(len(wanted.T[part]), 2.0**-exponent)
            for exponent, part in zip(directory.grid_exponents, GROUP_CHANNELS, strict=True)
        ]
    )
    if len(wanted):
        far = (np.abs(wanted[:, None] - got[None]) / (1.01 * units + 1e-7)).max(2)
        nearest = far.argmin(1)
        assert sorted(nearest.tolist()) == list(range(len(got)))
        assert far.min(1).max() <= 1


def lists_of(data: bytes, level: int, component: int = 0) -> list[set[int]]:
    """Per packet of a level and component the lists of integers that it stores."""
    directory = read_directory(data)
    rows = directory.packets
    core = [p for p in range(len(rows)) if rows["component"][p] == 0]
    out = []
    for p in range(len(rows)):
        same = [q for q in core if directory.steps[q] == directory.steps[p]]
        own = next(q for q in same if rows["tile"][q] == rows["tile"][p])
        if rows["component"][p] == component and rows["level"][own] == level:
            out.append(stored(directory, data, p, own, component))
    return out


def stored(directory: Directory, data: bytes, p: int, core: int, component: int) -> set[int]:
    offset, size = int(directory.offsets[p]), int(directory.packets["size"][p])
    if size == 0:
        return set()
    body = memoryview(data)[offset : offset + size]
    head = read_packet_header(body, component, directory.counts(core), offset)
    return {k for k, coding in enumerate(head.codings) if coding != ABSENT}


# --- options A to D of the paper --------------------------------------------------------------


@pytest.mark.parametrize(
    "spread", [1.0, 1 / 16], ids=["A: children anywhere", "B: children near P"]
)
def test_independent_children_are_a_split_with_alpha_0_and_a_refine(spread):
    parents = splats(7)
    first = parents + np.float32(spread) * splats(7, seed=1)
    second = parents + np.float32(spread) * splats(7, seed=2)
    data = encode(independent_children(parents, first, second), NEAR_LOSSLESS)
    children = np.concatenate([first, second], axis=1)
    assert_leaves(data, SplatParams.from_channels(parents), level=0)
    assert_leaves(data, SplatParams.from_channels(children), level=1)
    split, refine = lists_of(data, 1)
    assert not split & set(ALPHAS)  # one alpha for all: a table of an entry, nothing per record
    assert refine <= {GAPS, *PSI}
    assert read_directory(data).alpha_tables[1][0].entries == (0,)


def test_independent_children_are_also_adds_and_a_drop_of_the_parent():
    children = splats(8, seed=3)
    drop = records(1, range(4), Kind.DROP, splats(4), adds=children)
    data = encode(EvolutionTree(0, (Step.of_adds(0, splats(4)), drop)), NEAR_LOSSLESS)
    assert_leaves(data, SplatParams.from_channels(children))


def test_a_symmetric_tree_stores_no_alpha():
    tree = EvolutionTree(
        0,
        (
            Step.of_adds(0, splats(5)),
            records(1, range(5), Kind.SPLIT, splats(5, seed=1)),
            records(2, range(10), Kind.SPLIT, splats(10, seed=2)),
        ),
    )
    data = encode(tree, NEAR_LOSSLESS)
    assert b"ALFA" not in data[: read_directory(data).data_offset]
    for level in (0, 1, 2):
        assert_leaves(data, tree.leaves(level), level)
        assert not any(lists & set(ALPHAS) for lists in lists_of(data, level))


def test_an_asymmetric_tree_stores_an_index_per_split_and_group_where_alphas_differ():
    alpha = np.ones((5, 6), np.float32)
    alpha[0] = [0.5, -0.25, 2, 10, -1, 0]
    alpha[2] = -1
    tree = EvolutionTree(
        0,
        (
            Step.of_adds(0, splats(6)),
            records(1, range(6), Kind.SPLIT, splats(6, seed=1), alpha),
        ),
    )
    data = encode(tree, NEAR_LOSSLESS)
    (lists,) = lists_of(data, 1)
    assert lists & set(ALPHAS) == {ALPHAS[0]}  # scales share one alpha: a table of an entry
    assert set(read_directory(data).alpha) == {(1, 0), (1, 2)}
    assert_leaves(data, tree.leaves())


# --- layered methods --------------------------------------------------------------------------


def layers(*, resend_opacity: bool) -> EvolutionTree:
    """Three layers of adds, whose lower layers may get new opacities (LapisGS) or not (L3GS)."""
    steps = [Step.of_adds(0, splats(9, degree=1))]
    n = 9
    for level in (1, 2):
        new = splats(12, degree=1, seed=level)
        if resend_opacity:
            psi = np.zeros((n_channels(1), n), np.float32)
            psi[OPACITY] = splats(n, seed=10 + level)[OPACITY]
            steps.append(records(level, range(n), Kind.REFINE, psi, adds=new))
        else:
            steps.append(Step.of_adds(level, new))
        n += 12
    return EvolutionTree(1, tuple(steps))


def test_lapis_layers_are_adds_and_refines_that_hold_only_opacities():
    tree = layers(resend_opacity=True)
    data = encode(tree, NEAR_LOSSLESS)
    for level in (0, 1, 2):
        assert_leaves(data, tree.leaves(level), level)
    for level in (1, 2):
        (core,) = lists_of(data, level)
        assert core & set(PSI) == {PSI[OPACITY.start]}
        assert core >= set(ADDS)
        (band,) = lists_of(data, level, component=1)
        assert band == set(range(9, 18))  # the adds of the nine channels, no psi


def test_l3gs_layers_are_adds_alone():
    tree = layers(resend_opacity=False)
    data = encode(tree, NEAR_LOSSLESS)
    for level in (0, 1, 2):
        assert_leaves(data, tree.leaves(level), level)
        (core,) = lists_of(data, level)
        assert core == set(ADDS)


# --- what does not occur costs nothing --------------------------------------------------------


def test_a_drop_stores_its_slots_and_nothing_else():
    tree = EvolutionTree(
        1, (Step.of_adds(0, splats(6, 1)), records(1, [1, 4], Kind.DROP, splats(2, 1)))
    )
    data = encode(tree, NEAR_LOSSLESS)
    (core,) = lists_of(data, 1)
    assert core == {GAPS}
    assert lists_of(data, 1, component=1) == [set()]
    assert_leaves(data, tree.leaves())


def test_a_refine_stores_no_alpha_and_one_kind_stores_no_kinds():
    tree = EvolutionTree(
        0, (Step.of_adds(0, splats(6)), records(1, [1, 4], Kind.REFINE, splats(2, seed=1)))
    )
    data = encode(tree, NEAR_LOSSLESS)
    (core,) = lists_of(data, 1)
    assert core == {GAPS, *PSI}
    assert_leaves(data, tree.leaves())


def test_groups_and_sh_bands_whose_psi_are_0_cost_nothing():
    psi = splats(6, degree=2, seed=1)
    psi[ROTATION] = 0
    psi[14:23] = 0  # SH band 1
    tree = EvolutionTree(
        2, (Step.of_adds(0, splats(6, degree=2)), records(1, range(6), Kind.SPLIT, psi, alpha=0.5))
    )
    data = encode(tree, NEAR_LOSSLESS)
    (core,) = lists_of(data, 1)
    rotation = {PSI[channel] for channel in range(ROTATION.start, ROTATION.stop)}
    assert core == set(PSI) - rotation
    assert lists_of(data, 1, component=1) == [set()]
    assert len(lists_of(data, 1, component=2)[0]) == 15
    assert (1, 1) not in read_directory(data).alpha
    assert_leaves(data, tree.leaves())


def test_levels_without_records_have_no_packets():
    tree = EvolutionTree(0, (Step.of_adds(0, splats(3)), Step.of_adds(5, splats(2, seed=1))))
    data = encode(tree, NEAR_LOSSLESS)
    directory = read_directory(data)
    assert (directory.n_levels, len(directory.packets)) == (6, 2)
    for level in range(6):
        assert_leaves(data, tree.leaves(level), level)


# --- any shape --------------------------------------------------------------------------------


def test_several_generations_fit_in_one_level():
    steps = [Step.of_adds(0, splats(2))]
    for generation in range(5):
        n = 2 << generation
        psi = np.float32(0.5**generation) * splats(n, seed=generation)
        steps.append(records(1, range(n), Kind.SPLIT, psi, alpha=0.75))
    tree = EvolutionTree(0, tuple(steps))
    data = encode(tree, NEAR_LOSSLESS)
    assert tree.n_levels == 2
    assert_leaves(data, tree.leaves(0), 0)
    assert_leaves(data, tree.leaves(1), 1)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "child",
    [
        pytest.param(0, id="first children", marks=pytest.mark.thorough),
        pytest.param(-1, id="second children"),
    ],
)
def test_a_chain_of_64_generations_is_encoded_and_decoded(child):
    steps = [Step.of_adds(0, splats(1))]
    for generation in range(64):
        slot = [0] if child == 0 else [generation]
        psi = np.float32(0.1) * splats(1, seed=generation)
        steps.append(records(1 + generation // 2, slot, Kind.SPLIT, psi, alpha=-0.5))
    tree = EvolutionTree(0, tuple(steps))
    data = encode(tree, NEAR_LOSSLESS)
    assert tree.n_leaves == 65
    for level in (0, 10, 32):
        assert_leaves(data, tree.leaves(level), level)


def test_everything_may_be_dropped_and_come_again():
    drop = records(1, range(4), Kind.DROP, splats(4))
    again = Step.of_adds(2, splats(3, seed=1))
    tree = EvolutionTree(0, (Step.of_adds(0, splats(4)), drop, again))
    data = encode(tree, NEAR_LOSSLESS)
    for level, n in enumerate((4, 0, 3)):
        assert len(tree.leaves(level)) == n
        assert_leaves(data, tree.leaves(level), level)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("n", [0, 1])
def test_a_scene_may_have_one_root_or_none(n, degree):
    tree = EvolutionTree(degree, (Step.of_adds(0, splats(n, degree)),))
    for settings in (NEAR_LOSSLESS, TRAINED):
        data = encode(tree, settings)
        assert decode(data, verify=True).n_leaves == n
    assert_leaves(encode(tree, NEAR_LOSSLESS), tree.leaves())
    empty = EvolutionTree(degree, ())
    assert decode(encode(empty, TRAINED)).n_leaves == 0


def test_a_splat_may_be_larger_than_a_float_can_say():
    roots = splats(2)
    roots[7:10] = 1000  # logarithms of the standard deviations
    tree = EvolutionTree(0, (Step.of_adds(0, roots[:, :1]), Step.of_adds(1, roots[:, 1:])))
    assert_leaves(encode(tree, NEAR_LOSSLESS), tree.leaves())


def check_many_roots(n: int) -> None:
    tree = EvolutionTree(0, (Step.of_adds(0, splats(n)),))
    data = encode(tree, TRAINED)
    decoded = decode(data, verify=True)
    assert decoded.n_leaves == n
    got = np.sort(decoded.leaves().means, axis=0)
    expected = np.sort(tree.leaves().means, axis=0)
    assert np.abs(got - expected).max() <= STEPS.steps[0]  # adds have steps half as large
    assert len(data) < 16 * n


def test_twenty_thousand_roots_are_encoded_and_decoded():
    check_many_roots(20_000)


@pytest.mark.slow
def test_a_million_roots_are_encoded_and_decoded():
    check_many_roots(1_000_000)
