"""`python -m tools.bench.paper`: from finished runs to a page whose every number is in a file."""

import csv
import json
import shutil
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from evogs_codec import PRESETS, InputError
from reference_trainer.cli import pyramid_of
from reference_trainer.queue import jobs, run_job
from tests.trainer import tiny
from tools.bench.again import command_again
from tools.bench.paper import cli, compression, lpips, paper, plots, streaming
from tools.bench.paper.lpips import Lpips
from tools.bench.paper.measured import Bench
from tools.bench.paper.paper import sections, write_paper
from tools.bench.paper.quality import means
from tools.bench.paper.report import Figure, Section, pivot, write_report
from tools.bench.paper.runs import Views, find_runs

matplotlib = pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The runs of a queue: two seeds of a tree, layers, and one that was not finished."""
    out = tmp_path_factory.mktemp("runs")
    methods = ["evogs", "evogs-sym", "lapis"]
    for job in jobs(tiny.config(), methods, [0, 1], ["equal"]):
        if job.name not in ("equal-lapis-1", "equal-evogs-sym-1"):
            run_job(job, tiny.dataset(), out, "cpu")
    (out / "equal-lapis-1").mkdir()
    return out


@pytest.fixture(scope="module")
def page(folder, tmp_path_factory):
    """The page, and where its files are."""
    out = tmp_path_factory.mktemp("page")
    bench = Bench(find_runs(folder), Views(tiny.pyramid(), 1), out / "kept", lambda _: None)
    write_paper(bench, out / "page.md", "python -m tools.bench.paper", ["equal-lapis-1"])
    return out


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_page_has_every_section_and_its_numbers_are_in_files(page):
    text = (page / "page.md").read_text()
    for title in (
        "The paper's claims", "Quality, storage and memory", "Symmetric against asymmetric",
        "The design space", "Transparent splats", "Compressibility", "Energy and distribution",
        "Quality against bytes", "The foveal case", "Renders",
    ):  # fmt: skip
        assert f"## {title}" in text
    assert "Not trained yet: equal-lapis-1." in text
    assert "LPIPS was not measured" in text
    assert "Not there yet: A: independent children, B: independent residuals." in text
    assert "No run of EvoGS with enough levels yet." in text  # two levels have no periphery
    for line in text.splitlines():
        for part in line.split("](")[1:]:
            assert (page / part.split(")")[0]).stat().st_size
    runs = [row["run"] for row in rows_of(page / "page" / "runs.csv")]
    claims = [row["claim"] for row in rows_of(page / "page" / "claims.csv")]
    assert claims == [
        "PSNR over LapisGS at L1, dB", "transparent splats at L1, %",
        "PSNR over symmetric at L1, dB", "encoded, --preset trained: times smaller than raw at L1",
        "encoded, --preset trained: lost at L1, dB", "encoded: times smaller than raw at L1",
        "encoded: lost at L1, dB", "largest jump of a raw stream, % of LapisGS",
        "raw PSNR over LapisGS, mean over bytes, dB",
    ]  # fmt: skip
    assert runs == ["equal-lapis-0", "equal-evogs-sym-0", "equal-evogs-0", "equal-evogs-1"]


def test_what_was_measured_is_not_measured_again(page, folder, tmp_path):
    kept = shutil.copytree(page / "kept", tmp_path / "kept")
    said: list[str] = []
    bench = Bench(find_runs(folder), Views(tiny.pyramid(), 1), kept, said.append)
    found = {t.name: t.rows for s in sections(bench, []) for t in s.tables}
    assert not said
    assert len(found["streaming"]) == len(rows_of(page / "page" / "streaming.csv"))
    of_another = json.loads((kept / "equal-evogs-0.energy.json").read_text())
    of_another["key"]["tree"] = "of another"
    (kept / "equal-evogs-0.energy.json").write_text(json.dumps(of_another))
    assert {t.name: t.rows for s in sections(bench, []) for t in s.tables} == found
    assert said == ["equal-evogs-0: energy"]


def test_another_preset_is_measured_again(page, folder, tmp_path, monkeypatch):
    kept = shutil.copytree(page / "kept", tmp_path / "kept")
    said: list[str] = []
    bench = Bench(find_runs(folder)[-2:-1], Views(tiny.pyramid(), 1), kept, said.append)
    monkeypatch.setitem(PRESETS, "trained", PRESETS["trained"].finer(2))
    compression.rows(bench)
    assert said == ["equal-evogs-0: compression-trained"]


def test_the_same_numbers_give_the_same_picture(tmp_path):
    rows = [{"stream": "a", "coding": "raw", "bytes": k, "PSNR, dB": 10.0 + k} for k in range(3)]
    for name in ("one", "two"):
        write_report(
            tmp_path / f"{name}.md",
            "",
            [Section("", "", figures=[Figure("f", "", partial(plots.curves, rows))])],
        )
    assert (tmp_path / "one" / "f.png").read_bytes() == (tmp_path / "two" / "f.png").read_bytes()


def test_quality_is_the_mean_over_seeds(page, folder):
    paths = [folder / f"equal-evogs-{seed}" / "result.json" for seed in (0, 1)]
    expected = np.mean([json.loads(p.read_text())["levels"][1]["psnr"] for p in paths])
    rows = rows_of(page / "page" / "quality-equal.csv")
    (row,) = (r for r in rows if (r["method"], r["level"]) == ("EvoGS", "1"))
    assert row["seeds"] == "2"
    assert float(row["PSNR, dB"]) == pytest.approx(expected, abs=1e-5)


def test_without_runs_every_section_says_so(tmp_path):
    bench = Bench([], Views(tiny.pyramid(), 1), tmp_path, lambda _: None)
    write_paper(bench, tmp_path / "page.md", "python -m tools.bench.paper", ["equal-evogs-0"])
    text = (tmp_path / "page.md").read_text()
    assert "Not trained yet: equal-evogs-0." in text
    assert text.count("yet.") + text.count("yet:") + text.count("Needs runs") >= 10


def test_a_measure_of_lpips_is_a_column(folder, tmp_path):
    bench = Bench(find_runs(folder)[:1], Views(tiny.pyramid(), 1), tmp_path, lambda _: None)
    rows = means(bench, Lpips("", lambda a, b: float(np.abs(a - b).mean())))
    assert all(0 < row["LPIPS"] < 1 for row in rows)
    assert "LPIPS" not in means(bench)[0]


@pytest.fixture
def network(monkeypatch, tmp_path):
    """LPIPS and torchvision as packages that are there, with weights in a folder of torch's."""
    weights = SimpleNamespace(IMAGENET1K_V1=SimpleNamespace(url="https://host/vgg.pth"))
    modules = {
        "torchvision.models": SimpleNamespace(VGG16_Weights=weights),
        "lpips": SimpleNamespace(LPIPS=_Network),
    }
    monkeypatch.setattr(lpips, "find_spec", lambda name: name)
    monkeypatch.setattr(lpips, "import_module", modules.__getitem__)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    return tmp_path / "hub" / "checkpoints" / "vgg.pth"


class _Network(torch.nn.Module):
    def __init__(self, net, verbose):
        super().__init__()

    def forward(self, a, b, normalize):
        assert a.shape == (1, 3, 4, 5)
        return (a - b).abs().mean().reshape(1, 1, 1, 1)


def test_lpips_is_measured_only_where_its_weights_are(network):
    assert lpips.find_lpips().says.endswith("the weights vgg.pth are not on this machine.")
    network.parent.mkdir(parents=True)
    network.touch()
    measure = lpips.find_lpips().measure
    assert measure is not None
    assert measure(np.zeros((4, 5, 3)), np.full((4, 5, 3), 0.25)) == 0.25


def test_runs_of_other_data_are_refused(folder):
    run = find_runs(folder)[0]
    with pytest.raises(InputError, match="was measured at 16 x 16, 32 x 32"):
        Views(tiny.pyramid(1), 1).check(run)
    pyramid = pyramid_of(tiny.dataset(n_views=10), 2)
    with pytest.raises(InputError, match="was trained on 11 views, measured on 1"):
        Views(pyramid, 1).check(run)


def test_a_broken_result_is_named(folder, tmp_path):
    shutil.copytree(folder / "equal-evogs-0", tmp_path / "equal-evogs-0")
    (tmp_path / "equal-evogs-0" / "result.json").write_text('{"levels": []}')
    with pytest.raises(InputError, match="is no result of a run"):
        find_runs(tmp_path)


def test_views_of_a_cut_are_spread_evenly():
    views = Views((tiny.dataset(),), 3)
    assert [v.name for v in views.held_out(0, 3)] == ["v0"]  # fewer are held out
    everything = Views((replace(tiny.dataset(), test=()),), 3)
    assert [v.name for v in everything.held_out(0, 3)] == ["v1", "v6", "v11"]


def test_a_pivot_has_a_column_for_every_level_and_value():
    rows = [{"method": "a", "level": k, "dB": 10.0 + k} for k in (0, 1)]
    rows.append({"method": "b", "level": 1, "dB": 5.0})
    assert pivot(rows, "level", ["dB"]) == [
        {"method": "a", "L0 dB": 10.0, "L1 dB": 11.0},
        {"method": "b", "L0 dB": None, "L1 dB": 5.0},
    ]


def test_the_summary_of_a_curve():
    names = {"budget": "equal", "coding": "raw"}
    up = [names | {"stream": "up", "bytes": b, "PSNR, dB": q} for b, q in ((0, 10.0), (100, 20.0))]
    down = [
        names | {"stream": "down", "bytes": b, "PSNR, dB": q}
        for b, q in ((0, 10.0), (25, 14.0), (50, 12.0))
    ]
    first, second = streaming.summary(up + down)
    assert first["mean over bytes, dB"] == pytest.approx(15.0)
    assert first["cuts that do not fall, %"] == 100
    assert (second["largest jump, dB"], second["deepest fall, dB"]) == (4.0, 2.0)
    # 12 and 13 over a quarter each, then 12 to the end of the longest.
    assert second["mean over bytes, dB"] == pytest.approx((12 + 13 + 12 + 12) / 4, abs=0.01)


def parsed(*flags):
    return cli.parse([str(flag) for flag in flags])


def test_the_command_says_what_changes_its_numbers(tmp_path):
    args = parsed("--data", tmp_path, "--out", "x", "--size", 64, "--seeds", 0, "--no-train")
    assert (
        command_again(cli.COMMAND, args, cli.DEFAULTS)
        == f"python -m tools.bench.paper --data {tmp_path.name} --out OUT --size 64 --seeds 0"
    )


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "find_spec", lambda name: None if name == "matplotlib" else name)
    with pytest.raises(InputError, match=r"needs matplotlib: pip install -e '\.\[train,bench\]'"):
        cli.run_paper(parsed("--data", tmp_path, "--out", tmp_path))


def test_the_command_trains_what_is_missing_and_reports(tmp_path, monkeypatch, capsys):
    from tools import photos

    photos.main([str(tmp_path / "photos"), "--views", "9", "--size", "32", "--splats", "200"])
    flags = ["--data", tmp_path / "photos", "--out", tmp_path / "out", "--size", 32]
    flags += ["--preset", "quick", "--levels", 2, "--iterations", 10, "--max-splats", 20, 40]
    flags += ["--methods", "evogs", "--seeds", 0, "--budgets", "equal"]
    cli.run_paper(parsed(*flags, "--no-train"))
    assert "0 of 1 runs" in capsys.readouterr().out
    report = tmp_path / "docs" / "other.md"
    cli.run_paper(parsed(*flags, "--report", report))
    assert "1 of 1 runs" in capsys.readouterr().out
    assert (report.parent / "other" / "claims.csv").is_file()
    with pytest.raises(InputError, match="is of another configuration"):
        cli.run_paper(parsed(*flags, "--iterations", 11))


def test_samples_are_pictures_of_the_runs(folder):
    bench = Bench(find_runs(folder), Views(tiny.pyramid(), 1), folder, lambda _: None)
    section = paper._samples(bench)
    assert [figure.name for figure in section.figures] == ["samples-equal"]


@pytest.mark.parametrize(
    "text", ["{", "[]", "3", "null", "[" * 100_000, '{"config": 3}', '{"config": {"method": "x"}}']
)
def test_a_damaged_result_is_refused(tmp_path, text):
    path = tmp_path / "equal-evogs-0" / "result.json"
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(InputError, match=r"result\.json: ") as caught:
        find_runs(tmp_path)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("text", ["{", "[]", "[" * 100_000, "{}"])
def test_a_damaged_measurement_is_refused_or_made_again(folder, tmp_path, text):
    run = find_runs(folder)[0]
    path = tmp_path / f"{run.folder.name}.answer.json"
    path.write_text(text)
    bench = Bench([run], Views(tiny.pyramid(), 1), tmp_path, lambda _: None)
    if text in ("[]", "{}"):
        assert bench.measure(run, "answer", lambda _: 42) == 42
        return
    with pytest.raises(InputError, match=r"answer\.json: "):
        bench.measure(run, "answer", lambda _: 42)
