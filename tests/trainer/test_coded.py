"""`python -m tools.bench.coded`: runs at several distortions become curves and a page."""

import csv
from dataclasses import replace

import pytest

from reference_trainer.config import Integers
from reference_trainer.queue import run_job
from tests.trainer import tiny
from tools.bench.coded.cli import parse
from tools.bench.coded.curves import coded_levels, curve_jobs, distances
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

    write_page(tmp_path / "coded.md", rows, "tiny", "evogs-mixed")
    with (tmp_path / "coded" / "points.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    text = (tmp_path / "coded.md").read_text()
    assert "| EvoGS mixed | 0.01 |" in text
    assert "LapisGS" in text.split("BD-rate: negative")[1]
    assert (tmp_path / "coded" / "curves.png").stat().st_size > 1000


def test_the_command_has_the_defaults_of_the_comparison():
    args = parse(["--data", "lego", "--out", "out"])
    assert args.methods == ["evogs-mixed", "evogs", "evogs-a", "lapis"]
    assert (args.size, args.distortions) == (200, [0.02, 0.07, 0.25])
