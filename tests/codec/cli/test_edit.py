"""`evogs edit`: what it makes, and what it says of it."""

import numpy as np
import pytest

from evogs_codec import decode_leaves, read_directory, read_ply, read_scene, write_ply
from evogs_codec.render.demo_scene import make_scene

FAR = ["--crop-box", 1e6, 1e6, 1e6, 2e6, 2e6, 2e6]


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "a.ply"
    write_ply(path, make_scene(300))
    return path


def test_a_file_of_float32_made_of_a_far_stream_says_how_to_move_it_first(evogs, small, tmp_path):
    near, far = tmp_path / "near.evogs", tmp_path / "far.evogs"
    assert evogs("encode", small, near, "--preset", "scene", "--effort", 1)[0] == 0
    assert evogs("edit", near, far, "--translate", 1e6, -2e6, 50)[0] == 0
    for command in ("decode", "convert"):
        code, _, err = evogs(command, far, tmp_path / f"{command}.ply")
        assert (code, err.count("\n")) == (0, 1)
        assert f"`evogs edit {far} NEAR.evogs --translate -" in err
    assert evogs("decode", near, tmp_path / "near.ply")[2] == ""


def test_a_stream_is_moved_without_being_encoded_again(evogs, made, tmp_path):
    out, source = tmp_path / "a.evogs", made / "scene.evogs"
    code, said, err = evogs("edit", source, out, "--translate", 4, -2, 0.5)
    assert (code, err) == (0, "")
    first, second = said.splitlines()
    assert first == f"{out}: 3,000 of 3,000 splats, {source.stat().st_size:,} bytes"
    assert second == "exact: origins moved by 4 -2 0.5"
    moved, before = (decode_leaves(path).means for path in (out, source))
    assert np.abs(moved - before - [4, -2, 0.5]).max() < 1e-5
    assert evogs("validate", out)[0] == 0
    assert evogs("edit", source, out, "--translate", 4, -2, 0.5)[0] == 0  # over what it made


def test_a_move_that_no_stream_holds_is_refused_before_the_work(
    refused, small, made, tmp_path, monkeypatch
):
    def never(*_, **__):
        raise AssertionError("nothing is lifted")

    monkeypatch.setattr("evogs_codec.scene.encode.lift_with_order", never)
    out = tmp_path / "a.evogs"
    for source in (small, made / "scene.evogs"):
        words = [f"{out}: a position 1e+30 units from zero is too far", "nothing is written"]
        refused("edit", source, out, "--translate", 0, 1e30, 0, words=words)
        words = [f"{out}: the edit makes numbers that are too large"]
        refused("edit", source, out, "--scale", 1e12, "--about", 1e30, 0, 0, words=words)
    assert not out.exists()


def test_a_scene_that_no_stream_holds_is_refused_by_its_name(refused, small, evogs, tmp_path):
    far, out = tmp_path / "far.ply", tmp_path / "far.evogs"
    assert evogs("edit", small, far, "--translate", 1e25, 0, 0)[0] == 0
    refused("encode", far, out, words=[f"{far}: a position 1e+25 units from zero is too far"])


def test_a_crop_through_a_tile_is_encoded_again_and_says_so(evogs, made, tmp_path):
    out = tmp_path / "a.evogs"
    words = ["--crop-sphere", 0, 0, 0, 20, "--preset", "scene"]
    code, said, err = evogs("edit", made / "scene.evogs", out, *words)
    assert (code, err) == (0, "")
    first, second, third = said.splitlines()
    assert second == "encoded again: 1 of 1 tiles keep only some of their splats"
    n = read_directory(out.read_bytes())
    kept = len(decode_leaves(out))
    assert 0 < kept < 3000
    assert first.startswith(f"{out}: {kept:,} of 3,000 splats, {n.size:,} bytes")
    assert third == f"outside the sphere: {3000 - kept:,} splats"
    assert "psnr" not in n.info.text or n.info.text["psnr"]


@pytest.mark.filterwarnings("ignore:.*(infinite opacity|no SH above)")
@pytest.mark.parametrize("ending", ["ply", "compressed.ply", "spz", "splat", "glb"])
def test_any_scene_is_edited_to_any_format(ending, evogs, small, tmp_path):
    source, out = tmp_path / f"a.{ending}", tmp_path / f"b.{ending}"
    evogs("convert", small, source)
    code, said, _ = evogs("edit", source, out, "--scale", 2, "--about", 1, 2, 3)
    degree = 0 if ending == "splat" else 3
    assert (code, said) == (0, f"{out}: 300 of 300 splats, SH degree {degree}\n")
    before, after = (np.sort(read_scene(path).splats.means, axis=0) for path in (source, out))
    assert np.abs(after - (2 * before - [1, 2, 3])).max() < (2 if "compressed" in ending else 1e-3)


def test_scenes_become_one_and_floaters_are_counted(evogs, small, made, tmp_path):
    out = tmp_path / "both.ply"
    code, said, _ = evogs("edit", small, made / "scene.evogs", out, "--drop-floaters")
    n = len(read_ply(out))
    assert code == 0
    assert said == (f"{out}: {n:,} of 3,300 splats, SH degree 3\nfloaters: {3300 - n:,} splats\n")


def test_the_three_forms_of_a_rotation_are_the_same(evogs, small, tmp_path):
    half = 0.5**0.5
    for k, words in enumerate(
        (
            ["--rotate", 0, 0, 1, 90],
            ["--rotate-quaternion", half, 0, 0, half],
            ["--rotate-matrix", 0, -1, 0, 1, 0, 0, 0, 0, 1],
        )
    ):
        assert evogs("edit", small, tmp_path / f"{k}.ply", *words)[0] == 0
    first, second, third = (read_ply(tmp_path / f"{k}.ply").channels() for k in range(3))
    np.testing.assert_allclose(second, first, atol=1e-4)
    np.testing.assert_allclose(third, first, atol=1e-4)
    x, y = read_ply(small).means[:, :2].T
    np.testing.assert_allclose(first[0], -y, atol=1e-4)
    np.testing.assert_allclose(first[1], x, atol=1e-4)


def test_what_cannot_be_edited_is_refused_in_one_line(evogs, refused, small, made, tmp_path):
    out = tmp_path / "a.ply"
    refused("edit", small, out, words=[small, "nothing to do", "evogs convert"])
    refused("edit", small, out, *FAR, words=["no splat is left"])
    refused("edit", small, out, "--crop-sphere", 0, 0, 0, -1, words=["no radius"])
    refused("edit", small, out, "--rotate", 0, 0, 0, 90, words=["the axis has no direction"])
    refused("edit", small, out, "--rotate-matrix", *[1] * 9, words=["no rotation"])
    refused(
        "edit", small, tmp_path / "a.sog", "--scale", 2, words=["scenes are written as", ".evogs"]
    )
    refused("edit", small, out, "--scale", 1e12, "--about", *[1e30] * 3, words=["too large"])
    refused("edit", small, "--scale", 2, code=2)
    refused("edit", small, out, "--scale", 0, code=2)
    part = tmp_path / "part.evogs"
    part.write_bytes((made / "scene.evogs").read_bytes()[:-100])
    refused("edit", part, small, tmp_path / "b.ply", words=[part, "E_TRUNCATED"])
    refused("edit", small, part, part, "--force", words=[part, "is an input"])
    assert not out.exists()
