"""Bytes of each class of numbers, those of which nothing is stored included."""

import json

import numpy as np
import pytest

from conformance.generator.builder import REFINE, SPLIT, Packet, Stream, X, build
from evogs_codec import PRESETS, EvolutionTree, encode, lift, read_directory
from evogs_codec.cli.commands import main
from evogs_codec.editing.byte_stats import ALPHA_NAMES, bytes_by_group
from evogs_codec.editing.omissions import ALL_ONE, omissions
from evogs_codec.model.channels import CLASS_NAMES
from evogs_codec.model.tree import Step
from evogs_codec.render.demo_scene import make_scene

OF_SCALE, OF_OPACITY = 2, 3
N = 64


def tree(alpha_of=(), degree=1):
    """N roots, all of which split; alphas of some groups differ, those of others are 1."""
    rng = np.random.default_rng(3)
    d = 11 + 3 * (degree + 1) ** 2
    alpha = np.ones((5, N))
    for group in alpha_of:
        alpha[group] = rng.integers(0, 8, N) / 8
    roots = Step.of_adds(0, rng.normal(size=(d, N)).astype(np.float32))
    psi = rng.normal(size=(d, N)).astype(np.float32)
    return EvolutionTree(degree, (roots, Step.of_splits(1, np.arange(N), psi, alpha)))


def parts_of(data):
    return bytes_by_group(read_directory(data), memoryview(data))


def empty(data):
    return {name for name, part in parts_of(data).items() if part.n_bytes == 0}


def test_every_class_is_named_and_all_add_up_to_the_file():
    for splats in (tree(), tree((OF_SCALE, OF_OPACITY)), lift(make_scene(200), 3)):
        data = encode(splats, PRESETS["near-lossless"])
        parts = parts_of(data)
        assert set(parts) >= {*ALPHA_NAMES, *CLASS_NAMES, "slots", "kinds", "picks"}
        assert sum(part.n_bytes for part in parts.values()) == pytest.approx(len(data))


def test_alphas_that_are_not_learned_take_0_bytes_and_the_others_some():
    data = encode(tree((OF_SCALE, OF_OPACITY)), PRESETS["near-lossless"])
    assert empty(data) & set(ALPHA_NAMES) == {
        "alpha of position",
        "alpha of rotation",
        "alpha of sh",
    }
    assert set(ALPHA_NAMES) <= empty(encode(tree(), PRESETS["near-lossless"]))


@pytest.mark.thorough
def test_bands_that_are_not_there_take_0_bytes():
    for degree in range(4):
        data = encode(tree(degree=degree), PRESETS["near-lossless"])
        without = {f"sh {band}" for band in range(degree + 1, 4)}
        assert empty(data) & set(CLASS_NAMES) == without


def test_kinds_take_0_bytes_where_all_records_of_a_packet_are_of_one_kind():
    roots = Packet(n_adds=2, adds={X: [0, 1]})
    split = Packet(level=1, records={0: SPLIT, 1: SPLIT}, psi={X: [1, 1]})
    mixed = Packet(level=1, records={0: SPLIT, 1: REFINE}, psi={X: [1, 1]})
    assert "kinds" in empty(build(Stream([roots, split], n_levels=2)))
    assert "kinds" not in empty(build(Stream([roots, mixed], n_levels=2)))


def test_what_is_left_out_says_which_alphas_are_1_everywhere():
    def ones(data):
        view = memoryview(data)
        found = omissions(read_directory(view), view)
        return {(row.part, row.levels) for row in found if row.reason == ALL_ONE}

    names = {(name, (1,)) for name in ALPHA_NAMES}
    learned = {("alpha of scale", (1,)), ("alpha of opacity", (1,))}
    assert ones(encode(tree(), PRESETS["near-lossless"])) == names
    mixed = tree((OF_SCALE, OF_OPACITY))
    assert ones(encode(mixed, PRESETS["near-lossless"])) == names - learned
    roots = EvolutionTree.of_splats(make_scene(20))
    assert ones(encode(roots, PRESETS["scene"])) == set()


def test_info_prints_0_for_what_the_stream_does_not_use(tmp_path, capsys):
    path = tmp_path / "x.evogs"
    path.write_bytes(encode(tree((OF_SCALE,)), PRESETS["near-lossless"]))
    assert main(["info", str(path)]) == 0
    printed = {line[:17].strip(): line[17:].split() for line in capsys.readouterr().out.split("\n")}
    for name in ("kinds", "alpha of position", "alpha of opacity", "sh 2", "sh 3", "picks"):
        assert printed[name] == ["0", "0.000", "0.0", "%"]
    assert int(printed["alpha of scale"][0]) > 0
    assert main(["info", str(path), "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert groups["alpha of rotation"] == {"n_bytes": 0, "entropy": 0}
    assert groups["alpha of scale"]["n_bytes"] > 0
