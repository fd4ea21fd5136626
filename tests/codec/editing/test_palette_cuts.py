"""Parts of streams with a palette: cuts, pieces that come in any order, extraction, figures."""

import json
import random
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from conformance.decoders import oracle
from evogs_codec import (
    Cut,
    Decoder,
    StreamError,
    choose_cut,
    decode,
    extract,
    read_directory,
    read_ply,
)
from evogs_codec.cli.commands import main
from evogs_codec.editing.byte_stats import bytes_by_group, levels
from evogs_codec.editing.omissions import omissions
from evogs_codec.model.components import PALETTE, PICKS
from tests.support.palette_streams import (
    DATA,
    DEGREE,
    DIRECTORY,
    PACKETS,
    each_required,
    each_stream,
    oracle_dump,
    random_cut,
    stream,
)
from tools.bench.prefix import by_level

# --- cuts ----------------------------------------------------------------------------------------


def test_directories_tell_the_palette_from_tiles():
    assert DIRECTORY.has_palette
    assert (DIRECTORY.components.numbers, DIRECTORY.n_entries) == ((0, 4, 5), 7)
    assert DIRECTORY.palette_packets.tolist() == [2, 4, 9, 16]
    assert DIRECTORY.chain_lengths.tolist() == [[3, 2], [3, 3], [3, 3]]


def test_directories_say_what_packets_require_of_the_palette():
    assert [(n, DIRECTORY.entries_required[n]) for n in (5, 10, 17, 18, 19, 20)] == [
        *((5, 4), (10, 6), (17, 7)),
        *((18, 4), (19, 6), (20, 7)),
    ]
    for data in each_stream():
        directory = read_directory(data)
        required = [n for _, n in each_required(directory)]
        assert directory.palette_required.tolist() == required
        n_entries = directory.packets["n_adds"][directory.palette_packets].tolist()
        assert directory.entries_required.tolist() == [sum(n_entries[:n]) for n in required]


def test_cuts_take_the_palette_where_picks_need_it():
    full = Cut.full(DIRECTORY)
    assert full.palette == 4
    prefixes = [Cut.of_rows(DIRECTORY, np.arange(n)).palette for n in (2, 3, 4, 5, 9, 10, 17)]
    assert prefixes == [0, 1, 1, 2, 2, 3, 4]
    assert [Cut.of_level(DIRECTORY, level).palette for level in range(3)] == [2, 3, 4]
    plain = full.with_sh_degree(0)
    assert (plain.palette, plain.steps.tolist()) == (0, [[3, 0]] * 3)
    assert all(full.with_sh_degree(degree).contains(full) for degree in (1, 2))
    near = full.with_box(DIRECTORY, (80, 0, 60, 100, 1, 80))
    assert (near.palette, near.steps.tolist()) == (4, [[0, 0], [0, 0], [3, 3]])
    assert full.with_box(DIRECTORY, (900, 0, 0, 901, 1, 1)).palette == 0


@pytest.mark.parametrize(("late", "n_palette", "n_picks"), [(4, 1, 0), (9, 2, 1), (16, 3, 2)])
def test_picks_are_not_there_before_the_entries_that_they_require(late, n_palette, n_picks):
    complete = np.ones(len(PACKETS), bool)
    complete[late] = False
    cut = Cut.of_complete(DIRECTORY, complete)
    assert (cut.palette, cut.steps.tolist()) == (n_palette, [[3, n_picks]] * 3)
    assert not cut.contains(Cut.full(DIRECTORY))
    assert cut.intersection(Cut.full(DIRECTORY)).steps.tolist() == cut.steps.tolist()
    assert decode(DATA, cut).dump() == oracle_dump(DATA, cut)


@pytest.mark.parametrize("n_picks", [0, 1, 2, 3])
def test_a_cut_with_less_of_the_palette_than_picks_require_is_a_mistake_of_the_caller(n_picks):
    steps = np.minimum(DIRECTORY.chain_lengths, [[3, 0], [3, n_picks], [3, 0]])
    least = (0, 2, 3, 4)[n_picks]
    for palette in range(6):
        cut = Cut(steps, palette)
        if least <= palette <= 4:
            assert decode(DATA, cut).dump() == oracle_dump(DATA, cut)
        else:
            with pytest.raises(ValueError, match=r"palette|not in the file"):
                decode(DATA, cut)
    with pytest.raises(ValueError, match="steps of a palette"):
        Cut(steps, -1)


# --- pieces --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(2, 8))]
)
def test_pieces_in_any_order_give_what_the_whole_file_gives(seed):
    rng = random.Random(seed)
    for data in each_stream():
        decoder = Decoder()
        cuts = [0, *sorted(rng.randrange(len(data)) for _ in range(9)), len(data)]
        pieces = list(pairwise(cuts))
        rng.shuffle(pieces)
        arrived = []
        for begin, end in pieces:
            decoder.feed(data[begin:end], begin)
            arrived.append((begin, end - begin))
            if decoder.directory is not None and data is DATA:
                assert decoder.dump() == oracle.decode_pieces(data, arrived).dump()
        decoder.close()
        assert decoder.dump() == oracle.decode(data).dump()
        assert decoder.cut.contains(Cut.full(read_directory(data)))


@pytest.mark.parametrize(
    ("late", "n_palette", "n_picks"), [(2, 4, 0), (4, 3, 0), (9, 2, 3), (16, 1, 6)]
)
def test_picks_wait_for_the_entries_that_they_require_also_those_of_no_bytes(
    late, n_palette, n_picks
):
    begin = int(DIRECTORY.offsets[late])
    end = begin + int(DIRECTORY.packets["size"][late])
    decoder = Decoder()
    decoder.feed(DATA[: DIRECTORY.data_offset])
    ready = decoder.feed(DATA[:begin], 0) + decoder.feed(DATA[end:], end)
    assert sum(step.component == PICKS for step in ready) == n_picks
    assert decoder.dump() == oracle_dump(DATA, decoder.cut)
    with_palette = decoder.feed(DATA[begin:end], begin)
    components = [step.component for step in with_palette]
    assert components == [PALETTE] * n_palette + [PICKS] * (8 - n_picks)
    of_palette = [step.level for step in with_palette if step.component == PALETTE]
    assert of_palette == [0, 0, 1, 2][4 - n_palette :]
    decoder.close()
    assert decoder.dump() == decode(DATA).dump()


def test_a_fault_of_late_entries_keeps_only_the_picks_that_require_them():
    wrong = replace(PACKETS[16], edit=lambda body: bytes([body[0] | 8]) + body[1:])
    data = stream([*PACKETS[:16], wrong, *PACKETS[17:]])
    decoder = Decoder()
    with pytest.raises(StreamError, match="E_RESERVED"):
        decoder.feed(data)
    assert decoder.cut.palette == 3
    assert decoder.cut.steps.tolist() == [[3, 2]] * 3
    assert decoder.dump() == oracle_dump(DATA, decoder.cut)


def test_floats_of_a_stream_that_comes_in_pieces_follow_its_palette():
    decoder = Decoder()
    for at in range(0, len(DATA), 50):
        decoder.feed(DATA[at : at + 50])
        if decoder.directory is not None:
            expected = decode(DATA, decoder.cut).leaves(sh_degree=DEGREE)
            assert (
                decoder.leaves(sh_degree=DEGREE).channels().tobytes()
                == expected.channels().tobytes()
            )


# --- parts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(1, 4))]
)
def test_decoding_an_extracted_stream_is_decoding_the_original_at_the_same_cut(seed):
    rng = np.random.default_rng(seed)
    for data in each_stream():
        directory = read_directory(data)
        for _ in range(4):
            cut = random_cut(rng, directory)
            smaller = extract(data, cut)
            assert decode(smaller, verify=True).dump() == oracle_dump(data, cut)
            assert oracle.decode(smaller).dump() == oracle_dump(data, cut)
    assert extract(DATA, Cut.full(DIRECTORY)) == DATA


def test_a_region_without_tile_0_keeps_the_palette_as_packets_of_tile_0():
    box = (80, 0, 60, 100, 1, 80)
    cut = choose_cut(DIRECTORY, box=box)
    smaller = extract(DATA, cut, box=box)
    found = read_directory(smaller)
    assert len(found.tiles) == 1
    assert (found.n_entries, found.palette_packets.tolist()) == (7, [0, 2, 5, 8])
    assert found.packets["tile"].tolist() == [0] * len(found.packets)
    kept = {(0, PALETTE, 0), (0, PALETTE, 2), (0, PICKS, 0), (0, PICKS, 2)}
    assert set(found.digests) == kept
    assert decode(smaller, verify=True).tiles[0].dump() == decode(DATA).tiles[2].dump()


def test_a_region_without_tiles_has_no_palette_either():
    box = (900, 0, 0, 901, 1, 1)
    smaller = extract(DATA, choose_cut(DIRECTORY, box=box), box=box)
    found = read_directory(smaller)
    assert found.has_palette
    assert (len(found.tiles), len(found.packets)) == (0, 0)
    palette_alone = Cut(0 * DIRECTORY.chain_lengths, 3)
    assert extract(DATA, palette_alone, box=box) == smaller


def test_without_sh_there_is_no_palette_but_the_stream_stays_one():
    smaller = extract(DATA, choose_cut(DIRECTORY, sh_degree=0))
    found = read_directory(smaller)
    assert found.has_palette
    assert (found.n_entries, set(found.packets["component"].tolist())) == (0, {0})
    whole = extract(DATA, choose_cut(DIRECTORY, sh_degree=1))
    assert whole == DATA


def test_a_palette_that_nothing_picks_of_follows_the_levels_all_the_same():
    steps = DIRECTORY.chain_lengths.copy()
    steps[:, 1] = 0
    unpicked = extract(DATA, Cut(steps, 4))
    directory = read_directory(unpicked)
    assert directory.n_entries == 7
    assert extract(unpicked, choose_cut(directory)) == unpicked
    for options in ({"level": 2}, {"sh_degree": 2}, {"box": (-1e9, -1e9, -1e9, 1e9, 1e9, 1e9)}):
        assert extract(unpicked, choose_cut(directory, **options)) == unpicked


@pytest.mark.parametrize(("level", "n_entries"), [(0, 4), (1, 6), (2, 7)])
def test_a_level_has_the_entries_of_its_level_and_below(level, n_entries):
    smaller = extract(DATA, choose_cut(DIRECTORY, level=level))
    assert read_directory(smaller).n_entries == n_entries
    assert decode(smaller, verify=True).dump() == oracle.decode(DATA, level=level).dump()


@pytest.mark.thorough
def test_parts_have_the_entries_of_their_level_whatever_they_pick():
    steps = np.minimum(DIRECTORY.chain_lengths, [[3, 1], [3, 0], [3, 2]])
    few = extract(DATA, Cut(steps, 4))
    directory = read_directory(few)
    for options, box, n_packets in (
        *(({}, None, 4), ({"max_bytes": len(few)}, None, 4), ({"sh_degree": 2}, None, 4)),
        *(({"level": 2}, None, 4), ({"level": 1}, None, 3), ({"level": 0}, None, 2)),
        *(({}, (-1, -1, -1, 1, 1, 1), 4), ({"level": 0}, (80, 0, 60, 100, 1, 80), 2)),
    ):
        cut = choose_cut(directory, box=box, **options)
        assert cut.palette == n_packets
        smaller = extract(few, cut, box=box)
        assert len(read_directory(smaller).palette_packets) == n_packets
        decode(smaller, verify=True)
    for data in each_stream():
        directory = read_directory(data)
        for level in range(directory.n_levels):
            cut = choose_cut(directory, level=level)
            of_level = Cut.of_level(directory, level)
            assert (cut.contains(of_level), of_level.contains(cut)) == (True, True)
            assert decode(data, cut).dump() == oracle.decode(data, level=level).dump()


@pytest.mark.parametrize("options", [{}, {"level": 1}, {"box": (80, 0, 60, 100, 1, 80)}])
def test_a_byte_budget_gives_the_longest_prefix_that_fits(options):
    box = options.get("box")
    order = np.flatnonzero(choose_cut(DIRECTORY, **options).packets(DIRECTORY))
    cuts = [Cut.of_rows(DIRECTORY, order[:n]) for n in range(1, len(order) + 1)]
    sizes = [len(extract(DATA, cut, box=box)) for cut in cuts]
    assert sizes == sorted(set(sizes))
    for cut, size in zip(cuts, sizes, strict=True):
        found = choose_cut(DIRECTORY, max_bytes=size, **options)
        assert (found.contains(cut), cut.contains(found)) == (True, True)


def test_bytes_of_levels_and_of_groups_add_up_to_the_file():
    for data in each_stream():
        directory = read_directory(data)
        groups = bytes_by_group(directory, memoryview(data))
        assert sum(part.n_bytes for part in groups.values()) == pytest.approx(directory.size)
        of_levels = sum(level.n_bytes for level in levels(directory))
        assert of_levels == directory.size - directory.data_offset
    assert {"picks", "sh 1", "sh 2"} <= set(bytes_by_group(DIRECTORY, memoryview(DATA)))


def test_bytes_of_entries_are_those_of_their_level():
    label = [0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 1, 1, 2, 2, 2, 2, 0, 1, 2]
    expected = np.bincount(label, DIRECTORY.packets["size"]).tolist()
    assert [level.n_bytes for level in levels(DIRECTORY)] == expected


def test_every_prefix_of_the_packets_by_level_is_a_cut():
    for data in each_stream():
        directory = read_directory(data)
        order = by_level(directory)
        assert np.all(np.diff(directory.labels[order]) >= 0)
        for n in range(len(order) + 1):
            rows = np.flatnonzero(Cut.of_rows(directory, order[:n]).packets(directory))
            assert rows.tolist() == sorted(order[:n].tolist())


def test_picks_that_were_cut_off_are_left_out_and_nothing_else_above_band_0_is():
    left_out = omissions(DIRECTORY, memoryview(DATA))
    assert [(row.part, row.levels) for row in left_out if row.part == "picks"] == [("picks", (2,))]
    assert not [row for row in left_out if row.part in ("sh 1", "sh 2")]


# --- commands ------------------------------------------------------------------------------------


def test_the_commands_read_streams_with_a_palette(tmp_path, capsys):
    path, smaller, ply = (tmp_path / name for name in ("a.evogs", "b.evogs", "c.ply"))
    path.write_bytes(DATA)
    assert main(["validate", str(path)]) == 0
    assert "18 splats, 7 digests match" in capsys.readouterr().out
    assert main(["info", "--json", str(path)]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["palette_entries"], info["sh_degree"]) == (7, DEGREE)
    assert main(["info", str(path)]) == 0
    assert "palette_entries  7\n" in capsys.readouterr().out
    assert main(["extract", "--sh-degree", "0", str(path), str(smaller)]) == 0
    assert read_directory(smaller.read_bytes()).n_entries == 0
    for options, degree in ((["--sh-degree", "1"], 1), (["--level", "1"], 2), (["--partial"], 2)):
        assert main(["decode", *options, str(path), str(ply)]) == 0
        level = 1 if options[0] == "--level" else 2
        expected = decode(DATA, Cut.of_level(DIRECTORY, level)).leaves(sh_degree=degree)
        assert np.array_equal(read_ply(ply).channels(), expected.channels())
    capsys.readouterr()
    assert main(["decode", "--sh-degree", "0", "--partial", str(path), str(ply)]) == 0
    assert read_ply(ply).sh_degree == 0
