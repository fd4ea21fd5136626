"""The text of the spec: its pseudo-code runs, its references hold, its tables are in sync."""

import csv
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import given

from conformance.decoders import oracle
from conformance.decoders.cleanroom import decoder as cleanroom
from conformance.generator.builder import DROP, RED, REFINE, SPLIT, Packet, Stream, Tile, X, build
from conformance.generator.random_streams import random_stream
from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.settings import PRESETS
from evogs_codec.encoding.write import write
from evogs_codec.errors import Fault
from evogs_codec.model import arithmetic
from tests.support.coded_strategies import coded_trees
from tests.support.examples import examples
from tests.support.pseudo_code import ROOT, TEXT, decode_with_pseudo_code, pseudo_code
from tests.support.sibling_streams import with_siblings
from tests.support.strategies import trees

REQUIREMENT = re.compile(r"^(?:- )?(R-(\d+(?:\.\d+)?)-\d+) \[[a-z]+\] .*$", re.MULTILINE)
ANY_ID = re.compile(r"\bR-\d+(?:\.\d+)?-\d+\b")
FAULT = re.compile(r"\bE_[A-Z]+\b")
MOVED = {"R-5.1-9": "12.2", "R-5.6-10": "12.3", "R-7.2-4": "12.4"}  # to the section of palettes


def faults_csv() -> list[dict[str, str]]:
    with (ROOT / "spec" / "faults.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def headings() -> list[tuple[int, str]]:
    """(place in the text, number) of every numbered heading."""
    found = re.finditer(r"^#{2,3} (\d+(?:\.\d+)?)\.? ", TEXT, re.MULTILINE)
    return [(match.start(), match.group(1)) for match in found]


# --- requirements ---------------------------------------------------------------------------------


def test_there_are_requirements_and_each_id_is_used_once():
    ids = [match.group(1) for match in REQUIREMENT.finditer(TEXT)]
    assert len(ids) > 80
    assert len(ids) == len(set(ids))


def test_each_requirement_stands_in_its_section():
    for match in REQUIREMENT.finditer(TEXT):
        section = [number for place, number in headings() if place < match.start()][-1]
        assert MOVED.get(match.group(1), match.group(2)) == section


def test_the_contents_are_the_headings_of_the_text():
    contents, _, rest = TEXT.partition("<!-- end contents -->")
    listed = re.findall(r"^ *- \[(.*)\]\(#(.*)\)$", contents, re.MULTILINE)
    titles = re.findall(r"^#{2,3} (.*)$", rest, re.MULTILINE)
    assert [title for title, _ in listed] == titles
    for title, anchor in listed:
        assert anchor == re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def test_every_id_at_the_start_of_a_line_is_a_requirement_with_a_role():
    starts = re.findall(r"^(?:- )?(R-\d+(?:\.\d+)?-\d+)(.*)$", TEXT, re.MULTILINE)
    assert starts
    for identifier, rest in starts:
        assert re.match(r" \[(stream|decoder|encoder)\] [A-Z`|\u2212]", rest), identifier


def test_each_requirement_is_one_sentence():
    for identifier, rest in re.findall(r"^(?:- )?(R-[\d.]+-\d+) (.*)$", TEXT, re.MULTILINE):
        sentence = re.sub(r" \(E_[^)]*\)$", "", rest)
        assert sentence.endswith("."), identifier
        assert not re.search(r"[.!?] +[A-Z]", sentence), identifier


def test_requirements_on_streams_name_their_fault_and_it_exists():
    known = {row["code"] for row in faults_csv()}
    for identifier, rest in re.findall(r"^- (R-[\d.]+-\d+) \[stream\] (.*)$", TEXT, re.MULTILINE):
        codes = FAULT.findall(rest)
        assert codes, identifier
        assert set(codes) <= known, identifier


def test_every_cited_id_is_a_requirement():
    stated = set(re.findall(r"^(?:- )?(R-[\d.]+-\d+) \[", TEXT, re.MULTILINE))
    sources = list((ROOT / "evogs_codec").rglob("*.py"))
    sources += [ROOT / "conformance" / "decoders" / "oracle.py", *(ROOT / "tests").rglob("*.py")]
    for path in sources:
        text = path.read_text(encoding="utf-8")
        assert set(ANY_ID.findall(text)) <= stated, path.name
    assert set(ANY_ID.findall(TEXT)) <= stated


def test_every_section_that_code_cites_is_a_heading():
    numbers = {number for _, number in headings()}
    sources = [
        *(ROOT / "evogs_codec").glob("**/*.py"),
        ROOT / "conformance" / "decoders" / "oracle.py",
    ]
    for path in sources:
        cited = re.findall(r"\bspec (\d+(?:\.\d+)?)\b", path.read_text(encoding="utf-8"))
        assert set(cited) <= numbers, path.name


# --- faults and tables ----------------------------------------------------------------------------


def test_every_fault_has_a_section_and_every_code_in_the_text_is_a_fault():
    numbers = {number for _, number in headings()}
    known = {row["code"] for row in faults_csv()}
    assert {row["section"] for row in faults_csv()} <= numbers
    assert set(FAULT.findall(TEXT)) <= known
    assert {fault.name for fault in Fault} == known
    assert {f"E_{code}" for code in oracle.CODES.split()} == known


def test_the_decoder_in_typescript_names_the_faults_and_their_sections():
    source = (ROOT / "tools" / "web" / "evogs" / "src" / "faults.ts").read_text(encoding="utf-8")
    stated = {row["code"]: row["section"] for row in faults_csv()}
    assert dict(re.findall(r'^  (E_[A-Z]+): "([\d.]+)",$', source, re.MULTILINE)) == stated


def test_every_fault_is_the_fault_of_a_requirement_or_check():
    outside_the_table = re.sub(r"<!-- table faults -->.*?<!-- end faults -->", "", TEXT, flags=re.S)
    assert {row["code"] for row in faults_csv()} <= set(FAULT.findall(outside_the_table))


def test_the_tables_are_those_of_the_declarations_and_the_csv_files():
    command = [sys.executable, "-m", "tools.spec_tables", "--check"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def limits_csv():
    """(tier 1, 2, 3) by name."""
    with (ROOT / "spec" / "limits.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {r["name"]: tuple(int(r[f"tier_{k}"]) for k in (1, 2, 3)) for r in rows}


@pytest.mark.parametrize("decoder", [oracle, cleanroom])
def test_the_limits_of_the_other_decoders_are_those_of_the_csv_file(decoder):
    assert limits_csv() == decoder.LIMITS


def test_the_limits_of_the_decoder_for_browsers_are_those_of_the_csv_file():
    source = (ROOT / "tools" / "web" / "evogs" / "src" / "limits.ts").read_text(encoding="utf-8")
    rows = re.findall(r"^  (\w+): \[(\d+), (\d+), (\d+)\],$", source, re.MULTILINE)
    assert {name: tuple(map(int, limits)) for name, *limits in rows} == limits_csv()


# --- RoundShift -----------------------------------------------------------------------------------


def test_the_examples_of_round_shift_hold():
    section = TEXT[TEXT.index("RoundShift(v, n) = v") : TEXT.index("Ties go toward")]
    number = r"([\u2212\d]+)"
    examples = re.findall(rf"{number} \| {number} \| {number}", section)
    assert len(examples) == 8
    spec = pseudo_code()
    for example in examples:
        v, n, result = (int(cell.replace("\u2212", "-")) for cell in example)
        assert spec.round_shift(v, n) == result
        assert oracle.round_shift(v, n) == result
        assert arithmetic.round_shift(np.array([v], np.int32), n).tolist() == [result]


# --- sibling differences --------------------------------------------------------------------------


def test_the_example_of_sibling_differences_holds():
    rows = re.findall(r"^> \| slot (\d+) \| (none|\d+) \| (\d+) \| ([\d, ]+) \|$", TEXT, re.M)
    slots = [int(slot) for slot, *_ in rows]
    born_from: list[int | None] = [None] * 13
    for slot, birth, *_ in rows:
        born_from[int(slot)] = None if birth == "none" else int(birth)
    differences = [int(d) for *_, d, _ in rows]
    assert (slots, differences) == ([4, 7, 9, 12], [10, 3, 1, 2])
    for n, (*_, after) in enumerate(rows, start=1):
        values = [int(value) for value in after.split(", ")]
        assert pseudo_code().add_siblings(differences[:n], slots[:n], born_from) == values
        q = differences[:n]
        oracle.add_siblings(q, slots[:n], born_from)
        assert q == values


@pytest.mark.thorough
def test_the_pseudo_code_decodes_random_streams_with_sibling_differences_as_the_oracle_does():
    n_of_bands = n_of_core = 0
    for seed in range(250):
        data = random_stream(Random(f"siblings {seed}"))
        scene = oracle.decode(data)
        found = [p for p, _, siblings in with_siblings(data, scene) if siblings]
        n_of_core += any(p.component == 0 for p in found)
        n_of_bands += any(p.component > 0 for p in found)
        if found:
            assert decode_with_pseudo_code(data) == scene.dump(), seed
    assert n_of_core > 30
    assert n_of_bands > 5


# --- the pseudo-code as a decoder -----------------------------------------------------------------


@examples(40)
@given(coded_trees(max_tiles=2, max_steps=4, max_adds=3))
def test_the_pseudo_code_decodes_as_the_codec_does(tree):
    data = write(tree, zstd_level=1)
    assert decode_with_pseudo_code(data) == decode(data).dump()


@pytest.mark.filterwarnings("ignore:position. splats are moved by up to")
@examples(10)
@given(trees(max_roots=6, max_steps=3, largest=300))
def test_the_pseudo_code_decodes_streams_of_the_encoder(tree):
    data = encode(tree, replace(PRESETS["trained"], zstd_level=1), n_tiles=2)
    assert decode_with_pseudo_code(data) == decode(data).dump()


def palette_stream(*late: Packet, early: Sequence[int] = (2, 0)) -> bytes:
    """Palette packets of two levels, picks of two tiles, a split, a drop and an add; then `late`.

    `early`: picks of level 0 when the entry of level 1, the fourth, is there already.
    """
    entries = {0: [1, -2], 1: [3, 4], 2: [0, 5], 8: [7, 7]}
    return build(
        Stream(
            [
                Packet(component=5, adds=entries, flags=2, codings={"adds 8": 0x44}),
                Packet(adds={X: [1, 2]}),
                Packet(component=5, adds={3: [-9]}),
                Packet(tile=1, adds={X: [5]}),
                Packet(component=4, picks=[3, 1]),
                Packet(records={0: SPLIT, 1: DROP}, psi={X: [1]}, adds={X: [8]}),
                Packet(tile=1, component=4, picks=[2]),
                Packet(component=5, level=1, adds={0: [2]}),
                Packet(component=4, picks=early),
                Packet(level=1, records={0: REFINE, 2: SPLIT}, psi={RED: [3, -1]}),
                *late,
            ],
            degree=1,
            has_palette=True,
            n_levels=2,
            tiles=(Tile(), Tile()),
            quantisers={(0, 5): (3, 1)},
        )
    )


@pytest.mark.parametrize(
    "late",
    [
        (),
        (Packet(component=4),),
        (Packet(component=4, is_explicit=True),),
        (Packet(component=4, picks=[4]),),
        (Packet(component=4, picks=[1], repicks=[2, 4]),),
        (Packet(component=4, repicks=()),),
    ],
    ids=[
        "late",
        "of no bytes",
        "of zeros",
        "of new slots",
        "of changed slots",
        "of changed slots, all 0",
    ],
)
def test_the_pseudo_code_decodes_streams_with_a_palette_as_the_oracle_does(late):
    data = palette_stream(*late)
    assert decode_with_pseudo_code(data) == oracle.decode(data).dump()


@pytest.mark.thorough
def test_the_pseudo_code_decodes_random_streams_with_a_palette_as_the_oracle_does():
    streams = [random_stream(Random(f"pseudo-code {seed}")) for seed in range(350)]
    scenes = [oracle.decode(data) for data in streams]
    shared = [k for k, scene in enumerate(scenes) if scene.header.has_palette]
    assert any(tile.cut[0] > tile.cut[oracle.PICKS] > 0 for k in shared for tile in scenes[k].tiles)
    assert sum(bool(scenes[k].palette[0]) for k in shared) > 10
    assert sum(gives_new_picks(streams[k], scenes[k]) for k in shared) > 5
    assert sum(has_levels(scenes[k]) for k in shared) > 3
    for k in shared:
        assert decode_with_pseudo_code(streams[k]) == scenes[k].dump()


def gives_new_picks(data: bytes, scene: oracle.Scene) -> bool:
    """A packet of picks has bit 2 of its flags, and there are entries and slots that it changes."""
    return bool(scene.palette[0]) and any(
        p.component == oracle.PICKS
        and p.size > 0
        and data[p.start] & oracle.OF_CHANGED != 0
        and scene.tiles[p.tile].steps[p.step].core.n_psi > 0
        for p in scene.packets
    )


def has_levels(scene: oracle.Scene) -> bool:
    """Some picks may be of entries, and of fewer than there are."""
    n_required = {
        len(scene.palette_up_to(p.label, p.n_before))
        for p in scene.packets
        if p.component == oracle.PICKS
    }
    return any(0 < n < len(scene.palette_packets) for n in n_required)


def test_a_palette_gives_the_numbers_worked_out_by_hand():
    # Y Co Cg of (1, 3, 0) are R G B of (3, 1, 0), of (-2, 4, 5) of (-2, 1, -6); q is 6 units.
    scene = oracle.decode(palette_stream())
    assert scene.palette[:3] == [[18, -12, 0, 12], [6, 6, 0, 0], [0, -36, 0, 0]]
    # Differences 7 and 0 are Cg of 7 twice, and B of -3; the second packet begins anew.
    assert (scene.palette[3], scene.palette[8]) == ([0, 0, -54, 0], [-18, -18, 0, 0])
    # Slot 1, with entry 1, was dropped; slot 2 was split from 0 and has entry 2, slot 3 has none.
    assert scene.tiles[0].x[14] == [0, 0, -12, 0]
    assert scene.tiles[1].x[14] == [-12]
    # Slot 4 was split from 2, and its pick has not come.
    assert scene.tiles[0].channels[14] == [0, 0, -12, 0, -12]


def test_changed_slots_have_the_picks_worked_out_by_hand():
    # Slot 0 is refined and keeps entry 3, of 0, or gets entry 1; slot 2 is split, and 4 is new.
    late = Packet(component=4, picks=[1], repicks=[1, 0])
    assert oracle.decode(palette_stream(late)).tiles[0].x[14] == [18, 0, 0, 0, 18]
    plain = Packet(component=4, picks=[1])
    assert oracle.decode(palette_stream(plain)).tiles[0].x[14] == [0, 0, -12, 0, 18]
    # Without bytes slot 4 has the pick of 2, from which it was split; of zeros it has none.
    for empty, new in ((Packet(component=4), -12), (Packet(component=4, is_explicit=True), 0)):
        assert oracle.decode(palette_stream(empty)).tiles[0].x[14] == [0, 0, -12, 0, new]


@pytest.mark.parametrize(
    "data",
    [
        palette_stream(Packet(component=4, picks=[5])),
        palette_stream(Packet(component=4, picks=[5], repicks=[0, 0])),
        palette_stream(Packet(component=4, picks=[1], repicks=[5, 0])),
        palette_stream(early=(4, 0)),
    ],
    ids=["new slot", "new slot after changed ones", "changed slot", "entry of a higher level"],
)
def test_a_pick_past_the_entries_it_may_name_is_refused_by_the_pseudo_code(data):
    with pytest.raises(oracle.FaultError) as caught:
        decode_with_pseudo_code(data)
    assert caught.value.code == "E_INDEX"
    with pytest.raises(oracle.FaultError) as caught:
        oracle.decode(data)
    assert caught.value.code == "E_INDEX"


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        ("undelta", ([1 << 28, 1],)),
        ("add_siblings", ([1 << 28, 1], [0, 1], [None, 0])),
        ("add_siblings", ([1 << 28, -1], [0, 1], [None, 0])),
        ("add_siblings", ([-(1 << 28), 1], [0, 1], [None, 0])),
        ("add_siblings", ([1 << 28, -1, -9], range(3), [None, 0, 0])),
        ("within_sum", ((1 << 28) + 1,)),
        ("delta_of", ((1 << 28) + 1, 1, 0)),
        ("delta_of", (1, 65535, 24)),
        ("first_child", ((1 << 30) - 1, 1)),
        ("second_child", (0, 1 << 15, 1 << 15, 1)),
        ("second_child", (-(1 << 30) + 1, 1, 1, 0)),
    ],
)
def test_the_pseudo_code_refuses_what_leaves_its_range(function, arguments):
    with pytest.raises(oracle.FaultError) as caught:
        getattr(pseudo_code(), function)(*arguments)
    assert caught.value.code == "E_RANGE"


def test_sh_that_come_late_show_the_ancestor_in_the_pseudo_code():
    # Slots 0 and 1 were added; 2 was split from 0, 3 added, 4 split from 2.
    shown = [pseudo_code().shown_slot(u, 2, [None, None, 0, None, 2]) for u in range(5)]
    assert shown == [0, 1, 0, None, 0]
