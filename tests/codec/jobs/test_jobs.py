"""Scenes that are encoded tile by tile: the same bytes wherever and whenever jobs run."""

import hashlib
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evogs_codec import (
    InputError,
    NotRepresentableError,
    SceneInfo,
    decode,
    encode_scene,
    read_directory,
    write_ply,
)
from evogs_codec.jobs import Engine, JobOptions, encode_files
from evogs_codec.jobs import encode as encode_module
from evogs_codec.jobs.engines import Workers
from evogs_codec.jobs.merge import merge
from evogs_codec.jobs.partition import _append
from evogs_codec.jobs.weighed import Weighed
from evogs_codec.render import Views
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene.measure import ALL_LOOK_UP_TO as FEW
from tests.support.dying_jobs import dies_always, dies_at_first, doubled, process_of
from tests.support.view_sizes import FULL, SMALL, views_of

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
    return make_scene(N)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    """Files of the scene, whole and in parts that are not in order."""
    made = tmp_path_factory.mktemp("large")
    write_ply(made / "whole.ply", scene)
    order = np.random.default_rng(1).permutation(N)
    for number, rows in enumerate(np.array_split(order, 3)):
        write_ply(made / f"part-{number}.ply", scene.take(rows))
    return made


@pytest.fixture(scope="module")
def right(folder):
    """The stream that all others are to be."""
    encode_files([folder / "whole.ply"], folder / "right.evogs", OPTIONS, engine=SERIAL)
    return (folder / "right.evogs").read_bytes()


@pytest.fixture(scope="module")
def right_of_full_views(folder):
    """The same, by views as processes that jobs start have them."""
    with views_of(FULL):
        encode_files([folder / "whole.ply"], folder / "full.evogs", OPTIONS, engine=SERIAL)
    return (folder / "full.evogs").read_bytes()


def test_the_stream_has_all_splats_in_tiles(scene, right_of_full_views, full_views):
    decoded = decode(right_of_full_views, verify=True)
    assert len(decoded.directory.tiles) == 4
    assert decoded.n_leaves == N
    assert Views.of(scene, n_views=6).psnr(decoded.leaves()) > 36


@pytest.mark.thorough
def test_what_is_said_of_a_scene_is_in_the_stream_of_all_tiles(folder, tmp_path):
    camera = '{"position":[0,-2,0.5],"target":[0,0,0.25],"fov_y":45}'
    text = {"camera": camera, "crs": "EPSG:4978", "generator": "x"}
    options = replace(OPTIONS, info=SceneInfo(text=text))
    encode_files([folder / "whole.ply"], tmp_path / "x.evogs", options, engine=SERIAL)
    assert read_directory(tmp_path / "x.evogs").info.text == text


@pytest.mark.thorough
def test_tiles_look_as_the_same_tiles_of_a_scene_encoded_whole(tmp_path, full_views):
    # So many that the whole keeps all packets of SH bands: a tile cannot tell which look worse.
    scene = make_scene(FEW + 800)
    write_ply(tmp_path / "a.ply", scene)
    options = JobOptions(levels=4, per_tile=len(scene) // 4)
    encode_files([tmp_path / "a.ply"], tmp_path / "a.evogs", options, engine=SERIAL)
    tiled = (tmp_path / "a.evogs").read_bytes()
    whole = encode_scene(scene, levels=4, palette="never", n_tiles=4)
    views = Views.of(scene, n_views=6)
    assert len(tiled) < len(whole)
    assert views.psnr(decode(tiled).leaves()) > views.psnr(decode(whole).leaves()) - 0.1


@pytest.mark.thorough
@pytest.mark.parametrize(("layers", "more"), [(None, 0), (2, 1)])
def test_the_last_level_may_come_late_unless_layers_were_asked_for(
    folder, tmp_path, monkeypatch, layers, more
):
    monkeypatch.setattr("evogs_codec.encoding.late_level.LATE_GAIN_DB", math.inf)
    options = replace(OPTIONS, layers=layers, effort=1)
    encode_files([folder / "whole.ply"], tmp_path / "x.evogs", options, engine=SERIAL)
    assert read_directory(tmp_path / "x.evogs").n_levels == OPTIONS.levels + more


@pytest.mark.thorough
def test_the_order_of_files_and_splats_changes_no_byte(folder, right, tmp_path):
    parts = [folder / f"part-{number}.ply" for number in (2, 0, 1)]
    encode_files(parts, tmp_path / "a.evogs", OPTIONS, engine=SERIAL)
    assert (tmp_path / "a.evogs").read_bytes() == right
    assert list(tmp_path.iterdir()) == [tmp_path / "a.evogs"], "the scratch folder is gone"


@pytest.mark.thorough
@pytest.mark.parametrize("engine", [Engine(workers=1), Engine(workers=2), Engine("dask", 2)])
def test_no_engine_changes_a_byte(engine, folder, right_of_full_views, tmp_path):
    if engine.name == "dask":
        pytest.importorskip("distributed")
    encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=engine)
    assert (tmp_path / "a.evogs").read_bytes() == right_of_full_views


@pytest.mark.thorough
def test_a_run_that_was_killed_is_resumed(folder, right_of_full_views, full_views, tmp_path):
    out = tmp_path / "a.evogs"
    code = (
        "from evogs_codec.jobs import *;"
        f"encode_files([{str(folder / 'whole.ply')!r}], {str(out)!r},"
        f" JobOptions(levels=3, per_tile={PER_TILE}, effort=3), engine=Engine('serial'))"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    scratch = tmp_path / "a.evogs.parts"
    deadline = time.monotonic() + 120
    while not list(scratch.glob("*.evogs")) and time.monotonic() < deadline:
        assert process.poll() is None, "it ended before a tile was encoded"
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not out.exists()
    kept = {path: path.stat().st_mtime_ns for path in scratch.glob("*.evogs")}
    assert 1 <= len(kept) < 4
    encode_files([folder / "whole.ply"], out, OPTIONS, engine=SERIAL, resume=True)
    found, right = out.read_bytes(), right_of_full_views
    assert hashlib.sha256(found).digest() == hashlib.sha256(right).digest()
    assert not scratch.exists()


@pytest.mark.thorough
def test_what_was_done_is_not_done_again(folder, right, tmp_path, monkeypatch):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("evogs_codec.jobs.encode.merge", full)
        with pytest.raises(OSError, match="No space left"):
            encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL)
    monkeypatch.setattr("evogs_codec.jobs.encode.code_tile", None)
    monkeypatch.setattr("evogs_codec.jobs.encode.survey_tile", None)
    monkeypatch.setattr("evogs_codec.jobs.scratch.partition", None)
    encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL, resume=True)
    assert (tmp_path / "a.evogs").read_bytes() == right


@pytest.fixture
def weighed(monkeypatch):
    """How often a tile was drawn and how often it was not, since that was known."""
    weigh, counts = Weighed.of, Counter[str]()

    def weighed(*job):
        found = weigh(*job)
        counts["known" if found.prepared.task.drawn else "drawn"] += 1
        return found

    monkeypatch.setattr(Weighed, "of", weighed)
    return counts


def test_one_tile_is_weighed_once_and_has_the_same_bytes(folder, tmp_path, monkeypatch, weighed):
    options = replace(OPTIONS, per_tile=2 * N)
    encode_files([folder / "whole.ply"], tmp_path / "alone", options, engine=SERIAL)
    assert weighed == {"drawn": 1}
    monkeypatch.setattr(encode_module._Run, "_is_alone", False)
    encode_files([folder / "whole.ply"], tmp_path / "other", options, engine=SERIAL)
    assert weighed == {"drawn": 2, "known": 1}
    assert (tmp_path / "alone").read_bytes() == (tmp_path / "other").read_bytes()


def test_a_surveyed_tile_is_drawn_once_and_has_the_same_bytes(
    folder, right, tmp_path, monkeypatch, weighed
):
    encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL)
    n_tiles = len(read_directory(right).tiles)
    assert weighed["drawn"] == n_tiles
    assert weighed["known"] > 0
    assert (tmp_path / "a.evogs").read_bytes() == right
    monkeypatch.setattr(Weighed, "keep_drawn", lambda *_: None)
    weighed.clear()
    encode_files([folder / "whole.ply"], tmp_path / "b.evogs", OPTIONS, engine=SERIAL)
    assert weighed["drawn"] > n_tiles
    assert (tmp_path / "b.evogs").read_bytes() == right


def test_there_may_be_more_tiles_than_open_files(folder, tmp_path, monkeypatch):
    resource = pytest.importorskip("resource")
    kept = []

    def keep(parts, _out, _entries):
        kept.extend(parts)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("evogs_codec.jobs.encode.merge", keep)
    with pytest.raises(OSError, match="No space left"):
        encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL)
    before, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with kept[0].open("rb") as file:
        resource.setrlimit(resource.RLIMIT_NOFILE, (file.fileno() + 20, most))
    try:
        merge(kept * 20, tmp_path / "b.evogs")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, most))
    assert len(read_directory(tmp_path / "b.evogs").tiles) == 20 * len(kept)


def test_the_scratch_of_other_options_is_not_resumed(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("evogs_codec.jobs.scratch.partition", None)
    with pytest.raises(TypeError):
        encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL)
    other = JobOptions(levels=2, per_tile=PER_TILE)
    with pytest.raises(InputError, match="is of other files, options or another version"):
        encode_files([folder / "whole.ply"], tmp_path / "a.evogs", other, resume=True)


@pytest.fixture(scope="module")
def left(folder, tmp_path_factory):
    """The scratch folder of a run that was stopped before its tiles were joined."""
    out = tmp_path_factory.mktemp("left") / "a.evogs"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evogs_codec.jobs.encode.merge", None)
        with pytest.raises(TypeError):
            encode_files([folder / "whole.ply"], out, OPTIONS, engine=SERIAL)
    return out.with_name("a.evogs.parts")


@pytest.fixture
def stopped(left, tmp_path):
    """The same, of this test alone."""
    return shutil.copytree(left, tmp_path / "a.evogs.parts")


@pytest.mark.parametrize(
    "name",
    ["000000.rows", "000001.stand-ins", "partition.npz", "*.survey", "*.gains", "000000.*.evogs"],
)
@pytest.mark.parametrize("kept", [0, 0.5, -1])
def test_a_scratch_folder_that_was_damaged_is_named(stopped, folder, tmp_path, name, kept):
    path = next(iter(sorted(stopped.glob(name))))
    data = bytearray(path.read_bytes())
    if kept < 0 and path.suffix == ".evogs":
        data[-5] ^= 1  # in the last packet
    elif kept < 0:
        data.append(0)
    else:
        del data[int(kept * len(data)) :]
    path.write_bytes(data)
    if kept < 0 and path.suffix not in (".evogs", ".rows", ".stand-ins"):
        return  # what is behind an archive is not read
    out = tmp_path / "a.evogs"
    with pytest.raises(InputError, match="is damaged: run again without --resume") as said:
        encode_files([folder / "whole.ply"], out, OPTIONS, engine=SERIAL, resume=True)
    assert str(path) in str(said.value)
    assert not out.exists()


@pytest.mark.parametrize("kept", [0, 0.5])
def test_what_a_survey_keeps_is_named_where_it_was_damaged(stopped, folder, tmp_path, kept):
    path = next(iter(sorted(stopped.glob("*.drawn"))))
    for part in stopped.glob(f"{path.stem}.*.evogs"):
        part.unlink()  # so that it is read
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    said = f"{path.name}: is damaged: run again without --resume"
    with pytest.raises(InputError, match=said):
        encode_files(
            [folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL, resume=True
        )


def test_a_mark_that_was_damaged_is_named(stopped, folder, tmp_path):
    (stopped / "evogs-scratch.json").write_text("")
    with pytest.raises(InputError, match=r"evogs-scratch\.json: is damaged"):
        encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, resume=True)


def test_one_run_at_a_time_has_a_scratch_folder(stopped, folder, tmp_path):
    fcntl = pytest.importorskip("fcntl")
    there = sorted(stopped.iterdir())
    with (stopped / "evogs-scratch.lock").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        for resume in (False, True):
            with pytest.raises(InputError, match="another run uses it"):
                encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, resume=resume)
    assert sorted(stopped.iterdir()) == there


@pytest.mark.thorough
def test_file_systems_without_locks_will_do(folder, right, tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def without(*_arguments):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", without)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "evogs-scratch.lock").touch()  # of a run that was killed at its end
    out, scratch = tmp_path / "a.evogs", tmp_path / "parts"
    encode_files([folder / "whole.ply"], out, OPTIONS, engine=SERIAL, scratch=scratch)
    assert out.read_bytes() == right
    assert not scratch.exists()


def test_the_scratch_folder_has_neither_inputs_nor_the_output_nor_files_of_others(
    stopped, folder, tmp_path
):
    scene, mine = folder / "whole.ply", stopped / "mine.ply"
    with pytest.raises(InputError, match=r"is in the folder .*: name another one for --scratch"):
        encode_files([scene], stopped / "b.evogs", OPTIONS, scratch=stopped)
    mine.write_bytes(scene.read_bytes())
    with pytest.raises(InputError, match="is in the folder"):
        encode_files([mine], tmp_path / "b.evogs", OPTIONS, scratch=stopped)
    with pytest.raises(InputError, match=r"mine\.ply is there, which no run has made"):
        encode_files([scene], tmp_path / "a.evogs", OPTIONS)
    assert mine.read_bytes() == scene.read_bytes()


@pytest.mark.thorough
def test_a_link_may_lead_to_the_scratch_folder(folder, right, tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    out, scratch = tmp_path / "a.evogs", tmp_path / "link"
    encode_files([folder / "whole.ply"], out, OPTIONS, engine=SERIAL, scratch=scratch)
    assert out.read_bytes() == right
    assert list((tmp_path / "disk").iterdir()) == []


def test_a_full_disk_is_said_of_the_scratch_folder(tmp_path):
    rows = np.zeros((3, 14), np.float32)
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        _append(Path("/dev/full"), rows)


def test_sizes_beyond_all_numbers_are_refused_in_one_line(scene, tmp_path):
    write_ply(tmp_path / "a.ply", replace(scene, log_scales=scene.log_scales * 0 + 1e30))
    with pytest.raises((NotRepresentableError, InputError)):
        encode_files([tmp_path / "a.ply"], tmp_path / "a.evogs", OPTIONS, engine=SERIAL)


def test_a_folder_that_is_not_ours_is_not_deleted(folder, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "photo.png").write_bytes(b"mine")
    with pytest.raises(InputError, match="is not empty and not a scratch folder"):
        encode_files([folder / "whole.ply"], tmp_path / "a.evogs", OPTIONS, scratch=mine)
    assert (mine / "photo.png").read_bytes() == b"mine"


# --- engines --------------------------------------------------------------------------------------


def run_jobs(engine, function, calls):
    with Workers(engine) as workers:
        return dict(workers.run(function, calls))


@pytest.mark.thorough
def test_a_job_whose_worker_is_killed_is_done_again(tmp_path):
    calls = [(number, str(tmp_path / "mark")) for number in range(6)]
    found = run_jobs(Engine(workers=2), dies_at_first, calls)
    assert found == {number: 2 * number for number in range(6)}


@pytest.mark.thorough
def test_processes_are_replaced_before_they_keep_much_memory():
    engine, found = Engine(workers=1), []
    with Workers(engine) as workers:
        for n in (engine.n_jobs - 2, 4):  # of two stages
            found += [process for _, process in workers.run(process_of, [(k,) for k in range(n)])]
    assert len(found) == engine.n_jobs + 2
    assert Counter(found).most_common() == [(found[0], engine.n_jobs), (found[-1], 2)]


@pytest.mark.thorough
def test_a_worker_that_dies_between_two_stages_is_replaced():
    with Workers(Engine(workers=1)) as workers:
        ((_, first),) = workers.run(process_of, [(1,)])
        os.kill(first, signal.SIGKILL)
        ((_, second),) = workers.run(process_of, [(2,)])
    assert second != first


@pytest.mark.thorough
def test_workers_that_always_die_end_the_run_with_one_line():
    with pytest.raises(InputError, match="workers were killed 4 times"):
        run_jobs(Engine(workers=1), dies_always, [(1,)])


@pytest.mark.thorough
def test_a_worker_of_dask_that_is_killed_changes_nothing(tmp_path):
    pytest.importorskip("distributed")
    calls = [(number, str(tmp_path / "mark")) for number in range(4)]
    found = run_jobs(Engine("dask", 2), dies_at_first, calls)
    assert found == {number: 2 * number for number in range(4)}


@pytest.mark.thorough
def test_no_scheduler_at_an_address_is_one_line():
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        run_jobs(Engine("dask", scheduler="tcp://127.0.0.1:9"), doubled, [(1,)])
