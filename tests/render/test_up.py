"""Which way is up, and what is framed, where nobody says."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec import SceneInfo, SplatParams
from evogs_codec._generated import registry
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.render import Up, cameras_around, orbit, up_of, up_of_cameras
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.framing import bulk_of
from evogs_codec.render.up import AXES, direction


def turning_z_to(up):
    """(3, 3) a rotation that takes z to a direction."""
    up = direction(up)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up], axis=1)


def splats(*groups):
    """From the five groups, in any floats."""
    rows = [group.reshape(len(group), int(np.prod(group.shape[1:]))).T for group in groups]
    return SplatParams.from_channels(np.concatenate(rows))


def with_outliers(scene, part=0.01, *, seed=0):
    """The scene, and far around it, on one side more than on the other, large opaque splats."""
    rng = np.random.default_rng(seed)
    n = round(part * len(scene))
    means = rng.normal(size=(n, 3)) * [3000, 500, 1000] + [2000, 0, 500]
    sh = np.zeros((n, scene.sh.shape[1], 3))
    far = splats(means, rng.normal(size=(n, 4)), rng.normal(3, 1, (n, 3)), np.full(n, 6.0), sh)
    both = np.concatenate([scene.channels(), far.channels()], axis=1)
    return SplatParams.from_channels(both[:, rng.permutation(len(scene) + n)])


def cloud(n, seed):
    """Ellipsoids of all shapes, without any ground."""
    rng = np.random.default_rng(seed)
    return splats(
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 4)),
        rng.normal(-3, 1, (n, 3)),
        rng.normal(size=n),
        rng.normal(size=(n, 1, 3)),
    )


@pytest.fixture(scope="module")
def scene():
    return make_scene(3000)


# --- up -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("outliers", [0, 0.01])
@pytest.mark.parametrize("axis", AXES)
def test_the_ground_of_a_scene_shows_which_of_six_axes_is_up(scene, axis, outliers):
    turned = with_outliers(transformed(scene, turning_z_to(axis)), outliers)
    found = up_of(turned)
    assert (found.name, found.source) == (axis, "estimated from the splats")


@pytest.mark.parametrize("up", [(0.3, -0.8, 0.4), (-0.2, -0.3, -0.9), (1, 1, 1)])
def test_a_ground_that_is_along_no_axis_is_found_too(scene, up):
    found = up_of(transformed(scene, turning_z_to(up)))
    away = np.degrees(np.arccos(min(1.0, direction(up) @ np.array(found.vector))))
    assert away < 6
    assert found.name.count(" ") == 2


@pytest.mark.parametrize("n", [0, 1, 30, 150, 400, 3000])
def test_a_cloud_shows_nothing_and_z_is_up(n):
    for seed in range(5):
        assert up_of(cloud(n, seed)).name == "z"
        assert up_of(cloud(n, seed)).source == "a guess, as nothing shows it: --up names another"


def test_a_file_that_names_its_axis_is_believed(scene):
    for name in registry.UP_AXES[1:]:
        info = SceneInfo(up_axis=registry.UP_AXES.index(name))
        found = up_of(scene, info)
        assert (f"+{found.name}"[-2:], found.source) == (name, "as the file says")
    assert up_of(scene, SceneInfo(up_axis=200)).source == "estimated from the splats"


@pytest.mark.parametrize("up", [*AXES, (0.5, -1.0, 0.3)])
def test_cameras_that_were_held_level_say_what_is_up(up):
    around = orbit(
        7, (1, 2, 3), radius=3, elevation=0.9, up=direction(up), width=8, height=8, fov_x=0.8
    )
    np.testing.assert_allclose(up_of_cameras(around), direction(up), atol=1e-9)
    np.testing.assert_allclose(up_of_cameras(around[:1]) @ direction(up), np.cos(0.9), atol=0.01)
    assert up_of(cloud(10, 0), None, around).source == "as the cameras were held"


@pytest.mark.parametrize("wrong", ["w", "", "xy", (0, 0, 0), (1, 2), (np.nan, 0, 1)])
def test_what_is_no_direction_is_refused(wrong, scene):
    with pytest.raises(ValueError, match="up is"):
        cameras_around(scene, wrong)


def test_up_is_named_for_people():
    assert str(Up.of("-y", "as asked for")) == "up is -y (as asked for)"
    assert Up.of((0, 0.6, 0.8), "").name == "0.00 0.60 0.80"


# --- framing --------------------------------------------------------------------------------------


def test_one_percent_of_far_splats_does_not_change_the_framing(scene):
    whole, noisy = bulk_of(scene), bulk_of(with_outliers(scene))
    assert np.linalg.norm(noisy.middle - whole.middle) < 0.05 * whole.size
    assert noisy.size == pytest.approx(whole.size, rel=0.05)
    # Their box is a hundred times as large.
    assert np.ptp(with_outliers(scene).means, axis=0).max() > 100 * whole.size


def test_splats_that_are_hardly_seen_do_not_change_the_framing(scene):
    """As many again, transparent and small, beside the scene: floaters of a bad training."""
    floaters = splats(
        scene.means + np.array([60, 0, 0], np.float32), scene.quats, scene.log_scales - 2,
        np.full(len(scene), -6.0), scene.sh,
    )  # fmt: skip
    both = np.concatenate([scene.channels(), floaters.channels()], axis=1)
    whole, found = bulk_of(scene), bulk_of(SplatParams.from_channels(both))
    assert np.linalg.norm(found.middle - whole.middle) < 0.2 * whole.size
    assert found.size == pytest.approx(whole.size, rel=0.2)


def test_one_huge_splat_does_not_change_the_framing(scene):
    channels = scene.channels()
    channels[7:10, 5] = 6.0
    channels[10, 5] = 10.0
    whole, found = bulk_of(scene), bulk_of(SplatParams.from_channels(channels))
    assert found.size == pytest.approx(whole.size, rel=0.01)


def test_scenes_whose_bulk_is_what_matters_keep_the_views_that_they_always_had(scene):
    low, high = np.percentile(scene.means.astype(np.float64), (20, 80), axis=0)
    camera = cameras_around(scene, "z", 64)[0]
    away = camera.position - (low + high) / 2
    np.testing.assert_allclose(np.linalg.norm(away), 2 * np.linalg.norm(high - low), rtol=1e-12)
    assert np.arcsin(away[2] / np.linalg.norm(away)) == pytest.approx(0.35)


def test_numbers_that_are_not_finite_do_not_count(scene):
    channels = scene.channels()
    channels[0, :9], channels[8, 10:20], channels[10, 30:40] = np.nan, np.inf, -np.inf
    found = bulk_of(SplatParams.from_channels(channels))
    assert found.size == pytest.approx(bulk_of(scene).size, rel=0.02)
    assert up_of(SplatParams.from_channels(channels)).name == "z"


def test_a_scene_without_any_place_is_refused():
    with pytest.raises(ValueError, match="empty"):
        bulk_of(cloud(0, 0))
