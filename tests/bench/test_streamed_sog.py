"""SOG sets that are written here, and streams of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import SplatParams
from evogs_codec.io.interchange import sog
from evogs_codec.render.demo_scene import make_scene
from tools.bench import sog_set
from tools.bench.sog_set import write_set
from tools.bench.streamed_sog import SogStream

pytest.importorskip("PIL")


@pytest.fixture(scope="module")
def scene() -> SplatParams:
    return make_scene(2000)


def test_a_set_is_read_as_it_was_written(scene, tmp_path):
    n_bytes = write_set(scene, tmp_path / "set")
    assert n_bytes == sum(path.stat().st_size for path in (tmp_path / "set").iterdir())
    read, _ = sog.read(tmp_path / "set")
    assert len(read) == len(scene)
    np.testing.assert_allclose(read.means, scene.means, rtol=2e-4, atol=2e-4)
    lengths = np.linalg.norm(scene.quats, axis=1) * np.linalg.norm(read.quats, axis=1)
    cosines = np.abs((read.quats * scene.quats).sum(axis=1)) / lengths
    assert cosines.min() > 0.9998
    assert np.abs(read.log_scales - scene.log_scales).mean() < 0.02
    opaque = 1 / (1 + np.exp(-scene.opacity_logits))
    assert np.abs(1 / (1 + np.exp(-read.opacity_logits)) - opaque).max() < 0.003
    assert np.sqrt(np.mean((read.sh - scene.sh) ** 2)) < 0.02


@pytest.mark.parametrize("n", [1000, 1023, 1537])
def test_a_palette_has_no_more_entries_than_are_allowed(scene, n):
    vectors = scene.sh[:n, 1:].reshape(n, -1)
    entries, labels = sog_set._palette(vectors)
    assert n // 3 < len(entries) <= 1 << (n.bit_length() - 1)
    assert labels.max() < len(entries)
    near = np.linalg.norm(entries[labels] - vectors, axis=1).mean()
    assert near < 0.6 * np.linalg.norm(vectors, axis=1).mean()


def test_few_different_sh_are_the_palette_itself(scene, tmp_path):
    sh = scene.sh.copy()
    sh[:, 1:] = sh[np.arange(len(sh)) % 50, 1:]
    write_set(replace(scene, sh=sh), tmp_path / "set")
    assert json.loads((tmp_path / "set" / "meta.json").read_text())["shN"]["count"] <= 50


@pytest.fixture(scope="module")
def levels(scene) -> list[SplatParams]:
    return [scene.take(slice(0, None, 16)), scene.take(slice(0, None, 4)), scene]


def test_every_splat_of_every_level_is_in_one_set_and_one_box(levels, tmp_path):
    stream = SogStream.of(levels, 300, tmp_path)
    assert len(stream.boxes) == 8
    for level, splats in enumerate(levels):
        sets = [one for one in stream.sets if one.level == level]
        assert sum(len(one.splats) for one in sets) == len(splats)
        assert all(len(one.splats) <= 300 for one in sets)
    meta = json.loads(stream.manifest)
    assert meta["counts"] == [len(splats) for splats in reversed(levels)]
    assert len(meta["filenames"]) == len(stream.sets)
    counts = dict.fromkeys(range(len(stream.sets)), 0)
    for leaf in _leaves(meta["tree"]):
        for lod, part in leaf["lods"].items():
            one = stream.sets[part["file"]]
            assert one.level == len(levels) - 1 - int(lod)
            assert part["offset"] + part["count"] <= len(one.splats)
            counts[part["file"]] += part["count"]
    assert [counts[k] for k in range(len(counts))] == [len(one.splats) for one in stream.sets]


def _leaves(node):
    if "lods" in node:
        yield node
    for child in node.get("children", ()):
        yield from _leaves(child)


def test_a_box_shows_the_finest_level_that_is_there(levels, tmp_path):
    stream = SogStream.of(levels, 300, tmp_path)
    every = range(len(stream.sets))
    coarse = [i for i in every if stream.sets[i].level == 0]
    assert len(stream.shown(coarse)) == len(levels[0])
    assert len(stream.shown(every)) == len(levels[-1])
    fine = next(i for i in every if stream.sets[i].level == 2)
    here = [*coarse, fine]
    cells = stream.cells_of[fine]
    others = sum(int((~np.isin(stream.sets[i].cells, cells)).sum()) for i in coarse)
    assert len(stream.shown(here)) == len(stream.sets[fine].splats) + others
