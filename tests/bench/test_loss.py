"""`python -m tools.bench --only loss`: prefixes of streams beside dedicated streams."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import PRESETS, decode_leaves, lift, read_directory
from evogs_codec.encoding import guess, search
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.targets import TargetEncoder

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tools.bench import loss, plots, prefix, subjects

pytestmark = pytest.mark.thorough


def small(settings: str = "scene") -> subjects.Subject:
    splats = make_scene(300)
    views = Views(splats, cameras_around(splats, "z", 32)[::8])
    return subjects.Subject.of_tree("small", lift(splats, 3), PRESETS[settings], views)


@pytest.fixture(scope="module")
def subject() -> subjects.Subject:
    return small()


@pytest.fixture(scope="module")
def losses(subject) -> loss.Losses:
    return loss.Losses(lambda: [subject])


def number(row: dict[str, object], column: str) -> float:
    return float(str(row[column]))


def test_streams_with_layers_have_the_psnr_of_the_preset(losses):
    rows = losses.table()
    assert [str(row["stream"]).split(" --")[-1] for row in rows] == [
        "preset", "default", "layers 1", "layers 2", "layers 3",
    ]  # fmt: skip
    aimed = [row for row in rows if row["stream"] != "default"]
    assert max(abs(number(row, "PSNR, dB") - number(rows[0], "PSNR, dB")) for row in aimed) <= 0.21
    assert number(rows[2], "to one layer") == pytest.approx(1, abs=0.03)
    for row in rows:
        assert number(row, "mean loss, dB") <= number(row, "largest loss, dB")
        assert number(row, "deepest fall, dB") >= 0
        assert 0 < number(row, "largest packet, %") < 100
        assert number(row, "encode, s") > 0


def test_the_loss_is_what_the_dedicated_stream_has_above_the_prefix(losses, subject):
    rows = losses.curves()
    assert [row["curve"] for row in rows] == ["prefix", "dedicated", "loss"] * 5
    own, dedicated, lost = rows[:3]
    assert number(own, "100 %") == number(losses.table()[0], "PSNR, dB")
    assert number(own, "100 %") == pytest.approx(
        subject.views.psnr(decode_leaves(subject.stream)), abs=0.01
    )
    for part in (f"{cut} %" for cut in loss.CUTS):
        assert (lost[part] == "") == (dedicated[part] == "")
        if lost[part]:
            difference = number(dedicated, part) - number(own, part)
            assert number(lost, part) == pytest.approx(difference, abs=0.011)
    assert lost["90 %"]


def test_trained_trees_aim_at_the_default_of_trees(monkeypatch):
    monkeypatch.setattr(loss, "TREE_PSNR", 40.0)
    monkeypatch.setattr(guess, "PSNR_SLACK", 4.0)  # of few splats a search is long
    monkeypatch.setattr(loss, "LAYERS", (1,))
    names = [stream.name for stream in loss._streams(small("trained"))]
    assert names == ["preset", "default", "--target-psnr 40 --layers 1"]


def test_a_stream_that_misses_its_target_is_left_out(monkeypatch, capsys):
    monkeypatch.setattr(loss, "TREE_PSNR", 1000.0)
    monkeypatch.setattr(loss, "LAYERS", (2,))
    monkeypatch.setattr(search, "MAX_TRIES", 2)
    names = [stream.name for stream in loss._streams(small("trained"))]
    assert names == ["preset", "default"]
    assert "left out: 1000 dB cannot be met" in capsys.readouterr().err


def test_streams_at_prices_are_worth_more_the_lower_the_price(subject):
    aim = TargetEncoder(subject.tree, subject.settings, subject.views)
    sizes, worth = zip(*((len(s), aim.psnr(s)) for s in aim.at_prices([1e-7, 1e-9])), strict=True)
    assert sizes[0] < sizes[1]
    assert worth[0] < worth[1]
    with pytest.raises(ValueError, match="views"):
        next(replace(aim, views=None).at_prices([1e-9]))


def test_dedicated_streams_are_interpolated_and_not_beyond_their_ends():
    curve = loss._OneLayer(np.array([10.0, 20, 40]), np.array([20.0, 30, 40]))
    assert curve.decibels(20) == 30
    assert 20 < curve.decibels(15) < 30
    assert curve.n_bytes(40) == pytest.approx(40)
    assert np.isnan(curve.decibels(9))
    assert np.isnan(curve.n_bytes(41))
    assert loss._cell(curve.decibels(9)) == ""


def test_prices_are_half_a_decade_apart():
    prices = list(loss._prices())
    assert np.allclose(np.divide(prices[2:], prices[:-2]), 0.1)
    assert prices[0] == max(prices) == max(PRICES)


def test_prefixes_end_with_packets(subject):
    data = subject.stream
    found = loss._Prefixes(data, subject.tree.sh_degree)
    assert found.ends[-1] == len(data)
    assert np.all(np.diff(found.ends) == found.sizes[1:])
    assert [found.n_packets(n) for n in (0, found.ends[0] - 1, found.ends[0], len(data))] == [
        0, 0, 1, len(read_directory(data).packets),
    ]  # fmt: skip
    assert prefix.ends_of_packets(data, found.sizes)[0] == found.ends[0]
    worth = found.worth([0, 1, len(found.ends)], subject.views)
    assert worth[0] < worth[2]


def test_the_scene_of_degree_0_has_other_splats_than_the_shipped_one():
    scene = loss.scene_without_bands(50).views.scene
    assert scene.sh_degree == 0
    assert not np.array_equal(scene.means, make_scene(50).means)


def test_prefixes_and_dedicated_streams_are_drawn(losses):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    rows = losses.curves()
    (axis,) = plots.PLOTS["loss-curves"](rows).axes
    assert len(axis.lines) == 6
    assert axis.get_legend().get_texts()[0].get_text() == "dedicated"


def test_files_of_other_formats_stand_beside(subject, tmp_path):
    pytest.importorskip("gsply", reason="gsply is not installed")
    rows = loss.Losses(lambda: [subject], tmp_path).curves()
    prefixes = {str(row["stream"]): row for row in rows if row["curve"] == "prefix"}
    spz, every = prefixes["SPZ 4"], prefixes["streamed SOG, every level"]
    nothing = subject.views.psnr(subject.views.scene.take(np.arange(0)))
    assert number(spz, "95 %") == pytest.approx(nothing, abs=0.01)
    assert number(spz, "100 %") > 40
    assert nothing < number(every, "95 %") <= number(every, "100 %")
