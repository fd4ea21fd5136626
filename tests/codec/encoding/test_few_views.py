"""The PSNR that a search goes by."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from evogs_codec.encoding.few_views import EVERY, N_DEVIATIONS_IN_SEARCH, FewViews
from evogs_codec.encoding.pictures import Divisible
from evogs_codec.encoding.search import Goal

N = 25
OF_EACH = np.linspace(30, 50, N)  # dB of each view: they differ far more than any splats


class Pictures:
    """Views that see each splats at so many dB more than others; counts what is drawn."""

    def __init__(self, numbers=None):
        self.numbers = np.arange(N) if numbers is None else numbers
        self.n_drawn = [0]

    def sensitivity(self, splats): ...

    def loss_gradient(self, splats, iteration): ...

    def psnr(self, splats):
        return float(self.psnr_of_each(splats).mean())

    def psnr_of_each(self, splats):
        self.n_drawn[0] += len(self.numbers)
        return OF_EACH[self.numbers] + splats.by + splats.odd[self.numbers]

    def divided(self, every):
        parts = (
            Pictures(self.numbers[::every]),
            Pictures(np.array([k for k in self.numbers if k % every], int)),
        )
        for part in parts:
            part.n_drawn = self.n_drawn
        return parts


def splats(by, odd=None):
    return SimpleNamespace(by=by, odd=np.zeros(N) if odd is None else odd)


def test_few_views_tell_that_splats_are_far_from_a_goal():
    views = Pictures()
    few = FewViews(views, Goal(43.0, 0.2))
    assert few.psnr(splats(0.0)) == pytest.approx(40)
    assert views.n_drawn == [N]
    assert few.psnr(splats(2.0)) == pytest.approx(42)
    assert views.n_drawn == [N + N // EVERY]


def test_all_views_judge_what_may_be_wanted():
    views = Pictures()
    few = FewViews(views, Goal(43.0, 0.2))
    few.psnr(splats(0.0))
    assert few.psnr(splats(3.1)) == pytest.approx(43.1)
    assert views.n_drawn == [2 * N]
    # Where the few do not agree, the others are drawn, too.
    odd = np.zeros(N)
    odd[0] = 5.0
    by = np.array([5.0, 0, 0, 0, 0])
    assert abs(2.0 + by.mean() - 3.0) < 0.2 + N_DEVIATIONS_IN_SEARCH * by.std()
    assert few.psnr(splats(2.0, odd)) == pytest.approx(42 + 5 / N)
    assert views.n_drawn == [3 * N]


def test_fewer_than_five_views_do_not_judge_alone():
    views = Pictures(np.arange(N - EVERY))
    few = FewViews(views, Goal(60.0, 0.2))
    for by in (0.0, 1.0):
        few.psnr(splats(by))
    assert views.n_drawn == [2 * (N - EVERY)]


def test_views_can_be_divided():
    pytest.importorskip("numba", reason="the rasterizer is compiled")
    from evogs_codec.render.camera import Camera
    from evogs_codec.render.demo_scene import make_scene
    from evogs_codec.render.views import Views

    scene = make_scene(60)
    views = Views.of(scene).within(32)
    assert isinstance(views, Divisible)
    few, others = views.divided(EVERY)
    assert (len(few.cameras), len(others.cameras)) == (5, 19)
    each = [part.psnr_of_each(scene.take(np.arange(30))) for part in (few, others)]
    whole = views.psnr(scene.take(np.arange(30)))
    assert np.concatenate(each).mean() == pytest.approx(whole)
    away = Camera.look_at([100, 0, 0], [200, 0, 0], width=32, height=32, fov_x=1.0)
    few, others = replace(views, cameras=[away, *views.cameras[:3]]).divided(EVERY)
    assert [*few.cameras, *others.cameras] == list(views.cameras[:3])
    few, others = replace(views, cameras=[away]).divided(EVERY)  # nothing is seen by any
    assert (few.cameras, others.cameras) == ([away], [])
