"""Plain densification under a cap; a foundation that stays."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from reference_trainer.config import CloudGrowth
from reference_trainer.data.seeding import first_splats
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.cloud import Cloud
from reference_trainer.models.densify import ScreenGradients, largest, useless
from reference_trainer.models.tensors import SplatTensors
from tests.trainer import tiny

CPU = torch.device("cpu")

GROWTH = CloudGrowth(start=1, every=1, stop=1.0, prune_scale=1e9)


def cloud(n=10, below=0, growth=GROWTH):
    splats = SplatTensors.of(tiny.random_splats(np.random.default_rng(1), n))
    foundation = None
    if below:
        foundation = SplatTensors.of(tiny.random_splats(np.random.default_rng(2), below))
    path = CameraPath(np.zeros((1, 3)), 5.0)
    return Cloud(splats, growth, path, (0,), foundation=foundation, dynamic_opacity=below > 0)


def scores(n, high=()):
    found = ScreenGradients(n, CPU)
    found.total[list(high)] = 1.0 + torch.arange(len(high), dtype=torch.float64)
    found.count[:] = 1
    return found


@pytest.mark.parametrize("below", [0, 8])
@pytest.mark.parametrize("cap", [10, 19, 24, 100])
def test_growth_stays_under_the_cap(below, cap):
    model = cloud(below=below)
    n = model.n_splats
    for step in range(1, 6):
        model.densify(step, 10, scores(model.n_splats, range(model.n_splats)), cap)
        assert model.n_splats <= max(cap, n)
    if cap == 100:
        assert model.n_splats > 60


def test_a_narrow_splat_is_cloned_and_a_wide_one_becomes_two_smaller():
    model = cloud()
    with torch.no_grad():
        model.layer[2].value[3] = -6.0
        model.layer[2].value[7] = -1.0
    before = model.layer_splats()
    assert model.densify(1, 10, scores(10, [3, 7]), 100)
    after = model.layer_splats()
    assert len(after) == 12
    np.testing.assert_array_equal(after.means[9], before.means[3])
    np.testing.assert_allclose(after.log_scales[10:], -1 - np.log(1.6), rtol=1e-6)
    assert not (after.means == before.means[7]).all(axis=1).any()


def test_a_foundation_is_never_removed():
    model = cloud(below=6)
    assert model.foundation is not None
    with torch.no_grad():
        assert model.opacities is not None
        model.opacities.value[:] = -20.0
        model.layer[3].value[:] = -20.0
    model.densify(1, 10, scores(16), 16)
    assert (model.n_foundation, model.n_splats) == (6, 6)


def test_a_reset_lowers_every_opacity():
    model = cloud(below=3, growth=CloudGrowth(start=1, every=100, reset_every=2, stop=1.0))
    model.densify(2, 10, scores(13), 13)
    assert torch.sigmoid(model.splats(10**6).opacity_logits).max() < 0.0101


def test_bands_come_in_one_by_one():
    model = cloud(growth=CloudGrowth(sh_every=5))
    assert [model.splats(i).sh.shape[1] for i in (0, 4, 5, 50)] == [1, 1, 4, 4]
    assert cloud(below=2).splats(10).sh.shape[1] == 4


def test_largest_takes_the_first_of_equals_over_the_threshold():
    assert list(largest(np.array([1.0, 3, 3, 0, 2]), 0.5, 2)) == [1, 2]
    assert list(largest(np.array([1.0, 3, 3, 0, 2]), 2.5, 9)) == [1, 2]
    assert list(largest(np.array([1.0, 3]), 0.0, -1)) == []


def test_useless_splats_are_faint_wide_or_not_finite():
    splats = tiny.random_splats(np.random.default_rng(0), 5)
    arrays = {name: getattr(splats, name).copy() for name in SplatTensors._fields}
    arrays["opacity_logits"][0] = -8
    arrays["log_scales"][1, 2] = 9
    arrays["sh"][2, 0, 0] = np.nan
    dead = useless(type(splats)(**arrays), 0.005, 0.1, np.full(5, 1e3))
    assert list(dead) == [True, True, True, False, False]


def test_what_is_far_from_all_cameras_may_be_wide():
    path = CameraPath(np.array([[0.0, 0, 0], [1, 0, 0]]), 0.55)
    means = np.array([[0.1, 0, 0], [0, 30, 40], [np.nan, 0, 0]], np.float32)
    np.testing.assert_allclose(path.sizes(means), [0.55, 50, 0.55])


def test_a_wide_splat_stays_where_no_camera_is_near():
    splats = replace(
        tiny.random_splats(np.random.default_rng(0), 3),
        means=np.array([[0, 0, 50], [0, 0, 0.1], [0, 0, 50]], np.float32),
        log_scales=np.log(np.array([[1], [1], [9]], np.float32)).repeat(3, axis=1),
        opacity_logits=np.full(3, 2, np.float32),
    )
    growth = CloudGrowth(start=1, every=1, stop=1.0, threshold=np.inf)
    path = CameraPath(np.zeros((1, 3)), 0.5)
    model = Cloud(SplatTensors.of(splats), growth, path, (0,))
    assert model.densify(1, 10, scores(3), 10)
    np.testing.assert_array_equal(model.layer_splats().means, [[0, 0, 50]])


def test_gradients_on_the_screen_are_means_over_pictures_that_show_a_splat():
    found = ScreenGradients(3, CPU)
    found.add(torch.tensor([[3.0, 4.0], [0, 0], [1, 0]]), 2, 2)
    found.add(torch.tensor([[0.0, 0.0], [0, 0], [3, 0]]), 2, 2)
    assert list(found.mean()) == [5, 0, 2]


def test_gradients_on_the_screen_are_rounded_as_numpy_rounds():
    centers = np.random.default_rng(0).normal(0, 1, (10_000, 2)).astype(np.float32)
    found = ScreenGradients(len(centers), CPU)
    found.add(torch.from_numpy(centers), 3, 5)
    x, y = centers[:, 0] * np.float32(1.5), centers[:, 1] * np.float32(2.5)
    np.testing.assert_array_equal(found.mean(), np.sqrt(x * x + y * y))


def test_splats_start_at_points_as_wide_as_their_spacing():
    data = tiny.dataset()
    splats = first_splats(data, 1000, 2, (0,))
    assert len(splats) == len(data.points)
    assert splats.sh.shape[1] == 9
    d = np.linalg.norm(splats.means[:, None] - splats.means, axis=2)
    expected = np.sqrt((np.sort(d, axis=1)[:, 1:4] ** 2).mean(axis=1))
    np.testing.assert_allclose(np.exp(splats.log_scales), expected[:, None].repeat(3, 1), rtol=1e-5)
    cameras = [view.camera for view in data.train]
    assert CameraPath.of(cameras).extent == pytest.approx(1.1 * 4 * np.cos(0.4), rel=0.1)
    one_place = [cameras[:1], cameras[:1] * 7]
    assert [CameraPath.of(one).extent for one in one_place] == pytest.approx([4, 4], rel=0.01)


def test_the_size_of_a_scene_is_the_extent_but_where_the_path_is_short():
    path = CameraPath(np.array([[0.0, 0, 0], [1, 0, 0]]), 0.55)
    near, far = np.array([[0.5, 0, 0]]), np.array([[0.0, 0, 8], [1, 0, 9], [0, 6, 0]])
    assert path.scene_size(near) == path.scene_size(near[:0]) == 0.55
    assert path.scene_size(far) == pytest.approx(8.0)
    assert path.scene_size(np.concatenate([near] * 9 + [far])) == 0.55
