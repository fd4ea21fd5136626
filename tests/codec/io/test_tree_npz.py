"""`.tree.npz`: what is written reads back, and row order is honoured."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec.io.tree_npz import _Slots, read_tree, write_tree
from evogs_codec.model.channels import GROUP_CHANNELS, n_channels
from evogs_codec.model.tree import EvolutionTree, Step
from tests.support.examples import examples
from tests.support.strategies import trees
from tests.support.tree_files import (
    ADD,
    DROP,
    FIELDS,
    RECORDS,
    REFINE,
    SPLIT,
    file_of,
    npz_bytes,
    read_back,
)


@pytest.fixture
def read(tmp_path):
    """Write arrays as a `.tree.npz`, and read it."""
    return lambda data: read_back(tmp_path, data)


def replay(data, level):
    """Leaves of a file by the letter of design.md, one record at a time: {slot: (D,)}."""

    def column(prefix, row):
        return np.concatenate([np.ravel(data[prefix + name][row]) for name in FIELDS]).astype(float)

    slots = {row: column("", row) for row in range(len(data["means"]))}
    n = len(slots)
    for i in range(1, level + 1):
        generations = data[f"L{i}_generation"].tolist()
        for row in sorted(range(len(generations)), key=lambda r: (generations[r], r)):
            slot, kind = int(data[f"L{i}_slot"][row]), data[f"L{i}_kind"][row]
            psi = column(f"L{i}_psi_", row)
            if kind == ADD:
                slots[n] = psi
                n += 1
                continue
            parent = slots.pop(slot)
            if kind == SPLIT:
                alpha = np.empty(len(psi))
                for group, channels in enumerate(GROUP_CHANNELS):
                    alpha[channels] = data[f"L{i}_alpha"][row, group]
                slots[n] = parent - alpha * psi
                n += 1
            if kind != DROP:
                slots[slot] = parent + psi
    return slots


def same_splats(leaves, slots):
    """The leaves are the splats of `slots`, in some order."""
    found = leaves.channels().T
    expected = np.array(list(slots.values()), np.float32).reshape(len(slots), found.shape[1])
    np.testing.assert_array_equal(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)])


@given(tree=trees())
@examples(80)
def test_a_written_tree_reads_back_with_the_same_leaves_at_every_level(tmp_path_factory, tree):
    path = tmp_path_factory.getbasetemp() / "t.tree.npz"
    write_tree(path, tree)
    again = read_tree(path)
    assert again.n_levels == tree.n_levels
    for level in range(tree.n_levels):
        expected = tree.leaves(level).channels()
        np.testing.assert_array_equal(again.leaves(level).channels(), expected)


@st.composite
def files(draw):
    """Arrays of a valid file, its records in any row order."""
    degree = draw(st.integers(0, 1))
    numbers = st.integers(-4, 4)
    roots = draw(st.lists(numbers, max_size=5))
    live, n, levels = list(range(len(roots))), len(roots), []
    for _ in range(draw(st.integers(0, 3))):
        records = []
        for generation in draw(st.lists(st.integers(0, 9), max_size=3, unique=True).map(sorted)):
            named = draw(st.lists(st.sampled_from(live), unique=True)) if live else []
            kinds = [draw(st.sampled_from([REFINE, SPLIT, DROP])) for _ in named]
            rows = list(zip(named, kinds, strict=True)) + [(-1, ADD)] * draw(st.integers(0, 2))
            rows = draw(st.permutations(rows))
            records += [(s, k, generation, draw(numbers), draw(numbers)) for s, k in rows]
            live = [slot for slot in live if (slot, DROP) not in rows]
            n_new = sum(kind in (SPLIT, ADD) for _, kind in rows)
            live += range(n, n + n_new)
            n += n_new
        levels.append(records)
    return file_of(roots, *levels, degree=degree)


@given(data=files())
@examples(150)
def test_leaves_agree_with_a_replay_record_by_record_in_row_order(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "t.tree.npz"
    np.savez(path, **data)
    tree = read_tree(path)
    assert tree.n_levels == 1 + sum(key.endswith("_slot") for key in data)
    for level in range(tree.n_levels):
        same_splats(tree.leaves(level), replay(data, level))


def test_new_slots_are_numbered_in_row_order_and_named_by_later_generations(read):
    # Rows make slots 2 (add), 3 (C2 of 1) and 4 (C2 of 0); the tree has them as 4, 3 and 2.
    first = [(-1, ADD, 0, 100, 0), (1, SPLIT, 0, 1, 1), (0, SPLIT, 0, 2, 1)]
    later = [(4, REFINE, 1, 0.5, 0), (3, DROP, 1, 0, 0), (2, REFINE, 2, 7, 0)]
    tree = read(file_of([10, 20], first + later))
    assert [step.slots.tolist() for step in tree.steps] == [[], [0, 1], [2, 3], [4]]
    assert tree.leaves().opacity_logits.tolist() == [12, 21, 8.5, 107]


def test_generations_may_come_in_any_row_order_and_skip_numbers(read):
    rows = [(0, REFINE, 200, 1, 0), (1, REFINE, 3, 5, 0), (0, SPLIT, 3, 2, 1)]
    tree = read(file_of([0, 0], rows))
    assert len(tree.steps) == 3
    assert tree.leaves().opacity_logits.tolist() == [3, 5, -2]


def test_levels_without_records_are_kept(read):
    tree = read(file_of([1], [], [(0, REFINE, 0, 1, 0)], []))
    assert [step.level for step in tree.steps] == [0, 1, 2, 3]
    assert [tree.leaves(i).opacity_logits.tolist() for i in range(4)] == [[1], [1], [2], [2]]


def test_a_file_of_roots_only_is_a_tree_of_one_level(read):
    assert read(file_of([1, 2, 3])).n_levels == 1
    assert read(file_of([], degree=3)).n_leaves == 0


def test_other_number_types_and_unused_numbers_are_accepted(read):
    data = file_of([1.0, 2.0], [(0, DROP, 0, 0, 0), (1, REFINE, 0, 1, 0)], [])
    for key in ("L1_slot", "L1_kind", "L1_generation"):
        data[key] = data[key].astype(np.int64)
    data["L2_slot"] = np.zeros(0)  # what np.array([]) is
    data["means"] = data["means"].astype(np.float64)
    data["L1_psi_sh"] = data["L1_psi_sh"].astype(np.float16)
    data["L1_psi_means"][0] = np.nan  # of a drop
    data["L1_alpha"][:] = np.inf  # of no split
    data["author"] = np.array("somebody")
    data["means"] = np.asfortranarray(data["means"])
    assert read(data).leaves().opacity_logits.tolist() == [3]


def test_a_chain_of_64_generations_and_300_in_one_level_are_kept(tmp_path):
    d = n_channels(0)
    one = np.ones((d, 1), np.float32)
    for n in (64, 300):
        refine = Step(1, np.zeros(1, np.int32), np.zeros(1, np.uint8), one, one[:5, :0], one[:, :0])
        tree = EvolutionTree(0, (Step.of_adds(0, one), *[refine] * n))
        write_tree(tmp_path / "chain.tree.npz", tree)
        again = read_tree(tmp_path / "chain.tree.npz")
        assert len(again.steps) == n + 1
        assert again.leaves().opacity_logits.tolist() == [n + 1]


def test_many_generations_do_not_copy_all_slots_each():
    slots = _Slots(3)
    rooms, bases = set(), []
    for k in range(2000):
        slots.extend(np.array([3 + k]))
        rooms.add(id(slots.live.base))
        bases.append(slots.live.base)  # so that no number is given twice
        assert slots.live[-1]
    np.testing.assert_array_equal(slots.tree_slot, np.arange(2003))
    assert len(rooms) < 20


def test_quanta_are_kept(read):
    data = file_of([1.0, 2.0], [(0, SPLIT, 0, 0.5, 1.0)]) | {"quanta": np.full((3, 5), 0.25)}
    assert read(data).quanta == ((0.25,) * 5,) * 3


def test_writing_twice_gives_the_same_bytes(tmp_path):
    tree = EvolutionTree(0, (Step.of_adds(0, np.ones((n_channels(0), 2), np.float32)),))
    for name in ("a", "b"):
        write_tree(tmp_path / name, tree)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_compressed_file_is_read(tmp_path):
    path = tmp_path / "t.tree.npz"
    path.write_bytes(npz_bytes(file_of([1, 2, 3], RECORDS), np.savez_compressed))
    assert read_tree(path).n_leaves == 4


def test_a_text_of_either_byte_order_is_read(read):
    for kind in ("<U13", ">U13", "S13"):
        assert read(file_of([1]) | {"format": np.array("evogs-tree 1", kind)}).n_leaves == 1


def test_the_trained_tree_is_read_and_survives_a_round_trip(shared, tmp_path):
    tree = read_tree(shared / "data" / "trees" / "lego400.tree.npz")
    assert (tree.n_levels, tree.n_leaves, tree.sh_degree) == (4, 99_909, 2)
    assert len(tree.leaves(0)) == 1973
    write_tree(tmp_path / "t.tree.npz", tree)
    again = read_tree(tmp_path / "t.tree.npz")
    np.testing.assert_array_equal(again.leaves().channels(), tree.leaves().channels())


def test_the_trained_tree_agrees_with_a_replay_of_its_first_level(shared):
    path = shared / "data" / "trees" / "lego400.tree.npz"
    with np.load(path) as data:
        slots = replay(dict(data), 1)
    same_splats(read_tree(path).leaves(1), slots)
