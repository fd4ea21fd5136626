"""Small parts: Adam, learning rates, splits, the order of views."""

import numpy as np
import pytest
import torch

from reference_trainer.config import Integers, Rates
from reference_trainer.models.adam import RateTable, Variable
from reference_trainer.models.split import moment_matched, rotations, symmetric
from reference_trainer.train import view_of
from tests.trainer import tiny


class Constant(RateTable):
    def columns(self, group, d, n_still=0):
        return np.full(d, 0.01, np.float32)


def test_adam_is_torchs():
    rng = np.random.default_rng(0)
    start = torch.from_numpy(rng.normal(size=(7, 3)).astype(np.float32))
    ours, theirs = Variable.of(start.clone(), "scale"), start.clone().requires_grad_()
    adam = torch.optim.Adam([theirs], lr=0.01, eps=1e-15)
    for _ in range(5):
        gradient = torch.from_numpy(rng.normal(size=(7, 3)).astype(np.float32))
        ours.value.grad, theirs.grad = gradient.clone(), gradient
        ours.step(Constant(Rates(), 1.0, 0.0))
        adam.step()
    torch.testing.assert_close(ours.value, theirs, rtol=1e-5, atol=1e-6)


def test_a_variable_without_gradient_stays():
    variable = Variable.of(torch.ones(3), "opacity")
    variable.step(Constant(Rates(), 1.0, 0.0))
    assert variable.t == 0


def test_rows_keep_their_moments_and_new_ones_have_none():
    variable = Variable.of(torch.arange(4.0), "opacity")
    variable.m += torch.arange(4.0)
    other = variable.rows(torch.tensor([3, 1])).appended(torch.tensor([9.0]))
    assert other.value.tolist() == [3, 1, 9]
    assert other.m.tolist() == [3, 1, 0]


def test_position_rates_fall_all_the_way_and_others_at_the_end():
    rates = Rates(cool=0.1, cool_span=0.5)

    def at(group, progress, d=3):
        return RateTable(rates, 2.0, progress).columns(group, d)

    assert at("position", 0)[0] == pytest.approx(2 * rates.position)
    assert at("position", 1)[0] == pytest.approx(2 * rates.position_final)
    assert at("alpha", 0.5)[0] == pytest.approx(rates.alpha)
    assert at("alpha", 1)[0] == pytest.approx(0.1 * rates.alpha)
    assert list(at("sh", 0, 6)) == pytest.approx([rates.sh] * 3 + [rates.sh_rest] * 3)


def test_rates_of_integers_are_lower():
    rates = Rates(position_final=2e-6, sh=0.5, cool_span=0.2)
    lower = Integers(0.5, rate=0.1).rates(rates)
    assert lower.sh == pytest.approx(0.05)
    assert lower.position_final == pytest.approx(2e-7)
    assert lower.position == pytest.approx(2e-6)


@pytest.mark.parametrize("wrong", [{"part": 1.1}, {"part": -0.1}, {"distortion": 0.0}, {"rate": 0}])
def test_integers_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match="expected"):
        Integers(**wrong)


def test_a_moment_matched_split_keeps_the_covariance():
    splats = tiny.random_splats(np.random.default_rng(0), 50)
    psi, alpha = moment_matched(splats, 0.3)
    first = splats.channels() + psi.channels()
    second = splats.channels() - np.repeat(alpha.T, (3, 4, 3, 1, 12), axis=0) * psi.channels()

    def covariance(x):
        root = rotations(x[3:7].T) * np.exp(x[7:10].T)[:, None, :]
        return root @ root.transpose(0, 2, 1)

    apart = (first - second)[:3].T / 2
    mixture = (covariance(first) + covariance(second)) / 2 + apart[:, :, None] * apart[:, None, :]
    np.testing.assert_allclose(mixture, covariance(splats.channels()), rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose((first + second)[:3] / 2, splats.means.T, atol=1e-6)


def test_the_direction_of_a_split_has_a_fixed_sign():
    splats = tiny.random_splats(np.random.default_rng(0), 50)
    psi, alpha = symmetric(splats, 0.3)
    rows = np.arange(50)
    assert (psi.means[rows, np.abs(psi.means).argmax(axis=1)] > 0).all()
    assert (alpha == 1).all()


def test_every_view_comes_once_a_turn():
    order = [view_of(i, 7, (3,)) for i in range(21)]
    assert sorted(order[:7]) == sorted(order[7:14]) == list(range(7))
    assert order[:7] != order[7:14]
