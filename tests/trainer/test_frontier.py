"""The tree's arithmetic: compiled against plain, gradients, split continuity, export."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from evogs_codec import EvolutionTree
from evogs_codec.model.tree import Kind
from evogs_codec.render import orbit, psnr, render
from reference_trainer.config import FrontierGrowth, Integers
from reference_trainer.export import frontier_steps, roots
from reference_trainer.models.backends import backend_for
from reference_trainer.models.blocks import evolve
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.cloud import Cloud
from reference_trainer.models.densify import ScreenGradients
from reference_trainer.models.evolution import Evolution
from reference_trainer.models.frontier import OPTIONS, Frontier
from reference_trainer.models.tensors import SplatTensors
from reference_trainer.run import run
from reference_trainer.runtime.progress import Progress
from tests.trainer import tiny
from tests.trainer.plain_torch import evolve_plain

CPU = torch.device("cpu")

PATH = CameraPath(np.zeros((1, 3)), 100.0)
GROWTH = FrontierGrowth(start=1, rounds=3, stop=0.3, threshold=0.0)


def grown(option="D", n=20, prune=(), seed=0, rest=False, first=True):
    """A frontier after three rounds, its variables shaken, some leaves dead; and its tree."""
    rng = np.random.default_rng(seed)
    tree = EvolutionTree(1, (roots(tiny.random_splats(rng, n)),))
    growth = replace(GROWTH, refines_rest=rest, refines_first=first)
    frontier = Frontier(SplatTensors.of(tree.leaves()), option, growth, PATH)
    for iteration in (1, 2, 3):
        scores = ScreenGradients(frontier.n_splats, CPU)
        scores.total += torch.from_numpy(rng.random(frontier.n_splats))
        scores.count += 1
        assert frontier.densify(iteration, 10, scores, 3 * n)
    for variable in frontier.variables():
        with torch.no_grad():
            variable.value += 0.1 * torch.from_numpy(rng.normal(size=variable.value.shape))
    frontier.live[list(prune)] = False
    return tree, frontier


@pytest.mark.parametrize("first", [False, True])
def test_a_mixed_tree_may_leave_out_the_refines_before_its_splits(first):
    tree, frontier = grown("M", first=first)
    kinds = [block.kind for block in frontier.blocks]
    assert kinds == ["refined"] * first + ["shrinking"] * 3
    steps = frontier_steps(tree, frontier, 1)
    assert len(steps) == len(kinds)
    whole = EvolutionTree(1, (*tree.steps, *steps))
    assert whole.n_leaves == frontier.n_splats


@pytest.mark.parametrize("rest", [False, True])
@pytest.mark.parametrize("option", OPTIONS)
def test_leaves_and_gradients_are_those_of_plain_torch(option, rest):
    _, frontier = grown(option, prune=(3, 25), rest=rest)
    live = np.flatnonzero(frontier.live)
    found = []
    for function in (evolve_plain, evolve, lambda *tree: Evolution(*tree).leaves()):
        leaves = function(frontier.base, frontier.blocks, live)
        weights = [torch.sin(torch.arange(x.numel()).reshape(x.shape).float()) for x in leaves]
        totals = [(x * w).sum() for x, w in zip(leaves, weights, strict=True)]
        torch.stack(totals).sum().backward()
        grads = [v.value.grad.clone() for v in frontier.variables()]
        for variable in frontier.variables():
            variable.value.grad = None
        found.append((leaves, grads))
    (expected, expected_grads), *others = found
    for leaves, grads in others:
        for one, other in zip(expected, leaves, strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=1e-6)
        for one, other in zip(expected_grads, grads, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("seed", range(4))
def test_the_tree_decodes_to_the_trained_leaves(option, seed):
    rng = np.random.default_rng(seed)
    tree, frontier = grown(option, prune=rng.permutation(60)[: 15 * seed], seed=seed, rest=seed > 1)
    whole = EvolutionTree(1, (*tree.steps, *frontier_steps(tree, frontier, 1)))
    ours, theirs = frontier.splats(0).params().channels(), whole.leaves(1).channels()
    # Only the order differs: slots of the dead are used again.
    ours, theirs = (x[:, np.lexsort(x[:3].round(4))] for x in (ours, theirs))
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=5e-6)
    np.testing.assert_array_equal(whole.leaves(0).channels(), tree.leaves(0).channels())


def test_without_pruning_slots_of_the_tree_are_those_of_the_frontier():
    tree, frontier = grown()
    steps = frontier_steps(tree, frontier, 1)
    assert [list(step.slots) for step in steps] == [list(b.slots) for b in frontier.blocks]
    assert all((step.kinds == Kind.SPLIT).all() for step in steps)


def test_a_split_does_not_show():
    rng = np.random.default_rng(1)
    splats = tiny.random_splats(rng, 200)
    base = SplatTensors.of(splats)
    cameras = orbit(6, radius=4.0, width=96, height=96, fov_x=0.7)

    def worst(option, distance):
        growth = FrontierGrowth(start=1, rounds=1, threshold=-1.0, distance=distance)
        frontier = Frontier(base, option, growth, PATH)
        scores = ScreenGradients(200, CPU)
        scores.total += torch.from_numpy(rng.permutation(200) + 1.0)
        frontier.densify(1, 10, scores, 220)
        after = frontier.splats(0).params()
        return min(psnr(render(after, c), render(splats, c)) for c in cameras)

    assert worst("D", 0.3) > 34
    assert worst("D", 0.3) > worst("C", 0.3) + 5


def test_what_no_round_split_is_refined_if_that_is_asked_for():
    def moved(rest):
        _, frontier = grown(rest=rest)
        leaves = frontier.splats(0)
        same = (leaves.means[:20] == frontier.base.means).all(dim=1)
        return int((~same).sum())

    assert moved(rest=False) < moved(rest=True) == 20


def test_base_leaves_are_never_changed():
    _, frontier = grown()
    before = [x.clone() for x in frontier.base]
    leaves = frontier.splats(0)
    leaves.means.sum().backward()
    assert all(not x.requires_grad for x in frontier.base)
    assert all(torch.equal(x, y) for x, y in zip(before, frontier.base, strict=True))


def test_a_checkpointed_frontier_is_the_same():
    for option in OPTIONS:
        _, frontier = grown(option, prune=(1,), rest=True)
        other = Frontier(frontier.base, option, GROWTH, PATH)
        other.restore(frontier.arrays())
        for one, two in zip(frontier.splats(0), other.splats(0), strict=True):
            assert torch.equal(one, two)


@pytest.mark.parametrize("power", [0.0, 0.5])
def test_leaves_of_large_gradients_are_split_and_of_those_the_large_ones(power):
    splats = tiny.random_splats(np.random.default_rng(0), 6)
    sizes = np.full((6, 3), 0.01, np.float32)
    sizes[4, :2] = 0.09  # 3 in the square root
    splats = replace(splats, log_scales=np.log(sizes))
    growth = FrontierGrowth(start=1, rounds=1, threshold=0.5, size_power=power)
    frontier = Frontier(SplatTensors.of(splats), "D", growth, PATH)
    scores = ScreenGradients(6, CPU)
    scores.total += torch.tensor([0.4, 2.0, 0.1, 3.0, 1.2, 0.9], dtype=torch.float64)
    assert frontier.densify(1, 10, scores, 8)
    (block,) = frontier.blocks
    assert list(block.slots) == ([3, 4] if power else [1, 3])


def test_a_frontier_without_leaves_has_gradients_of_zero():
    _, frontier = grown("D")
    leaves = Evolution(frontier.base, frontier.blocks, np.array([], np.int64)).leaves()
    torch.stack([x.sum() for x in leaves]).sum().backward()
    assert all((v.value.grad == 0).all() for v in frontier.variables())


@pytest.mark.parametrize("method", ["evogs", "evogs-mixed", "evogs-a", "lapis"])
def test_runs_on_other_devices_are_those_of_the_processor(method, monkeypatch, tmp_path):
    """The way of GPUs, on the processor: tensors say that they are elsewhere."""
    config = tiny.config(method=method, integers=Integers(0.3 if method == "evogs" else 0.0))
    expected = run(config, tiny.pyramid(), backend_for("cpu"))
    monkeypatch.setattr(torch.Tensor, "is_cpu", False)
    whole = run(config, tiny.pyramid(), backend_for("cpu"))

    class StopError(Exception):
        """In the middle of the last stage."""

    class Stopping(Progress):
        def each(self, training):
            if isinstance(training.model, Frontier | Cloud) and training.iteration == 33:
                self.n_stages = getattr(self, "n_stages", 0) + 1
                if self.n_stages == 2:
                    raise StopError

    with pytest.raises(StopError):
        run(config, tiny.pyramid(), backend_for("cpu"), folder=tmp_path, progress=Stopping())
    resumed = run(config, tiny.pyramid(), backend_for("cpu"), folder=tmp_path, resume=True)
    for one, other, again in zip(expected.steps, whole.steps, resumed.steps, strict=True):
        np.testing.assert_array_equal(one.slots, other.slots)
        np.testing.assert_array_equal(other.slots, again.slots)
        np.testing.assert_array_equal(other.psi, again.psi)
        np.testing.assert_allclose(one.psi, other.psi, atol=0.02)
        np.testing.assert_allclose(one.adds, other.adds, atol=0.02)
