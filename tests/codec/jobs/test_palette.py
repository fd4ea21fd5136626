"""Scenes whose splats share SH, encoded tile by tile: one palette for all tiles."""

from dataclasses import replace

import numpy as np
import pytest

from conformance.decoders import oracle
from evogs_codec import InputError, decode, encode_scene, read_directory, write_ply
from evogs_codec.cli.commands import main
from evogs_codec.jobs import Engine, JobOptions, encode_files
from evogs_codec.jobs.distinct import Distinct
from evogs_codec.model.components import PALETTE
from evogs_codec.render import Views
from evogs_codec.render.demo_scene import make_scene
from tests.support.shared_scenes import shared_scene
from tests.support.view_sizes import SMALL, views_of

pytest.importorskip("numba")

N, PER_TILE = 1000, 250
OPTIONS = JobOptions(levels=3, per_tile=PER_TILE, effort=3)
SERIAL = Engine("serial")


@pytest.fixture(scope="module", autouse=True)
def small_views():
    """Of what this process encodes itself, wherever nothing else is said."""
    with views_of(SMALL):
        yield


@pytest.fixture(scope="module")
def scene():
    return shared_scene(N, n_vectors=40)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    """Files of the scene, whole and in parts that are not in order."""
    made = tmp_path_factory.mktemp("shared")
    write_ply(made / "whole.ply", scene)
    order = np.random.default_rng(1).permutation(N)
    for number, rows in enumerate(np.array_split(order, 3)):
        write_ply(made / f"part-{number}.ply", scene.take(rows))
    return made


@pytest.fixture(scope="module")
def right(folder):
    """The stream that all others are to be."""
    return coded(folder / "right.evogs", [folder / "whole.ply"])


@pytest.fixture(scope="module")
def plain(folder):
    """The stream without a palette."""
    return coded(folder / "plain.evogs", [folder / "whole.ply"], replace(OPTIONS, palette="never"))


def coded(out, files, options=OPTIONS, engine=SERIAL, **more):
    encode_files(files, out, options, engine=engine, **more)
    return out.read_bytes()


# --- distinct SH ----------------------------------------------------------------------------------


def test_the_sh_that_splats_share_are_found_in_any_order():
    splats = shared_scene(600, n_vectors=20)
    found = []
    for seed in range(3):
        distinct = Distinct(len(splats))
        for rows in np.array_split(np.random.default_rng(seed).permutation(len(splats)), 7):
            distinct.take(splats.take(rows))
        vectors = distinct.found()
        assert vectors is not None
        found.append(vectors)
    right = np.unique(splats.sh[:, 1:].reshape(len(splats), -1), axis=0)
    assert len(found[0].keys) == len(right) - 1, "0 needs no entry"
    for one in found:
        np.testing.assert_array_equal(one.keys, found[0].keys)
        np.testing.assert_array_equal(one.rows, found[0].rows)
    np.testing.assert_array_equal(np.unique(found[0].rows, axis=0), right[right.any(axis=1)])


def test_zeros_of_either_sign_are_one_vector():
    splats = shared_scene(100, n_vectors=3)
    sh = splats.sh.copy()
    sh[::2, 1:] = np.where(sh[::2, 1:] == 0, -0.0, sh[::2, 1:])
    distinct = Distinct(100)
    distinct.take(replace(splats, sh=sh))
    vectors = distinct.found()
    assert vectors is not None
    assert len(vectors.keys) == 2
    assert not np.signbit(vectors.rows[vectors.rows == 0]).any()


@pytest.mark.parametrize(("n_vectors", "is_shared"), [(25, True), (26, False)])
def test_a_quarter_of_the_splats_may_have_sh_of_their_own(n_vectors, is_shared):
    splats = shared_scene(100, n_vectors=n_vectors)
    vectors = np.random.default_rng(0).normal(size=(n_vectors, 8, 3)).astype(np.float32)
    sh = splats.sh.copy()
    sh[:, 1:] = vectors[np.arange(100) % n_vectors]
    distinct = Distinct(100)
    distinct.take(replace(splats, sh=sh))
    assert (distinct.found() is not None) == is_shared
    assert distinct.is_over != is_shared


def test_what_was_declared_and_left_out_does_not_count():
    splats = shared_scene(100, n_vectors=20)
    distinct = Distinct(1000)
    distinct.take(splats.take(slice(0, 40)))
    assert not distinct.is_over
    assert distinct.found() is None, "most of these have SH of their own"


def test_two_vectors_with_one_key_are_not_taken_for_one(monkeypatch):
    monkeypatch.setattr("evogs_codec.jobs.distinct.keys_of", lambda rows: np.zeros(len(rows), int))
    distinct = Distinct(100)
    distinct.take(shared_scene(100, n_vectors=3))
    assert distinct.is_over
    later = Distinct(100)
    for value in (1.0, 2.0):
        splats = shared_scene(10, n_vectors=1)
        later.take(replace(splats, sh=np.full_like(splats.sh, value)))
    assert later.is_over


def test_splats_without_sh_share_none():
    distinct = Distinct(100)
    splats = shared_scene(100, n_vectors=1)  # all 0
    distinct.take(splats)
    assert distinct.found() is None
    distinct.take(replace(splats, sh=splats.sh[:, :1]))
    assert distinct.found() is None


# --- streams --------------------------------------------------------------------------------------


def test_all_tiles_share_one_palette(scene, right, plain):
    decoded = decode(right, verify=True)
    directory = decoded.directory
    assert len(directory.tiles) == 4
    assert directory.has_palette
    assert decoded.n_leaves == N
    assert set(directory.packets["tile"][directory.packets["component"] == PALETTE]) == {0}
    views = Views.of(scene, n_views=6)
    assert len(right) < len(plain)
    assert views.psnr(decoded.leaves()) > views.psnr(decode(plain).leaves()) + 2


def test_other_decoders_decode_it(right, folder, capsys):
    assert oracle.decode(right, check_digests=True).dump() == decode(right).dump()
    assert main(["validate", str(folder / "right.evogs")]) == 0
    assert "valid" in capsys.readouterr().out


@pytest.mark.thorough
def test_the_order_of_files_and_splats_changes_no_byte(folder, right, tmp_path):
    parts = [folder / f"part-{number}.ply" for number in (2, 0, 1)]
    assert coded(tmp_path / "a.evogs", parts) == right


@pytest.mark.thorough
def test_two_processes_change_no_byte(folder, full_views, tmp_path):
    files = [folder / "whole.ply"]
    right = coded(tmp_path / "right.evogs", files)
    assert coded(tmp_path / "a.evogs", files, engine=Engine(workers=2)) == right


@pytest.mark.thorough
@pytest.mark.parametrize("stops_at", ["merge", "number_picks", "Entries"])
def test_a_run_that_was_stopped_is_resumed(folder, right, tmp_path, monkeypatch, stops_at):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    out, files = tmp_path / "a.evogs", [folder / "whole.ply"]
    with monkeypatch.context() as patch:
        where = "Entries.of" if stops_at == "Entries" else stops_at
        patch.setattr(f"evogs_codec.jobs.encode.{where}", full)
        with pytest.raises(OSError, match="No space left"):
            coded(out, files)
    for name in ("jobs.encode.code_tile", "jobs.encode.survey_tile", "jobs.scratch.partition"):
        monkeypatch.setattr(f"evogs_codec.{name}", None)
    assert coded(out, files, resume=True) == right
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.thorough
@pytest.mark.parametrize("kept", [0, 0.5])
@pytest.mark.parametrize("name", ["vectors.npz", "*.unnumbered"])
def test_what_a_run_left_of_a_palette_is_named_where_it_was_damaged(
    folder, tmp_path, monkeypatch, name, kept
):
    out, files = tmp_path / "a.evogs", [folder / "whole.ply"]
    with monkeypatch.context() as patch:
        patch.setattr("evogs_codec.jobs.encode.Entries.of", None)
        with pytest.raises(TypeError):
            coded(out, files)
    path = next(iter(sorted((tmp_path / "a.evogs.parts").glob(name))))
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(InputError, match="is damaged: run again without --resume") as said:
        coded(out, files, resume=True)
    assert str(path) in str(said.value)
    assert not out.exists()


@pytest.mark.thorough
def test_a_palette_that_does_not_pay_is_left_out(folder, plain, tmp_path, monkeypatch):
    monkeypatch.setattr("evogs_codec.jobs.encode.palette_pays", lambda *_: False)
    assert coded(tmp_path / "a.evogs", [folder / "whole.ply"]) == plain


@pytest.mark.thorough
def test_too_many_vectors_are_as_none(folder, plain, tmp_path, monkeypatch):
    monkeypatch.setattr("evogs_codec.jobs.distinct.MAX_VECTORS", 30)
    assert coded(tmp_path / "a.evogs", [folder / "whole.ply"]) == plain
    assert not read_directory(plain).has_palette


@pytest.mark.thorough
def test_tiles_may_be_without_sh(tmp_path, full_views):
    splats = shared_scene(N, n_vectors=40)
    sh = splats.sh.copy()
    sh[splats.means[:, 0] < np.median(splats.means[:, 0]), 1:] = 0
    scene = replace(splats, sh=sh)
    write_ply(tmp_path / "a.ply", scene)
    decoded = decode(coded(tmp_path / "a.evogs", [tmp_path / "a.ply"]), verify=True)
    assert decoded.directory.has_palette
    assert Views.of(scene, n_views=6).psnr(decoded.leaves()) > 36


@pytest.mark.thorough
def test_tiles_with_a_palette_are_near_a_scene_encoded_whole(tmp_path, full_views):
    rng = np.random.default_rng(0)
    scene = make_scene(12_000)
    entries = rng.normal(0, 0.1, (300, scene.sh.shape[1] - 1, 3)).astype(np.float32)
    rest = entries[rng.integers(0, len(entries), len(scene))]
    scene = replace(scene, sh=np.concatenate([scene.sh[:, :1], rest], axis=1))
    write_ply(tmp_path / "a.ply", scene)
    options = JobOptions(levels=4, per_tile=3000)
    tiled = coded(tmp_path / "a.evogs", [tmp_path / "a.ply"], options)
    whole = encode_scene(scene, levels=4, n_tiles=4)
    assert read_directory(tiled).has_palette
    assert read_directory(whole).has_palette
    views = Views.of(scene, n_views=6)
    assert len(tiled) < 1.02 * len(whole)
    assert views.psnr(decode(tiled).leaves()) > views.psnr(decode(whole).leaves()) - 0.8
