"""What `evogs info` says of what a stream leaves out."""

import json

import pytest

from conformance.generator.builder import SPLIT, Packet, Stream, X, build
from evogs_codec import PRESETS, Cut, EvolutionTree, encode, extract, lift, read_directory
from evogs_codec.cli.commands import main
from evogs_codec.editing.omissions import CUT_OFF, NOTHING, UNUSED, omissions
from evogs_codec.render.demo_scene import make_scene


@pytest.fixture(scope="module")
def stream():
    return encode(lift(make_scene(400), 3), PRESETS["scene"])


def found(data):
    view = memoryview(data)
    return omissions(read_directory(view), view)


def cut_off(data):
    return {row.part: row for row in found(data) if row.reason == CUT_OFF}


def test_nothing_is_cut_off_from_a_whole_stream(stream):
    assert not cut_off(stream)


def test_a_level_that_was_cut_off_leaves_the_error_of_the_one_before(stream):
    directory = read_directory(stream)
    cut = Cut.of_level(directory, 1)
    position = cut_off(extract(stream, cut))["position"]
    hints = directory.packets["error"][directory.packets["component"] == 0]
    last = int(cut.steps[0, 0]) - 1
    assert position.change == pytest.approx(hints[last] * 2.0 ** -directory.grid_exponents[0])


def test_an_sh_band_that_was_cut_off_wholly_leaves_no_trace_of_its_error(stream):
    full = Cut.full(read_directory(stream))
    rows = cut_off(extract(stream, full.with_sh_degree(1)))
    assert set(rows) == {"sh 2", "sh 3"}
    assert rows["sh 3"].levels == (0, 1, 2)
    assert rows["sh 3"].change is None


def test_an_sh_band_of_coarse_levels_says_what_the_others_would_change(stream):
    directory = read_directory(stream)
    steps = Cut.full(directory).steps.copy()
    steps[:, 3] = Cut.of_level(directory, 1).steps[:, 3]
    rows = cut_off(extract(stream, Cut(steps)))
    assert set(rows) == {"sh 3"}
    assert rows["sh 3"].levels == (2,)
    assert 0 < rows["sh 3"].change < 1


def test_what_no_record_changes_is_not_stored():
    tree = lift(make_scene(200), 2)
    psi = [step.psi.copy() for step in tree.steps]
    for values in psi:
        values[10] = 0
    still = EvolutionTree(
        tree.sh_degree,
        tuple(
            type(step)(step.level, step.slots, step.kinds, values, step.alpha, step.adds)
            for step, values in zip(tree.steps, psi, strict=True)
        ),
    )
    rows = [row for row in found(encode(still, PRESETS["scene"])) if row.reason == NOTHING]
    assert ("opacity", (1,), 0.0) in [(row.part, row.levels, row.change) for row in rows]


def test_a_stream_without_refinements_leaves_nothing_out():
    splats = make_scene(100)
    assert found(encode(EvolutionTree.of_splats(splats), PRESETS["scene"])) == []


def test_info_prints_it(stream, tmp_path, capsys):
    full = Cut.full(read_directory(stream))
    path = tmp_path / "cut.evogs"
    path.write_bytes(extract(stream, full.with_sh_degree(2)))
    assert main(["info", str(path)]) == 0
    assert "unknown  cut off" in capsys.readouterr().out
    assert main(["info", str(path), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["left_out"]
    assert {"part": "sh 3", "reason": "cut off", "levels": [0, 1, 2], "change": None} in rows


def test_entries_of_alpha_tables_that_no_split_names_are_counted():
    roots = Packet(n_adds=4, adds={X: [0, 1, 2, 3]})
    split = Packet(
        level=1, records=dict.fromkeys(range(4), SPLIT), psi={X: [1] * 4}, alpha={2: [0, 4, 4, 0]}
    )
    tables = {(1, 2): (3, range(1, 9)), (1, 3): (0, [2])}
    data = build(Stream([roots, split], n_levels=2, alphas=tables))
    rows = [row for row in found(data) if row.reason.endswith(UNUSED)]
    assert [(row.part, row.levels, row.change) for row in rows] == [("alpha of scale", (1,), 0.0)]
    assert rows[0].reason == f"6 of 8 {UNUSED}"
