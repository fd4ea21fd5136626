"""The promises of the README on a real scene of half a million splats, through the command line."""

import json

import numpy as np
import pytest

from evogs_codec import Cut, choose_cut, decode, extract, lift, read_directory, read_ply
from evogs_codec.cli.commands import main
from evogs_codec.editing.byte_stats import bytes_by_group
from tools.bench.measure import errors, leaves_in_stream_order

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene(shared):
    return shared / "data" / "playbot" / "playbot.ply"


@pytest.fixture(scope="module")
def stream(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("playbot") / "playbot.evogs"
    assert main(["encode", str(scene), str(path), "--preset", "scene"]) == 0
    return path


@pytest.fixture(scope="module")
def data(stream):
    return stream.read_bytes()


def test_all_levels_take_fewer_bytes_than_spz_takes_for_one(data):
    directory = read_directory(data)
    groups = bytes_by_group(directory, memoryview(data))
    without_sh = len(data) - sum(groups[f"sh {band}"].n_bytes for band in (1, 2))
    assert directory.n_levels >= 4
    assert len(data) / 500_000 <= 19.0
    assert without_sh / 500_000 <= 14.3


def test_errors_are_no_larger_than_those_of_spz(data, scene):
    original = leaves_in_stream_order(lift(read_ply(scene), 5))
    found = errors(decode(data, verify=True).leaves(), original)
    assert found["position max"] <= 1.2e-4
    assert found["quaternion max"] <= 0.0015
    assert found["log-scale rms"] <= 0.018
    assert found["SH 1+ rms"] <= 0.034


def test_the_first_scene_comes_from_a_twentieth_of_the_bytes(data):
    directory = read_directory(data)
    first = int(directory.offsets[len(directory.tiles)])
    roots = Cut.of_rows(directory, np.arange(len(directory.tiles)))
    decoder_sees = decode(extract(data, roots))
    assert first <= 0.05 * len(data)
    assert all(tile.n_slots for tile in decoder_sees.tiles)


def test_the_commands_work_on_it(stream, tmp_path, capsys):
    capsys.readouterr()
    assert main(["info", str(stream), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["levels"][-1]["n_leaves"] == 500_000
    assert main(["validate", str(stream)]) == 0
    for level in range(5):
        out = tmp_path / f"{level}.evogs"
        assert main(["extract", str(stream), str(out), "--level", str(level)]) == 0
        assert main(["validate", str(out)]) == 0
    assert main(["decode", str(stream), str(tmp_path / "0.ply"), "--level", "0"]) == 0


def cuts(directory, size):
    """Named cuts as the command line makes them, then random ones; with the box, if any."""
    rng = np.random.default_rng(5)
    for level in range(directory.n_levels):
        yield choose_cut(directory, level=level), None
    for part in np.linspace(0.05, 1.0, 10):
        yield choose_cut(directory, max_bytes=int(part * size)), None
    for degree in range(directory.sh_degree + 1):
        yield choose_cut(directory, sh_degree=degree), None
    for _ in range(5):
        corners = rng.uniform(-1, 1, (2, 3))
        box = tuple(np.concatenate([corners.min(0), corners.max(0)]))
        yield choose_cut(directory, box=box), box
    full = Cut.full(directory)
    for _ in range(200):
        steps = rng.integers(0, full.steps + 1)
        yield Cut(np.minimum(steps, steps[:, :1]), full.palette), None


def test_an_extracted_stream_decodes_to_the_integers_of_the_cut(data):
    directory = read_directory(data)
    for cut, box in cuts(directory, len(data)):
        smaller = decode(extract(data, cut, box=box), verify=True)
        expected = decode(data, cut)
        kept = [tile for tile in expected.tiles if box is None or tile.n_slots]
        found = [tile for tile in smaller.tiles if box is None or tile.n_slots]
        assert len(kept) == len(found)
        for a, b in zip(kept, found, strict=True):
            assert np.array_equal(a.live[: a.n_slots], b.live[: b.n_slots])
            assert np.array_equal(a.channels(), b.channels())
