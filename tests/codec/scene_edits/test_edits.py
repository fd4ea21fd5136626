"""Edits of splats and of streams: what stays exact, and what the pictures show."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import (
    Scene,
    SceneInfo,
    SplatParams,
    decode,
    encode_scene,
    read_directory,
)
from evogs_codec._generated import registry
from evogs_codec.decoding.float_view import n_moved_by_float32
from evogs_codec.editing.join import NotJoinableError, joined
from evogs_codec.editing.move import moved
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.viewpoint import Viewpoint, default_viewpoint
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene_edits import Box, Edit, Sphere, edit_scenes
from evogs_codec.scene_edits.floaters import floaters
from evogs_codec.scene_edits.merging import merged
from evogs_codec.scene_edits.rotations import (
    rotation_about,
    rotation_of_matrix,
    rotation_of_quaternion,
)
from tests.support.odd_scenes import covariances, odd_scene
from tests.support.shared_scenes import shared_scene

INFO = SceneInfo(up_axis=registry.UP_AXES.index("+z"), unit=1, text={"title": "A"})


@pytest.fixture(scope="module")
def stream():
    """Eight tiles, with digests."""
    return encode_scene(
        make_scene(600), levels=3, preset="scene", n_tiles=8, cameras=(), effort=1, info=INFO
    )


def same_numbers(one, other):
    np.testing.assert_array_equal(one.channels(), other.channels())


def test_the_camera_goes_with_the_splats_in_a_stream_and_in_a_scene(stream):
    camera = Viewpoint((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), 50.0)
    directory = read_directory(stream)
    with_camera = replace(directory.info, text={"camera": str(camera)})
    own = rebuild_directory(
        replace(directory, info=with_camera),
        directory.tiles,
        directory.packets,
        directory.digests,
    )
    whole = own + stream[directory.data_offset :]
    edited = edit_scenes([whole], Edit(offset=np.array([4.0, 0, 0])))
    there = Viewpoint((4.0, -2.0, 0.0), (4.0, 0.0, 0.0), 50.0)
    assert default_viewpoint(edited.scene.info.text) == there
    assert default_viewpoint(read_directory(edited.stream).info.text) == there  # type: ignore[arg-type]
    both = merged([edited.scene, edit_scenes([whole], Edit(scale=2.0)).scene])
    assert default_viewpoint(both.info.text) == there


# --- on packets ----------------------------------------------------------------------------------


def test_a_moved_stream_has_the_same_packets_and_moved_origins(stream):
    found = moved(stream, np.array([4.0, -0.25, 1e3]))
    assert found.offset.tolist() == [4, -0.25, 1000]
    before, after = decode(stream), decode(found.data, verify=True)
    directory = after.directory
    assert found.data[directory.data_offset :] == stream[before.directory.data_offset :]
    assert directory.digests == before.directory.digests
    assert directory.digests
    for mine, theirs in zip(before.tiles, after.tiles, strict=True):
        np.testing.assert_array_equal(mine.x, theirs.x)
    steps = directory.tiles["origin"] - before.directory.tiles["origin"]
    assert (steps * found.unit == found.offset).all()
    back = moved(found.data, -found.offset)
    assert back.data == stream


def test_a_stream_is_moved_by_the_nearest_multiple_of_its_grid(stream):
    found = moved(stream, np.array([0.1, 0, 0]))
    assert abs(found.offset[0] - 0.1) <= found.unit / 2
    assert (found.offset / found.unit == np.rint(found.offset / found.unit)).all()
    with pytest.raises(ValueError, match=r"over 2\^52 units"):
        moved(stream, np.array([1e20, 0, 0]))


def test_a_crop_between_tiles_and_a_join_give_the_stream_back_in_integers(stream):
    directory, whole = read_directory(stream), decode(stream)
    low = directory.tiles["origin"] + directory.tiles["box_min"]
    first = np.argsort(low[:, 0])[:4]
    parts: list[bytes] = []
    for kept in (np.isin(np.arange(8), first), ~np.isin(np.arange(8), first)):
        leaves = np.repeat(kept, [np.count_nonzero(t.live[: t.n_slots]) for t in whole.tiles])

        class Of:
            mask = leaves

            def holds(self, _splats):
                return self.mask

        edited = edit_scenes([stream], Edit(crop=Of()))
        assert edited.stream is not None
        assert edited.how == "4 of 8 tiles kept"
        assert edited.n_outside == 600 - leaves.sum()
        same_numbers(decode(edited.stream, verify=True).leaves(), whole.leaves().take(leaves))
        parts.append(edited.stream)
    edited = edit_scenes(parts, Edit())
    assert edited.stream is not None
    assert edited.how == "packets of 2 streams joined"
    back = decode(edited.stream, verify=True)
    assert len(back.directory.digests) == len(directory.digests)
    ours, theirs = back.leaves().channels(), whole.leaves().channels()
    np.testing.assert_array_equal(ours[:, np.lexsort(ours)], theirs[:, np.lexsort(theirs)])


def test_every_prefix_of_joined_streams_has_about_the_same_part_of_each(stream):
    whole = joined([stream, moved(stream, np.array([50.0, 0, 0])).data])
    directory = read_directory(whole)
    assert len(directory.tiles) == 16
    n_bytes = np.zeros((2, len(directory.packets)))
    owner = directory.packets["tile"] // 8
    n_bytes[owner, np.arange(len(owner))] = directory.packets["size"]
    first, second = np.cumsum(n_bytes, axis=1)
    assert np.abs(first - second).max() <= directory.packets["size"].max()
    assert decode(whole, verify=True).n_leaves == 1200


def test_streams_that_differ_in_their_tables_are_encoded_again(stream):
    other = encode_scene(
        make_scene(100), levels=3, preset="scene", cameras=(), effort=1, palette="never"
    )
    with pytest.raises(NotJoinableError, match="the streams differ in"):
        joined([stream, other])
    edited = edit_scenes([stream, other], Edit())
    assert (edited.stream, len(edited.scene.splats)) == (None, 700)
    assert edited.how.startswith("the streams differ in")


def test_what_packets_cannot_say_is_said(stream):
    for edit, why in (
        (Edit(scale=2.0), "logarithms"),
        (Edit(rotation=rotation_about((0, 0, 1), 90)), "rotation"),
        (Edit(crop=Sphere((0, 0, 0), 1.0)), "of 8 tiles keep only some"),
        (Edit(offset=np.array([1e30, 0, 0])), "2^52"),
    ):
        edited = edit_scenes([stream], edit)
        assert edited.stream is None
        assert why in edited.how
    assert edit_scenes([Scene(make_scene(20))], Edit()).how == "a scene is no stream"


@pytest.mark.thorough
def test_a_stream_with_a_palette_is_moved_and_cropped_but_not_joined():
    scene = encode_scene(
        shared_scene(600, 30), levels=3, preset="scene", n_tiles=4, cameras=(), effort=1
    )
    assert read_directory(scene).has_palette
    edited = edit_scenes([scene], Edit(offset=np.array([1.0, 0, 0])))
    assert edited.stream is not None
    assert decode(edited.stream, verify=True).n_leaves == edited.n_before
    both = edit_scenes([scene, edited.stream], Edit())
    assert (both.stream, both.how) == (None, "a stream has a palette")


def test_an_exact_edit_has_the_splats_that_its_stream_decodes_to(stream):
    edited = edit_scenes([stream], Edit(offset=np.array([0.3, 0.4, 0.5])))
    assert edited.stream is not None
    same_numbers(decode(edited.stream).leaves(), edited.scene.splats)


FAR = np.array([1e6, -2e6, 50.0])


def test_what_float32_cannot_hold_far_from_zero_comes_back_with_the_stream(stream):
    there = edit_scenes([stream], Edit(offset=FAR)).stream
    assert there is not None
    far, near = decode(there), decode(stream).leaves()
    assert np.abs(far.leaves().means - FAR - near.means).max() > 0.01
    assert n_moved_by_float32(far.directory, far.leaves()) > 300
    assert n_moved_by_float32(decode(stream).directory, near) == 0
    same_numbers(edit_scenes([there], Edit(offset=-FAR)).scene.splats, near)


@pytest.mark.filterwarnings("default")
def test_an_edit_that_encodes_far_splats_again_says_what_float32_moves(stream):
    there = edit_scenes([stream], Edit(offset=FAR)).stream
    assert there is not None
    with pytest.warns(UserWarning, match="moves up to .* splats .* first move the stream near"):
        edit_scenes([there], Edit(scale=2.0))


# --- on splats -----------------------------------------------------------------------------------


def test_a_box_and_a_sphere_hold_what_their_formula_says():
    splats = odd_scene(n=300)
    means = np.random.default_rng(0).uniform(-4, 4, (300, 3)).astype(np.float32)
    splats = replace(splats, means=means)
    x, y, z = splats.means.astype(float).T
    inside = (np.abs(x) <= 2) & (np.abs(y - 1) <= 1) & (z >= -1) & (z <= 4)
    assert 0 < inside.sum() < 300
    np.testing.assert_array_equal(Box((2, 0, 4), (-2, 2, -1)).holds(splats), inside)
    near = (x - 1) ** 2 + y**2 + (z - 2) ** 2 <= 4
    assert 0 < near.sum() < 300
    np.testing.assert_array_equal(Sphere((1, 0, 2), 2.0).holds(splats), near)
    on = tuple(splats.means[0].tolist())
    assert Box(on, on).holds(splats).sum() == Sphere(on, 0.0).holds(splats).sum() == 1
    with pytest.raises(ValueError, match="no radius"):
        Sphere((0, 0, 0), -1.0)


def planted(scene, where, log_scale=-4.0):
    """The scene with more splats at these places, of one size."""
    n, k = len(where), scene.sh.shape[1]
    return SplatParams(
        np.concatenate([scene.means, np.asarray(where, np.float32)]),
        np.concatenate([scene.quats, np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))]),
        np.concatenate([scene.log_scales, np.full((n, 3), log_scale, np.float32)]),
        np.concatenate([scene.opacity_logits, np.zeros(n, np.float32)]),
        np.concatenate([scene.sh, np.zeros((n, k, 3), np.float32)]),
    )


def test_floaters_are_found_where_they_were_planted_and_hardly_elsewhere():
    scene = make_scene(4000)
    away = 300 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 1], [0, -1, 1.5]])
    found = floaters(planted(scene, away))
    assert found[4000:].all()
    assert found[:4000].sum() <= 8  # 2 in a thousand
    # As large as they are far from others, they are a sky.
    assert not floaters(planted(scene, away, log_scale=6.0))[4000:].any()
    assert not floaters(scene.take(np.arange(16))).any()
    assert floaters(planted(scene, away), 1e6).sum() == 0


def test_many_splats_at_one_place_take_no_time_and_are_no_floaters():
    scene = make_scene(300)
    n = 100_000  # a minute, if the tree held all of them
    found = floaters(scene.take(np.arange(300 + n) % 300))
    assert found.sum() == 0
    one = scene.take(np.zeros(n, int))
    assert floaters(one).sum() == 0
    many = floaters(planted(scene, np.full((n, 3), 2.5)))
    assert not many[300:].any()


def test_rotations_are_those_of_their_forms():
    np.testing.assert_allclose(
        rotation_about((0, 0, 5), 90), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15
    )
    half = np.sqrt(0.5)
    quarter = rotation_of_quaternion((2 * half, 0, 0, 2 * half))
    np.testing.assert_allclose(quarter, rotation_about((0, 0, 1), 90), atol=1e-15)
    rounded = np.round(rotation_about((1, 2, 3), 40), 5)
    nearest = rotation_of_matrix(rounded.ravel().tolist())
    np.testing.assert_allclose(nearest @ nearest.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(nearest, rounded, atol=1e-5)
    for rows, why in ((np.diag([1, 1, -1]), "mirrors"), (2 * np.eye(3), "orthogonal")):
        with pytest.raises(ValueError, match=why):
            rotation_of_matrix(rows.ravel().tolist())
    for call in (rotation_of_quaternion, lambda zero: rotation_about(zero[:3], 1)):
        with pytest.raises(ValueError, match="no direction"):
            call((0, 0, 0, 0))


def test_a_rotated_scene_seen_from_a_rotated_camera_is_the_same_picture():
    render = pytest.importorskip("evogs_codec.render", reason="the rasterizer is compiled")
    scene, rotation = odd_scene(), rotation_about((1, -2, 0.5), 77)
    offset = np.array([3.0, -1, 2])
    edited = edit_scenes([Scene(scene)], Edit(scale=2.0, rotation=rotation, offset=offset))
    for eye in ([1.0, -1, -9], [9.0, 2, 3]):
        camera = render.Camera.look_at(
            eye, [1.3, -0.7, 2.1], (0, -1, 0), width=64, height=48, fov_x=1.2
        )
        # x_camera = R x + t, and x = Q'(y - c) / 2: all is twice as large, and looks the same.
        turned = camera.rotation @ rotation.T
        there = render.Camera(
            64, 48, camera.fx, camera.fy, camera.cx, camera.cy, turned,
            2 * camera.translation - turned @ offset,
        )  # fmt: skip
        before, after = (
            render.render(splats, view, (0.2, 0.5, 0.7))
            for splats, view in ((scene, camera), (edited.scene.splats, there))
        )
        assert before.std() > 0.05
        error = np.mean((before.astype(float) - after) ** 2)
        assert -10 * np.log10(error) > 60


def test_crop_and_floaters_come_before_the_move():
    scene = planted(make_scene(2000), [[300, 0, 0]])
    edit = Edit(Box((-1e3, -1e3, -1e3), (1e3, 1e3, 1e3)), 3.0, 2.0, offset=np.array([1e4, 0, 0]))
    edited = edit_scenes([Scene(scene)], edit)
    assert (edited.n_before, edited.n_outside) == (2001, 0)
    assert 1 <= edited.n_floaters <= 5
    assert abs(edited.scene.splats.means[:, 0].mean() - 1e4) < 200


def test_up_turns_with_the_scene_and_a_scaled_scene_has_no_unit():
    def after(edit):
        info = edit_scenes([Scene(odd_scene(n=5), INFO)], edit).scene.info
        return registry.UP_AXES[info.up_axis], registry.UNITS[info.unit]

    assert after(Edit()) == ("+z", "metre")
    assert after(Edit(scale=2.0)) == ("+z", "unspecified")
    assert after(Edit(rotation=rotation_about((1, 0, 0), 90))) == ("-y", "metre")
    assert after(Edit(rotation=rotation_about((1, 0, 0), 45))) == ("unspecified", "metre")


def test_merged_scenes_have_the_axes_of_the_first_and_the_highest_degree():
    ours, theirs = odd_scene(n=5, degree=1), odd_scene(n=7, degree=3)
    other = SceneInfo(coordinate_system=2, text={"title": "B", "psnr": "20.00; views"})
    whole = merged([Scene(ours, INFO), Scene(theirs, other)])
    assert whole.info.text == {"title": "A + B"}
    assert (len(whole.splats), whole.splats.sh_degree) == (12, 3)
    assert not whole.splats.sh[:5, 4:].any()
    np.testing.assert_array_equal(
        whole.splats.means[5:], theirs.means * np.array([1, -1, -1], np.float32)
    )
    flip = np.diag([1.0, -1, -1])
    np.testing.assert_allclose(
        covariances(whole.splats)[5:], flip @ covariances(theirs) @ flip, rtol=1e-5, atol=1e-8
    )
    with pytest.warns(UserWarning, match="only some are antialiased: all are taken as not"):
        merged([Scene(ours), Scene(theirs, SceneInfo(antialiased=True))])
