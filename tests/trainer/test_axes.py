"""Names of axes: the same splats with the least rotations, whose w is 1 and stays so."""

import numpy as np
import pytest
import torch

from evogs_codec import decode, encode
from evogs_codec.render import orbit, psnr, render
from reference_trainer.config import Integers, Rates
from reference_trainer.export import roots
from reference_trainer.models.adam import RateTable, Variable
from reference_trainer.models.axes import one_w, with_least_rotations
from reference_trainer.models.split import rotations
from reference_trainer.models.tensors import SplatTensors
from tests.trainer import tiny

MOST = np.tan(np.radians(62.8) / 2)  # no rotation of a cube's axes is farther from all 24


def covariances(channels):
    turn, scale = rotations(channels[3:7].T), np.exp(2.0 * channels[7:10].T)
    return np.einsum("nij,nj,nkj->nik", turn, scale, turn)


def test_they_are_the_same_splats_turned_as_little_as_can_be():
    before = roots(tiny.random_splats(np.random.default_rng(0), 500)).adds
    after = with_least_rotations(before)
    found, right = covariances(after), covariances(before)
    np.testing.assert_allclose(found, right, rtol=1e-4, atol=1e-5 * right.max())
    assert (after[3] == 1).all()
    assert np.linalg.norm(after[4:7], axis=0).max() <= MOST
    rest = [c for c in range(len(before)) if not 3 <= c < 10]
    np.testing.assert_array_equal(after[rest], before[rest])
    np.testing.assert_allclose(with_least_rotations(after), after, atol=1e-6)


def test_pictures_are_the_same():
    splats = tiny.random_splats(np.random.default_rng(1), 50)
    step = roots(splats)
    (camera,) = orbit(1, radius=4.0, width=64, height=64, fov_x=0.7)
    turned = type(splats).from_channels(with_least_rotations(step.adds))
    assert psnr(render(turned, camera), render(splats, camera)) > 60


def test_a_quaternion_of_zeros_means_no_rotation():
    splats = roots(tiny.random_splats(np.random.default_rng(2), 3)).adds
    splats[3:7, 1] = 0
    np.testing.assert_array_equal(with_least_rotations(splats)[3:7, 1], [1, 0, 0, 0])


@pytest.mark.parametrize("part", [0.0, 0.3])
def test_w_of_a_mixed_tree_is_that_of_all_and_takes_no_bytes(part):
    tree = tiny.trained(method="evogs-mixed", integers=Integers(part))
    w = [leaves.quats[:, 0] for leaves in tree.levels()]
    assert all((x == w[0][0]).all() for x in w)
    assert w[0][0] == pytest.approx(1, abs=0.1)  # a multiple of a quantum
    assert not any(step.psi[3].any() for step in tree.steps)
    if part:
        found = decode(encode(tree)).leaves().quats[:, 0]
        assert (found == found[0]).all()


def test_w_of_other_trees_moves():
    tree = tiny.trained(method="evogs")
    assert any(step.psi[3].any() for step in tree.steps)


def test_only_splats_of_one_w_above_0_have_one():
    splats = SplatTensors.of(tiny.random_splats(np.random.default_rng(3), 4))
    splats.quats[:, 0] = 0.5
    assert one_w(splats)
    splats.quats[:, 0] = -0.5
    assert not one_w(splats)
    splats.quats[:2, 0] = 0.5
    assert not one_w(splats)
    assert not one_w(splats.rows(torch.arange(0)))


def test_numbers_that_stay_are_not_moved():
    variable = Variable.of(torch.ones(3, 4), "rotation")
    variable.n_still = 1
    variable.value.grad = torch.full((3, 4), 0.1)
    variable.step(RateTable(Rates(), 1.0, 0.0))
    value = variable.value.detach()
    assert (value[:, 0] == 1).all()
    assert (value[:, 1:] < 1).all()
