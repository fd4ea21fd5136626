"""`python -m tools.bench.coded`: runs at several distortions become curves and a page."""

import csv
from dataclasses import replace

import pytest

from reference_trainer.config import Integers
from reference_trainer.queue import run_job
from tests.trainer import tiny
from tools.bench.again import command_again
from tools.bench.coded.bd_rate import psnr_at
from tools.bench.coded.cli import DEFAULTS, parse
from tools.bench.coded.curves import coded_levels, curve_jobs, distances
from tools.bench.coded.removals import removals, worth
from tools.bench.paper.runs import Views, read_run

pytest.importorskip("matplotlib")
METHODS = ["evogs-mixed", "lapis"]
DISTORTIONS = [0.01, 1.0]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    config = replace(tiny.config(), integers=Integers(0.3))
    views = Views(tiny.pyramid(), 1)
    found = []
    for job in curve_jobs(config, METHODS, DISTORTIONS):
        run_job(job, tiny.dataset(), folder, "cpu")
        if job.name == "level0":
            continue
        run = read_run(folder / job.name / "result.json", "coded")
        distortion = job.config.integers.distortion if job.config.integers.part else None
        own = {"method": run.method, "distortion": distortion, "seconds": run.seconds}
        found += [own | row for row in coded_levels(views, run)]
    return found


def points(rows, method, level):
    return [r for r in rows if (r["method"], r["level"]) == (method, level)]


def test_a_tree_has_a_point_for_every_distortion_and_layers_one_for_every_price(rows):
    for method in METHODS:
        at_last = sorted(points(rows, method, 1), key=lambda row: row["bytes"])
        assert len(at_last) >= 2
        assert at_last[0]["psnr"] < at_last[-1]["psnr"]
        for one, other in zip(points(rows, method, 0), points(rows, method, 1), strict=True):
            assert one["bytes"] < other["bytes"]


def test_distances_are_of_levels_above_the_first(rows):
    (against,) = distances(rows, "evogs-mixed", [("evogs-mixed",)])
    assert against["against"] == "EvoGS mixed"
    assert against["L1 BD-rate, %"] == pytest.approx(0)
    assert "L0 BD-rate, %" not in against


def test_the_page_has_all_points_and_distances(rows, tmp_path):
    from tools.bench.coded.page import write_page

    needed = [{"without": "psi of sh 1", "kB less": 1.0, "dB less": 0.5}]
    write_page(tmp_path / "coded.md", rows, "python -m tools", "evogs-mixed", needed)
    with (tmp_path / "coded" / "points.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    text = (tmp_path / "coded.md").read_text()
    assert "Made by `python -m tools`." in text
    assert "| EvoGS mixed | 0.01 |" in text
    assert "| psi of sh 1 | 1 | 0.5 |" in text
    assert "LapisGS" in text.split("BD-rate: negative")[1]
    assert (tmp_path / "coded" / "curves.png").stat().st_size > 1000


def test_a_tree_without_a_class_of_numbers_is_smaller_and_worse():
    tree = tiny.trained(method="evogs-mixed", integers=Integers(0.3, distortion=0.01))
    views = Views(tiny.pyramid(), 1)
    found = {row["without"]: row for row in removals(tree, views)}
    kinds = ["position", "rotation", "scale", "opacity", "sh 0", "sh 1"]
    groups = ["position", "rotation", "scale", "opacity", "sh"]
    names = [f"psi of {k}" for k in kinds] + [f"alpha of {g}" for g in groups] + ["refines"]
    assert list(found) == names
    assert found["psi of position"]["bytes"] > 0
    assert found["refines"]["bytes"] > 0
    for group in ("position", "rotation", "sh"):  # of mixed trees they are 1
        assert found[f"alpha of {group}"]["bytes"] == found[f"alpha of {group}"]["lost"] == 0
    assert any(row["lost"] != 0 for row in found.values())


def test_numbers_are_worth_what_their_bytes_are_on_the_curve():
    rows = [{"without": "x", "bytes": 50, "lost": 0.7, "whole": 100}]
    (found,) = worth(rows, [(50, 30.0), (100, 31.5)])
    assert found == {
        "without": "x", "kB less": 0.05, "dB less": 0.7, "dB less by distortion": 1.5
    }  # fmt: skip
    (found,) = worth(rows, [(50, 30.0), (100, 29.0)])
    assert found["dB less by distortion"] is None


def test_curves_go_on_beyond_their_ends():
    curve = [(100.0, 30.0), (200.0, 31.0), (400.0, 31.5)]
    assert psnr_at(curve, 200) == pytest.approx(31)
    assert psnr_at(curve, 50) == pytest.approx(29)
    assert psnr_at(curve, 800) == pytest.approx(32)
    assert 30 < psnr_at(curve, 150) < 31


def test_the_command_of_a_page_names_no_folder_of_this_machine():
    args = parse(["--data", "a/lego/", "--out", "b", "--levels", "2", "--iterations", "9", "8"])
    right = "python -m tools --data lego --out OUT --levels 2 --iterations 9 8"
    assert command_again("python -m tools", args, DEFAULTS) == right
    args = parse(["--data", "lego", "--out", "b", "--test-every", "4", "--distortions", "0.5"])
    right = "python -m tools --data lego --out OUT --distortions 0.5 --test-every 4"
    assert command_again("python -m tools", args, DEFAULTS) == right


def test_the_command_has_the_defaults_of_the_comparison():
    args = parse(["--data", "lego", "--out", "out"])
    assert args.methods == ["evogs-mixed", "evogs", "evogs-a", "lapis"]
    assert (args.size, args.distortions) == (200, [0.02, 0.07, 0.25])
