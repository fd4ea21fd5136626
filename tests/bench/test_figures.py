"""`python -m tools.bench`: the page, the trade-off surface, the first picture, files of others."""

import argparse
import shlex
import sys
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import PRESETS, Cut, decode_leaves, lift, read_directory

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tools.bench import cli, decimate, measure, page, plots, prefix, sog, splat_transform, subjects
from tools.bench.surface import efforts, fronts, iterations, precision, streams

pytestmark = pytest.mark.thorough

# In the place of splat-transform: what it is asked to read, it writes.
COPIES = """
import pathlib, sys
from evogs_codec import read_ply, write_ply
arguments = [a for a in sys.argv[1:] if a not in ("--quiet", "--overwrite", "--gpu", "cpu")]
source, target = pathlib.Path(arguments[0]), pathlib.Path(arguments[-1])
if "--decimate" in arguments:
    n = int(arguments[arguments.index("--decimate") + 1])
    write_ply(target, read_ply(source).take(slice(n)))
else:
    target.write_bytes(source.read_bytes())
"""


def number(row: dict[str, object], column: str) -> float:
    return float(str(row[column]))


@pytest.fixture(scope="module")
def subject() -> subjects.Subject:
    splats = make_scene(300)
    views = Views(splats, cameras_around(splats, "z", 32)[::8])
    return subjects.Subject.of_tree("small", lift(splats, 3), PRESETS["scene"], views)


@pytest.fixture
def command(tmp_path) -> str:
    program = tmp_path / "program.py"
    program.write_text(COPIES)
    return shlex.join([sys.executable, str(program)])


def test_a_point_is_dominated_by_the_best_that_costs_no_more():
    points = [("a", 10, 30), ("b", 12, 29), ("c", 12, 31), ("d", 9, 20)]
    assert fronts.better(points) == ["", "c", "", ""]


def test_times_have_to_be_shorter_by_more_than_their_noise():
    points = [("a", 100, 30), ("b", 95, 30), ("c", 50, 30)]
    assert fronts.better(points, 0.1) == ["c", "c", ""]


def test_streams_of_a_scene_are_points_with_what_dominates_them(subject, monkeypatch):
    monkeypatch.setattr(streams, "TARGETS", (30,))
    monkeypatch.setattr(streams, "BITS", (6,))
    monkeypatch.setattr(streams, "FINER", (2,))
    rows = streams.streams([subject])
    settings = [row["setting"] for row in rows]
    assert settings[:3] == ["preset", "--finer 2", "--bits 6"]
    assert len(set(settings)) == len(settings)
    assert {row["smaller"] for row in rows} <= {"", *settings}
    worth = {row["setting"]: number(row, "PSNR, dB") for row in rows}
    assert worth["--level 0"] < worth["--level 1"] < worth["preset"] < worth["--finer 2"]


def test_coarse_sh_on_all_splats_is_a_cut(subject):
    directory = read_directory(subject.stream)
    cuts = {setting: cut for _, setting, cut in streams._cuts(directory)}
    coarse = decode_leaves(subject.stream, cuts["SH 1+ to level 0"])
    assert len(coarse) == subject.tree.n_leaves
    assert coarse.sh_degree == subject.tree.sh_degree
    assert np.array_equal(coarse.means, decode_leaves(subject.stream, Cut.full(directory)).means)


def test_efforts_write_the_same_integers(subject, monkeypatch):
    monkeypatch.setattr(efforts, "EFFORTS", (1, 18))
    rows = efforts.efforts([subject])
    assert [row["to the default"] for row in rows][1] == "1.000"
    assert number(rows[0], "bytes a splat") > number(rows[1], "bytes a splat")


def test_float32_is_near_float64_and_its_exponential_near_the_true_one(subject):
    rows = precision.precisions([subject])
    assert [row["numbers"] for row in rows] == ["float64", "float32"]
    assert number(rows[1], "PSNR to float64, dB") > 90
    errors = [number(row, "largest relative error") for row in precision.exponentials()]
    assert max(errors[:2]) < 1e-6
    assert errors[2] < 1e-14


def test_iterations_are_those_of_the_last_level(tmp_path):
    for name, gain in (("a", 0), ("b", 1)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "log.csv").write_text(
            "stage,level,iteration,loss,splats,psnr,seconds\n"
            + "".join(
                f"{level},{level},{at},0.1,10,{20 + level + at / 1000 + gain},{at}\n"
                for level in (0, 1)
                for at in (500, 1000, 2000)
            )
        )
    rows = iterations.iterations(tmp_path)
    assert [(row["run"], row["iterations"]) for row in rows] == [
        ("a", 1000), ("a", 2000), ("b", 1000), ("b", 2000),
    ]  # fmt: skip
    assert [row["dominated by"] for row in rows] == ["b at 1000", "b at 2000", "", ""]


def test_the_first_picture_takes_part_of_a_stream_and_all_of_other_files(subject, tmp_path):
    pytest.importorskip("gsply", reason="gsply is not installed")
    from tools.bench.first import first

    rows = {row["picture"]: row for row in first([subject], tmp_path)}
    start, whole = rows["evogs, first step"], rows["evogs, whole"]
    assert number(start, "bytes") < number(whole, "bytes") == len(subject.encoded())
    assert number(start, "splats") < number(whole, "splats") == subject.tree.n_leaves
    assert rows["PLY"]["PSNR, dB"] == "inf"


def test_prefixes_are_worth_more_the_longer_they_are(subject):
    trees = [replace(subject, name=name) for name in ("small", "LapisGS", "EvoGS")]
    rows = prefix.prefixes(trees)
    assert [row["order"] for row in rows] == ["file", "by level"] * 3
    assert {row["100 %"] for row in rows} == {rows[0]["100 %"]}
    assert [row["above LapisGS, dB"] for row in rows] == ["", "", "", "", "0.00", "0.00"]
    assert number(rows[0], "25 %") < number(rows[0], "mean, dB") < number(rows[0], "100 %")
    assert prefix.rivals([subject], None) == (subject,)
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    assert len(plots.PLOTS["prefix"](rows).axes) == 3


def test_decimation_is_measured_at_as_many_splats(subject, command, tmp_path):
    rows = decimate.decimate([subject], command, tmp_path)
    assert [row["level"] for row in rows] == [0, 1]
    assert all(row["splats"] == row["decimated"] for row in rows)


def test_sog_is_compared_at_its_psnr(subject, command, tmp_path, monkeypatch):
    monkeypatch.setattr(sog, "read_sog", lambda _, __: decode_leaves(subject.stream, sh_degree=0))
    theirs, ours = sog.sog([subject], command, tmp_path)
    assert theirs["to SOG"] == "1.00"
    assert abs(number(ours, "PSNR, dB") - number(theirs, "PSNR, dB")) <= 0.2
    assert not set(sog.published()[0]) - {
        "format", "scene", "SH degree", "bytes a splat", "pictures", "who says so",
    }  # fmt: skip


def test_a_sog_file_is_read_through_a_ply(subject, command, tmp_path):
    path = splat_transform.write_sog(command, subject.views.scene, tmp_path / "s.sog")
    assert np.array_equal(splat_transform.read_sog(command, path).sh, subject.views.scene.sh)


def test_figures_are_a_command_that_writes_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cli, "find_spec", lambda _: True)
    monkeypatch.setattr(subjects, "make_scene", lambda: make_scene(100))
    monkeypatch.setattr("sys.argv", ["figures", "--only", "sog", "--out", str(tmp_path)])
    assert cli.main() == 0
    assert "python -m tools.bench --only sog" in (tmp_path / "figures.md").read_text()
    monkeypatch.setattr(cli, "find_spec", lambda _: None)
    assert cli.main() == 1
    assert "the figures need numba" in capsys.readouterr().err


def test_the_shipped_scene_is_the_subject_where_none_is_named(monkeypatch):
    monkeypatch.setattr(subjects, "make_scene", lambda: make_scene(100))
    (found,) = subjects.subjects(argparse.Namespace(ply=None, tree=None, photos=None, up="z"))
    assert (found.name, found.tree.n_leaves) == ("shipped", 100)


ROWS: page.Rows = [
    {"scene": "s", "axis": "a", "bytes a splat": "10", "PSNR, dB": "30", "smaller": ""},
    {"scene": "s", "axis": "a", "bytes a splat": "20", "PSNR, dB": "29", "smaller": "x"},
]


def measured() -> page.Rows:
    """What is measured.

    What a reader
    has to know.
    """
    return ROWS


def test_the_page_says_what_the_docstring_says_below_its_first_line():
    assert page.text_of(measured) == "What a reader has to know."


def test_tables_that_are_not_remade_stay(tmp_path):
    page.write(
        tmp_path, "all", {"one": ("One", "", ROWS), "two": ("Two", "", ROWS)}, keep_others=False
    )
    page.write(tmp_path, "some", {"two": ("Two", "Words.", ROWS[:1])}, keep_others=True)
    text = (tmp_path / "figures.md").read_text()
    assert text.count("Made by `all`") == text.count("Made by `some`") == 1
    assert "## One" in text
    assert "Words." in text
    assert len((tmp_path / "figures" / "one.csv").read_text().splitlines()) == 3


def test_a_table_that_has_a_picture_shows_it(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    page.write(tmp_path, "all", {"surface": ("Surface", "", ROWS)}, keep_others=False)
    assert "![Surface](figures/surface.png)" in (tmp_path / "figures.md").read_text()
    assert (tmp_path / "figures" / "surface.png").read_bytes().startswith(b"\x89PNG")
    assert set(plots.PLOTS) <= {
        "surface",
        "surface-effort",
        "surface-iterations",
        "stream-curves",
        "prefix",
        "loss-curves",
    }


def test_contenders_in_processes_of_their_own_take_turns(tmp_path):
    log = tmp_path / "log"
    before = f"import os\nlog = open({str(log)!r}, 'a', buffering=1)"
    contenders = {
        name: measure.Code(before, f"log.write(f'{name} {{os.getpid()}}\\n')") for name in "ab"
    }
    seconds = measure.take_turns_apart(contenders, 2)
    names, processes = zip(*(line.split() for line in log.read_text().splitlines()), strict=True)
    assert names == tuple("ababab")
    assert processes[:2] * 3 == processes
    assert len({*processes}) == 2
    assert set(seconds) == {"a", "b"}
    assert min(seconds.values()) > 0
