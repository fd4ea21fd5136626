"""The procedural scene: reproducible, finite, and with the statistics it promises."""

import numpy as np
import pytest

from evogs_codec.io.ply import read_ply
from evogs_codec.render import load_cameras
from evogs_codec.render.demo_scene import _directions, _shuffled_axes, _turned, main, make_scene


def rotations(quats):
    """(n, 3, 3) of quaternions w x y z."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


@pytest.mark.parametrize("n", [0, 1, 7, 1000])
def test_a_scene_has_as_many_finite_splats_as_asked(n):
    scene = make_scene(n)
    assert len(scene) == n
    assert scene.sh_degree == 3
    assert scene.finite().all()


def test_the_same_seed_gives_the_same_scene_and_another_seed_another():
    one, same, other = make_scene(500, 1), make_scene(500, 1), make_scene(500, 2)
    np.testing.assert_array_equal(one.channels(), same.channels())
    assert not np.array_equal(one.channels(), other.channels())


def test_the_default_scene_has_the_statistics_of_a_trained_one():
    scene = make_scene()
    assert len(scene) == 40_000
    assert scene.opacity_logits.min() == -4
    assert scene.opacity_logits.max() == 8
    log_scales = np.sort(scene.log_scales, axis=1)
    flat = log_scales[:, 1] - log_scales[:, 0] > 1.5
    thin = log_scales[:, 2] - log_scales[:, 1] > 1.5
    assert 0.4 < flat.mean() < 0.9
    assert 0.1 < thin.mean() < 0.4
    # Each axis is the short one of some splats, and quaternions have any sign and norm.
    assert np.bincount(scene.log_scales.argmin(1)).min() > 10_000
    norms = np.linalg.norm(scene.quats, axis=1)
    assert norms.min() < 0.5
    assert norms.max() > 2
    assert 0.4 < (scene.quats[:, 0] < 0).mean() < 0.6
    distance = np.linalg.norm(scene.means, axis=1)
    assert 0.05 < (distance > 30).mean() < 0.12


def test_splats_of_the_floor_lie_flat_whatever_the_order_of_their_axes():
    scene = make_scene(4000)
    floor = np.flatnonzero((np.abs(scene.means[:, 2]) < 0.01) & (scene.means[:, 1] > -3))
    short = scene.log_scales[floor].argmin(1)
    normals = rotations(scene.quats[floor])[np.arange(len(floor)), :, short]
    assert np.median(np.abs(normals[:, 2])) > 0.999


def test_turning_takes_z_to_any_axis_also_straight_down():
    rng = np.random.default_rng(0)
    axis = np.vstack([_directions(rng, 50), [[0, 0, 1], [0, 0, -1]]])
    np.testing.assert_allclose(rotations(_turned(rng, axis))[:, :, 2], axis, atol=1e-7)


def test_shuffled_axes_describe_the_same_ellipsoids():
    rng = np.random.default_rng(0)
    quats, log_scales = rng.standard_normal((60, 4)), rng.standard_normal((60, 3))

    def covariances(q, s):
        return rotations(q) * np.exp(2 * s)[:, None, :] @ rotations(q).transpose(0, 2, 1)

    shuffled = _shuffled_axes(rng, quats, log_scales)
    np.testing.assert_allclose(covariances(*shuffled), covariances(quats, log_scales), atol=1e-9)


def test_the_command_writes_the_scene(tmp_path, capsys):
    out = tmp_path / "scene.ply"
    main([str(out), "--splats", "30", "--seed", "4"])
    np.testing.assert_array_equal(read_ply(out).channels(), make_scene(30, 4).channels())
    assert "30 splats" in capsys.readouterr().out


def test_the_command_writes_cameras_and_replaces_no_other_file(tmp_path, capsys):
    out, cameras, notes = tmp_path / "s.ply", tmp_path / "c.json", tmp_path / "notes.txt"
    for _ in range(2):
        main([str(out), "--splats", "3", "--cameras", str(cameras)])
    assert [camera.width for camera in load_cameras(cameras)] == [400, 400, 400]
    notes.write_text("of a week's work\n")
    with pytest.raises(SystemExit):
        main([str(out), "--splats", "3", "--cameras", str(notes)])
    assert notes.read_text() == "of a week's work\n"
    assert "notes.txt" in capsys.readouterr().err


def test_the_command_says_what_is_wrong(tmp_path, capsys):
    with pytest.raises(SystemExit) as usage:
        main([str(tmp_path / "scene.ply"), "--splats", "-1"])
    assert usage.value.code == 2
    with pytest.raises(SystemExit) as bad:
        main([str(tmp_path / "absent" / "scene.ply"), "--splats", "1"])
    assert bad.value.code == 1
    assert "its folder does not exist" in capsys.readouterr().err
