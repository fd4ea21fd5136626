"""Integers in are integers out, for every tree that hypothesis can make."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given

from conformance.decoders import oracle
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.extract import extract
from evogs_codec.editing.read_tree import read_coded_tree
from evogs_codec.encoding.write import write
from evogs_codec.model.arithmetic import AlphaTable, Quantiser
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.tree import Kind
from tests.support.coded_strategies import coded_trees
from tests.support.examples import examples

MANY = examples(40)


def assert_same_tree(got: CodedTree, given_: CodedTree) -> None:
    for name in ("sh_degree", "n_levels", "grid_exponents", "quantisers", "alpha", "info"):
        assert getattr(got, name) == getattr(given_, name), name
    assert len(got.tiles) == len(given_.tiles)
    for tile, expected in zip(got.tiles, given_.tiles, strict=True):
        assert tile.origin == expected.origin
        assert (tile.box_min, tile.box_max) == (expected.box_min, expected.box_max)
        assert len(tile.steps) == len(expected.steps)
        for step, wanted in zip(tile.steps, expected.steps, strict=True):
            assert step.level == wanted.level
            assert step.error == wanted.error
            for name in ("slots", "kinds", "alpha", "psi", "adds"):
                np.testing.assert_array_equal(getattr(step, name), getattr(wanted, name), name)


def one_tile(adds: np.ndarray, *steps: CodedStep, quantiser: Quantiser) -> CodedTree:
    """SH degree 0, one level, boxes as wide as they may be."""
    roots = CodedStep(
        0,
        np.zeros(0, np.int32),
        np.zeros(0, np.uint8),
        np.zeros((5, 0), np.uint8),
        np.zeros((len(adds), 0), np.int32),
        adds.astype(np.int32),
    )
    largest = (1 << 30) - 1
    box = (-largest,) * 3, (largest,) * 3
    tile = CodedTile((0, 0, 0), *box, (roots, *steps))
    return CodedTree(0, 1, (0,) * 5, ((quantiser,) * 5,) * 2, {}, (tile,))


def kept(slot: int, kind: Kind, d: int = 14) -> CodedStep:
    """A record that changes nothing but liveness."""
    n_psi, n_splits = int(kind != Kind.DROP), int(kind == Kind.SPLIT)
    return CodedStep(
        0,
        np.array([slot], np.int32),
        np.array([kind], np.uint8),
        np.zeros((5, n_splits), np.uint8),
        np.zeros((d, n_psi), np.int32),
        np.zeros((d, 0), np.int32),
    )


NOTHING = one_tile(np.zeros((14, 0)), quantiser=Quantiser(1, 0))
ONE_ROOT = one_tile(np.ones((14, 1)), quantiser=Quantiser(1, 24))
ALL_DROPPED = one_tile(np.ones((14, 1)), kept(0, Kind.DROP), quantiser=Quantiser(9, 3))
MANY_EQUAL_ROOTS = one_tile(np.zeros((14, 30000)), quantiser=Quantiser(65535, 24))


@pytest.mark.thorough
@MANY
@given(coded_trees())
@example(NOTHING)
@example(ONE_ROOT)
@example(ALL_DROPPED)
@example(MANY_EQUAL_ROOTS)
def test_the_records_of_a_stream_are_the_records_that_were_written(tree):
    assert_same_tree(read_coded_tree(write(tree, zstd_level=1)), tree)


@MANY
@given(coded_trees())
@example(ALL_DROPPED)
def test_the_decoder_and_the_oracle_decode_the_same_integers(tree):
    data = write(tree, zstd_level=1)
    decoded = decode(data, verify=True)
    scene = oracle.decode(data, check_digests=True)
    assert decoded.dump() == scene.dump()
    for tile, state in enumerate(decoded.tiles):
        for component in range(tree.sh_degree + 1):
            assert state.digest(component) == scene.state_digest(tile, component)


@examples(20)
@given(coded_trees(max_tiles=2))
def test_the_float_view_is_the_exact_value_rounded_once(tree):
    data = write(tree, zstd_level=1, digests=False)
    splats = decode(data).leaves(sh_degree=tree.sh_degree).channels().T
    assert [tuple(row) for row in splats.tolist()] == oracle.decode(data).float_view()


@examples(20)
@given(coded_trees(max_tiles=2))
def test_digests_change_no_integer_and_writing_again_changes_no_byte(tree):
    data = write(tree, zstd_level=1)
    assert write(read_coded_tree(data), zstd_level=1) == data
    plain = write(tree, zstd_level=1, digests=False)
    assert decode(plain).dump() == decode(data).dump()


@pytest.mark.thorough
def test_many_equal_new_slots_are_written_with_enough_bytes():
    n = 20000
    splits = CodedStep(
        0,
        np.arange(n, dtype=np.int32),
        np.full(n, Kind.SPLIT, np.uint8),
        np.zeros((5, n), np.uint8),
        np.zeros((14, n), np.int32),
        np.zeros((14, n), np.int32),
    )
    tree = one_tile(np.zeros((14, n)), splits, quantiser=Quantiser(1, 0))
    data = write(tree, zstd_level=1)
    assert_same_tree(read_coded_tree(data), tree)
    assert oracle.decode(data, check_digests=True).dump() == decode(data, verify=True).dump()


@pytest.mark.parametrize("q", [1 << 23, -(1 << 23) - 1])
def test_an_integer_of_more_than_24_bits_is_a_mistake_of_the_caller(q):
    with pytest.raises(ValueError, match="24 bits"):
        write(one_tile(np.full((14, 1), q), quantiser=Quantiser(1, 0)))


def test_an_alpha_table_of_256_entries_is_read_to_its_last():
    table = AlphaTable(12, tuple(range(-128, 128)))
    split = kept(0, Kind.SPLIT)
    step = replace(split, alpha=split.alpha + np.uint8(255))
    tree = one_tile(np.ones((14, 1)), step, quantiser=Quantiser(1, 0))
    tree = replace(tree, alpha={(0, group): table for group in range(5)})
    assert_same_tree(read_coded_tree(write(tree)), tree)


def test_a_stream_without_some_sh_packets_is_not_a_tree():
    step = kept(0, Kind.REFINE, d=23)
    tree = one_tile(np.ones((23, 1)), step, quantiser=Quantiser(1, 0))
    tree = replace(tree, sh_degree=1, quantisers=((Quantiser(1, 0),) * 6,) * 2)
    data = write(tree)
    late = extract(data, Cut(np.array([[1, 0]])))
    with pytest.raises(ValueError, match="fewer steps"):
        read_coded_tree(late)
