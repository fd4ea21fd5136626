"""What the benchmark does to trees: other orders, parents in place of children, energy of psi."""

import numpy as np
import pytest

from evogs_codec import EvolutionTree, Kind, Step, lift
from evogs_codec.io.tree_npz import write_tree
from evogs_codec.model.channels import GROUPS
from reference_trainer.evaluate import storage
from reference_trainer.models.backends import backend_for
from reference_trainer.run import run
from tests.trainer import tiny
from tools.bench.paper.foveal import foveal
from tools.bench.paper.options import with_parents
from tools.bench.paper.orders import Records, by_energy, by_opacity, reordered
from tools.bench.paper.psi import concentration, distribution, refinements
from tools.bench.paper.runs import Run, Views
from tools.bench.paper.streaming import CODINGS, N_CUTS, ORDERS, curve, raw_cuts

METHODS = ("evogs", "evogs-mixed", "evogs-sym", "evogs-b", "lapis", "l3gs")
D = 14


@pytest.fixture(scope="module")
def trees():
    data, backend = tiny.pyramid(), backend_for("cpu")
    return {name: run(tiny.config(method=name), data, backend) for name in METHODS}


def step(level, slots, kinds, psi, alpha=(), adds=()):
    """A step whose psi, alpha and adds are one number for all channels of a column."""
    return Step(
        level,
        np.array(slots, np.int32),
        np.array(kinds, np.uint8),
        np.tile(np.array(psi, np.float32), (D, 1)),
        np.tile(np.array(alpha, np.float32), (5, 1)),
        np.tile(np.array(adds, np.float32), (D, 1)),
    )


def small_tree():
    """Roots 10, 20, 30; the second is dropped, the first split, and its C2 (9) split again."""
    return EvolutionTree(
        0,
        (
            step(0, [], [], [], adds=[10, 20, 30]),
            step(1, [0, 1], [Kind.SPLIT, Kind.DROP], [1], [1]),
            step(1, [2, 3], [Kind.REFINE, Kind.SPLIT], [0.5, 2], [1]),
        ),
    )


def values(splats):
    return sorted(splats.opacity_logits.tolist())


def ordered(splats):
    x = splats.channels()
    return x[:, np.lexsort(x)]


def test_the_needs_of_records_are_what_wrote_their_slots():
    records = Records.of(small_tree())
    assert records.needs.tolist() == [-1, -1, -1, 0, 1, 2, 3]
    assert records.energy[3:].tolist() == pytest.approx(
        [D**0.5, np.inf, 0.5 * D**0.5, 2 * D**0.5], abs=1e-6
    )
    assert records.opacity.tolist() == [10, 20, 30, 11, 0, 30.5, 11]


def test_large_refinements_come_first_but_after_their_parents():
    records = Records.of(small_tree())
    # Roots by opacity; the drop; the split, whose child waits for it; the small refine.
    assert by_energy(records).tolist() == [2, 1, 0, 4, 3, 6, 5]


def test_a_prefix_of_an_order_is_a_scene():
    tree, records = small_tree(), Records.of(small_tree())
    cut, counts = reordered(tree, records, by_energy(records), [1, 3, 5, 6, 7])
    states = [values(state.splats()) for state in cut.states()]
    assert [states[n - 1] for n in counts] == [
        [30], [10, 20, 30], [9, 11, 30], [7, 11, 11, 30], [7, 11, 11, 30.5],
    ]  # fmt: skip


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("order", [by_energy, by_opacity])
def test_another_order_leads_to_the_same_leaves_at_every_level(trees, name, order):
    tree = trees[name]
    records = Records.of(tree)
    sequence = order(records)
    assert sorted(sequence.tolist()) == list(range(len(sequence)))
    place = np.argsort(sequence)
    needing = records.needs >= 0
    assert (place[records.needs[needing]] < place[needing]).all()
    n = len(sequence)
    other, _ = reordered(tree, records, sequence, [n // 3, n // 2, n])
    for level in range(tree.n_levels):
        assert np.array_equal(ordered(other.leaves(level)), ordered(tree.leaves(level)))


@pytest.mark.parametrize("name", METHODS)
def test_the_bytes_of_records_are_those_of_the_storage(trees, name):
    records = Records.of(trees[name])
    for level in range(2):
        n_bytes = records.n_bytes[records.level <= level].sum()
        assert n_bytes == storage(trees[name], name, level)


@pytest.mark.parametrize("order", ORDERS)
def test_the_last_cut_of_a_raw_stream_is_all_of_it(trees, order):
    method = ORDERS[order][0]
    cuts = list(raw_cuts(trees[method], order))
    sizes = [n_bytes for _, n_bytes, _ in cuts]
    assert len(cuts) == N_CUTS
    assert sizes == sorted(sizes)
    assert sizes[-1] == storage(trees[method], method, 1)
    last = cuts[-1][2]
    assert np.array_equal(ordered(last), ordered(trees[method].leaves()))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("coding", CODINGS)
def test_a_stream_ends_with_all_splats_in_every_coding(trees, order, coding):
    tree = trees[ORDERS[order][0]]
    rows = curve(tree, order, coding, lambda splats: float(len(splats)))
    assert rows[-1]["PSNR, dB"] == rows[-1]["splats"] == tree.n_leaves
    assert rows[-1]["cut"] == N_CUTS
    assert [row["bytes"] for row in rows] == sorted(row["bytes"] for row in rows)


def test_parents_replace_pairs_of_leaves_and_nothing_else():
    parents, n_pairs = with_parents(small_tree(), 1)
    # 9 was split into 11 and 7, which are a pair; 11 and 9 are none any more.
    assert (values(parents), n_pairs) == ([9, 11, 30.5], 1)
    assert with_parents(small_tree(), 0)[1] == 0


@pytest.mark.parametrize("name", ["evogs", "evogs-b"])
def test_without_its_last_pairs_a_level_has_that_many_splats_less(trees, name):
    parents, n_pairs = with_parents(trees[name], 1)
    assert n_pairs > 0
    assert len(parents) == trees[name].n_leaves - n_pairs


def test_energy_is_concentrated_where_psi_is_large():
    tree = small_tree()
    assert refinements(tree).shape == (D, 3)
    found = concentration(tree)["refinements"]
    assert found["curve"][0] == 0
    assert found["curve"][-1] == pytest.approx(100)
    # 4 of 5.25 are in the largest of three.
    assert found["needed"]["for 50%, %"] == pytest.approx(100 / 3)
    assert found["needed"]["for 80%, %"] == pytest.approx(200 / 3)


def test_a_distribution_has_all_groups_even_of_a_tree_without_refinements(trees):
    roots = EvolutionTree(0, small_tree().steps[:1])
    for tree in (trees["evogs"], roots):
        found = distribution(tree)
        assert list(found) == list(GROUPS)
        for group in found.values():
            assert len(group["centres"]) == len(group["density"])
            assert np.isfinite(group["density"]).all()


def test_the_fovea_is_a_tile_with_pixels(tmp_path):
    splats = tiny.random_splats(np.random.default_rng(1), 200)
    write_tree(tmp_path / "tree.tree.npz", lift(splats, 3))
    rows = foveal(
        Views(tiny.pyramid(3), 1), Run(tmp_path, "equal", "evogs", 0, {}, (), 0.0, "", (1, 1))
    )
    sizes = [row["bytes"] for row in rows]
    assert sizes[0] < sizes[1] < sizes[2]
    assert rows[0]["splats"] < rows[1]["splats"] < rows[2]["splats"]
    assert 0 < rows[0]["pixels inside, %"] < 100
    assert all(np.isfinite(row["inside, dB"]) for row in rows)
