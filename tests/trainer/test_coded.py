"""`python -m tools.bench.coded`: runs at several distortions become curves and a page."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import encode
from evogs_codec.model.tree import Kind
from evogs_codec.render import psnr, render
from evogs_codec.render.options import Options
from reference_trainer.config import Integers
from reference_trainer.models.backends import backend_for
from reference_trainer.queue import run_job
from tests.trainer import tiny
from tools.bench.again import command_again
from tools.bench.coded.bd_rate import bytes_at, psnr_at
from tools.bench.coded.cli import DEFAULTS, parse
from tools.bench.coded.curves import coded_levels, curve_jobs, distances
from tools.bench.coded.removals import removals, without, worth
from tools.bench.coded.sizes import at_the_next_size
from tools.bench.coded.trained_again import trained_again
from tools.bench.paper.measured import Bench
from tools.bench.paper.runs import Views, read_run

pytest.importorskip("matplotlib")
METHODS = ["evogs-mixed", "lapis"]
DISTORTIONS = [0.01, 1.0]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Each with the job that it was."""
    folder = tmp_path_factory.mktemp("runs")
    config = replace(tiny.config(), integers=Integers(0.3))
    found = []
    for job in curve_jobs(config, METHODS, DISTORTIONS):
        run_job(job, tiny.dataset(), folder, "cpu")
        if job.name != "level0":
            found.append((job, read_run(folder / job.name / "result.json", "coded")))
    return found


@pytest.fixture(scope="module")
def rows(runs):
    views = Views(tiny.pyramid(), 1)
    found = []
    for job, run in runs:
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
    assert against["L1 at worst, %"] == pytest.approx(0)
    assert "L0 BD-rate, %" not in against


def test_the_page_has_all_points_and_distances(rows, tmp_path):
    from tools.bench.coded.page import write_page

    needed = [{"without": "psi of sh 1", "kB less": 1.0, "dB less": 0.5}]
    at_next = {"own": 33.0, "next": 20.0, "wide": 27.0, "above": 33.5, "enlarged": 26.0}
    sizes = [{"method": "evogs", "level": 0} | at_next]
    write_page(tmp_path / "coded.md", rows, "python -m tools", "evogs-mixed", needed, sizes)
    with (tmp_path / "coded" / "points.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    text = (tmp_path / "coded.md").read_text()
    assert "Made by `python -m tools`." in text
    assert "| EvoGS mixed | 0.01 |" in text
    assert "| psi of sh 1 | 1 | 0.5 |" in text
    right = "| EvoGS | 0 | 33.00 | 20.00 | 33.50 | 13.50 | 27.00 | 6.50 | 26.00 |"
    assert right in text
    assert "LapisGS" in text.split("BD-rate, and bytes")[1]
    assert (tmp_path / "coded" / "curves.png").stat().st_size > 1000


def both(tree, other):
    """The steps of two trees, side by side."""
    return zip(tree.steps, other.steps, strict=True)


def test_a_tree_without_a_class_of_numbers_has_all_others(runs):
    tree = runs[0][1].tree()
    found = dict(without(tree))
    assert next(iter(found)) == "nothing"
    assert found["nothing"] is tree
    assert {"psi of position in splits", "psi of opacity in refines", "refines"} <= set(found)
    # Of mixed trees the other alphas are 1, so that nothing goes with them.
    alphas = [name for name in found if name.startswith("alpha")]
    assert alphas == ["alpha of scale", "alpha of opacity"]
    for name, rest in found.items():
        is_other = [
            a.psi.shape != b.psi.shape or (a.psi != b.psi).any() for a, b in both(rest, tree)
        ]
        assert any(is_other) == name.startswith(("psi", "refines"))
    for one, other in both(tree, found["psi of scale in splits"]):
        splits = one.kinds[one.kinds != Kind.DROP] == Kind.SPLIT
        right = one.psi.copy()
        right[7:10, splits] = 0
        np.testing.assert_array_equal(other.psi, right)
    for one, other in both(tree, found["alpha of scale"]):
        of_level = np.concatenate([s.alpha[2] for s in tree.steps if s.level == one.level])
        assert set(other.alpha[2]) <= {np.sort(of_level)[len(of_level) // 2]} if one.level else True
        np.testing.assert_array_equal(np.delete(other.alpha, 2, 0), np.delete(one.alpha, 2, 0))
    assert not any((step.kinds == Kind.REFINE).any() for step in found["refines"].steps)


def test_a_tree_is_trained_again_without_the_numbers_that_are_gone(runs):
    job, run = runs[0]
    backend, views = backend_for("cpu"), Views(tiny.pyramid(), 1)
    rest = dict(without(run.tree()))["psi of opacity"]
    found = trained_again(rest, job.config, views, None, 5, backend)
    assert found.quanta == rest.quanta
    np.testing.assert_array_equal(found.steps[0].adds, rest.steps[0].adds)
    assert not any(step.psi[10].any() for step in found.steps)
    assert any(not np.array_equal(a.psi, b.psi) for a, b in both(found, rest))
    assert len(found.leaves()) == len(rest.leaves())
    encode(found)  # whole multiples of its quanta, or this refuses


def test_removals_are_measured_once_and_what_is_smaller_is_worse(runs, tmp_path):
    _, run = runs[0]
    bench = Bench([], Views(tiny.pyramid(), 1), tmp_path, lambda text: None)
    called = []

    def again(tree):
        called.append(tree)
        return tree

    found = {row["without"]: row for row in removals(bench, run, again, 5)}
    assert removals(bench, run, again, 5) == list(found.values())
    assert len(called) == len(found)
    assert found["psi of position"]["bytes"] < found["nothing"]["bytes"]
    assert found["refines"]["bytes"] < found["psi of opacity in refines"]["bytes"]
    assert found["psi of position"]["psnr"] < found["nothing"]["psnr"]
    assert all(row["psnr"] == row["psnr_again"] for row in found.values())


def test_numbers_are_worth_what_their_bytes_are_on_the_curve():
    whole = {
        "without": "nothing", "bytes": 100, "bytes_again": 100, "psnr": 31.5, "psnr_again": 31.5
    }  # fmt: skip
    less = {"without": "x", "bytes": 60, "bytes_again": 50, "psnr": 29.0, "psnr_again": 31.0}
    (found,) = worth([whole, less], [(25, 30.0), (50, 30.5), (100, 31.5)])
    assert found["trained again: kB less"] == 0.05
    assert found["dB less by distortion"] == pytest.approx(1.0)
    assert -50 < found.pop("more bytes at equal PSNR, %") < 0  # 31 dB take more than 50 bytes
    worse = less | {"psnr_again": 30.5 - 1e-9}
    (found,) = worth([whole, worse], [(25, 30.0), (50, 30.5), (100, 31.5)])
    assert found["more bytes at equal PSNR, %"] == pytest.approx(0, abs=1e-4)
    lost = less | {"psnr_again": 29.9}
    (found,) = worth([whole, lost], [(25, 30.0), (50, 30.5), (100, 31.5)])
    assert found["more bytes at equal PSNR, %"] is None
    (found,) = worth([whole, less], [(50, 31.5), (100, 29.0)])
    assert found["dB less by distortion"] is None


def test_curves_go_on_beyond_their_ends():
    curve = [(100.0, 30.0), (200.0, 31.0), (400.0, 31.5)]
    assert psnr_at(curve, 200) == pytest.approx(31)
    assert psnr_at(curve, 50) == pytest.approx(29)
    assert psnr_at(curve, 800) == pytest.approx(32)
    assert 30 < psnr_at(curve, 150) < 31
    for n_bytes in (100, 200, 400, 800):
        assert bytes_at(curve, psnr_at(curve, n_bytes)) == pytest.approx(n_bytes)
    between = bytes_at(curve, 30.5)
    assert between is not None
    assert 100 < between < 200
    assert bytes_at(curve, 29.9) is None


def test_the_command_of_a_page_names_no_folder_of_this_machine():
    args = parse(["--data", "a/lego/", "--out", "b", "--levels", "2", "--iterations", "9", "8"])
    right = "python -m tools --data lego --out OUT --levels 2 --iterations 9 8"
    assert command_again("python -m tools", args, DEFAULTS) == right
    words = ["--test-every", "4", "--distortions", "0.5", "--as-published"]
    args = parse(["--data", "lego", "--out", "b", *words])
    right = "python -m tools --data lego --out OUT --distortions 0.5 --test-every 4 --as-published"
    assert command_again("python -m tools", args, DEFAULTS) == right


def test_the_command_has_the_defaults_of_the_comparison():
    args = parse(["--data", "lego", "--out", "out"])
    assert args.methods == ["evogs-mixed", "evogs", "evogs-a", "lapis"]
    assert (args.size, args.distortions) == (200, [0.02, 0.07, 0.25])


def test_a_level_at_the_next_size_is_drawn_as_it_is_and_dilated_as_at_its_own(runs):
    tree, views = runs[0][1].tree(), Views(tiny.pyramid(), 1)
    (found,) = at_the_next_size(tree, views)
    coarse, fine = tree.leaves(0), tree.leaves(1)
    assert found["own"] == views.psnr(coarse, 0)
    assert found["next"] == views.psnr(coarse, 1)
    assert found["above"] == views.psnr(fine, 1)
    (small,), (large,) = views.held_out(0), views.held_out(1)
    assert large.camera.width == 2 * small.camera.width
    wide = render(coarse, large.camera, views.background, options=Options(dilation=1.2))
    assert found["wide"] == pytest.approx(psnr(wide.clip(0, 1), large.image))
    assert 10 < found["enlarged"] < 60
