"""Damaged files of every kind that commands read: right data or InputError, nothing else.

Some hundred of each in the first ring, from a seed that `make test-all` draws; the slow tests take
as many as were promised.
"""

import json
import random

import numpy as np
import pytest
from hypothesis import settings

from evogs_codec import InputError, read_ply, read_tree
from evogs_codec._generated.limits import LIMITS
from evogs_codec.io.json_files import read_limits
from evogs_codec.render import load_cameras, save_cameras
from evogs_codec.render.camera import orbit
from tests.codec.io.test_ply import FORMATS, columns_of, ply_bytes, scene_of
from tests.render.test_camera_files import path_of_nerfstudio, rows_of_a_trainer
from tests.support import damaged_files as damage
from tests.support.tree_files import RECORDS, REFINE, file_of, npz_bytes
from tests.trainer.views_folders import folder_of

LEVELS = (RECORDS, [(0, REFINE, 0, 1, 0)])
ARRAYS = file_of([1, 2, 3], *LEVELS, degree=1) | {"quanta": np.full((4, 6), 0.25)}
TREES = [npz_bytes(ARRAYS), npz_bytes(ARRAYS, np.savez_compressed)]
MAX_SAID = 1000  # characters of a message, after the path
pytestmark = pytest.mark.random
FACE = ["element face 2", "property list uchar uchar vertex_indices"]
PLYS = [
    *(ply_bytes(columns_of(scene_of(3, 1)), form) for form in FORMATS),
    ply_bytes(columns_of(scene_of(2, 0)), before=b"\x02\x07\x08\x00", first=FACE),
]


@pytest.fixture
def random_():
    """Random numbers whose seed is shown where a test fails; always the same in `make test`."""
    is_seeded = settings().derandomize
    seed = 1 if is_seeded else random.SystemRandom().randrange(1 << 32)
    print(f"seed {seed}")
    return random.Random(seed)


def outcomes(path, originals, damages, read, n, random_):
    """What `read` gives for each of `n` damaged files, None where it refuses."""
    said = ""
    for number in range(n):
        original, change = random_.choice(originals), random_.choice(damages)
        data = change(original, random_)
        path.write_bytes(data)
        try:
            found = read(path)
        except InputError as error:
            found, said = None, str(error).removeprefix(str(path))
        except Exception:
            print(f"file {number}, {change.__name__}: {data!r}")
            raise
        assert found is not None or (said.isprintable() and len(said) < MAX_SAID), ascii(said)
        yield change, found


def check_trees(tmp_path, n, random_):
    originals = {damage.flipped, damage.cut_short, damage.with_flipped_structure}
    path = tmp_path / "t.tree.npz"
    path.write_bytes(TREES[0])
    right = bytes_of(read_tree(path))
    damages = [
        *originals,
        damage.with_edited_header,
        damage.with_edited_header,
        damage.with_flipped_arrays,
        damage.with_edited_names,
    ]
    refused = 0
    for change, tree in outcomes(path, TREES, damages, read_tree, n, random_):
        refused += tree is None
        if tree is not None:
            # A checksum that was not repaired leaves no other data than the right ones.
            assert change not in originals or bytes_of(tree) == right, change
            assert np.isfinite(tree.leaves().channels()).all() or change not in originals
    assert n / 2 < refused < n


def bytes_of(tree):
    leaves = [tree.leaves(level).channels().tobytes() for level in range(tree.n_levels)]
    return leaves, tree.quanta


def check_plys(tmp_path, n, random_):
    for original in PLYS:
        (tmp_path / "s.ply").write_bytes(original)
        assert len(read_ply(tmp_path / "s.ply")) in (2, 3)  # where there is no damage
    damages = [damage.flipped, damage.cut_short, *[damage.with_edited_ply_header] * 3]
    found = [
        splats for _, splats in outcomes(tmp_path / "s.ply", PLYS, damages, read_ply, n, random_)
    ]
    assert all(splats.sh_degree in range(4) for splats in found if splats is not None)
    assert n / 2 < found.count(None)  # about 96 of 100: of few files all may be refused
    assert found.count(None) < n or n <= 100


def check_cameras(tmp_path, n, random_):
    path = tmp_path / "cameras.json"
    save_cameras(path, orbit(3, radius=2, width=8, height=6, fov_x=0.8))
    assert len(load_cameras(path)) == 3  # where there is no damage
    damages = [
        damage.flipped,
        damage.cut_short,
        damage.with_deep_nesting,
        damage.with_edited_text,
        *[damage.with_another_value] * 4,
    ]
    found = [c for _, c in outcomes(path, [path.read_bytes()], damages, load_cameras, n, random_)]
    for cameras in found:
        for camera in cameras or []:
            assert np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all()
            assert np.abs(camera.rotation @ camera.rotation.T - np.eye(3)).max() < 1e-3
    assert n / 2 < found.count(None)  # about 94 of 100: of few files all may be refused
    assert found.count(None) < n or n <= 100


def check_cameras_of_others(tmp_path, n, random_):
    """What is not refused is a right camera."""
    paths = [
        folder_of(tmp_path / "a", "nerfstudio") / "transforms.json",
        folder_of(tmp_path / "b", "blender") / "transforms_train.json",
        tmp_path / "cameras.json",
        tmp_path / "path.json",
    ]
    paths[2].write_text(json.dumps(rows_of_a_trainer()))
    paths[3].write_text(json.dumps(path_of_nerfstudio()))
    damages = [
        damage.flipped,
        damage.cut_short,
        damage.with_deep_nesting,
        damage.with_edited_text,
        *[damage.with_another_value] * 4,
    ]
    for path in paths:
        assert load_cameras(path)  # where there is no damage
        originals = [path.read_bytes()]
        found = [c for _, c in outcomes(path, originals, damages, load_cameras, n // 4, random_)]
        for cameras in found:
            for camera in cameras or []:
                assert np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all()
                assert np.abs(camera.rotation @ camera.rotation.T - np.eye(3)).max() < 1e-3
        assert None in found


def check_limits(tmp_path, n, random_):
    original = b'{"slots": 1000, "n_tiles": 3}'
    damages = [
        damage.cut_short,
        damage.with_deep_nesting,
        damage.with_edited_text,
        damage.with_another_value,
    ]
    path = tmp_path / "limits.json"
    for _, limits in outcomes(path, [original], damages, read_limits, n, random_):
        assert limits is None or set(limits) <= set(LIMITS)


CHECKS = {
    check_trees: (150, 1000),
    check_plys: (100, 500),
    check_cameras: (50, 200),
    check_cameras_of_others: (120, 2000),
    check_limits: (50, 200),
}
NAMES = [check.__name__ for check in CHECKS]


@pytest.mark.parametrize("check", CHECKS, ids=NAMES)
def test_a_damaged_file_is_right_data_or_refused(check, tmp_path, random_):
    check(tmp_path, CHECKS[check][0], random_)


@pytest.mark.slow
@pytest.mark.parametrize("check", CHECKS, ids=NAMES)
def test_many_damaged_files_are_right_data_or_refused(check, tmp_path, random_):
    check(tmp_path, CHECKS[check][1], random_)
