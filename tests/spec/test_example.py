"""The worked example of Annex A decodes to what the annex says."""

import re
from pathlib import Path

import numpy as np

from conformance.decoders import oracle
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.read_tree import read_coded_tree
from tools.example import stream

SPEC = Path(__file__).resolve().parents[2] / "spec"
DATA = (SPEC / "example.evogs").read_bytes()
ANNEX = (
    (SPEC / "evogs.md")
    .read_text(encoding="utf-8")
    .split("<!-- table example -->")[1]
    .split("<!-- end example -->")[0]
)


def table_rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def test_the_rows_with_an_offset_are_the_bytes_of_the_file():
    found = re.findall(r"^\| (\d+) \| `([0-9A-F ]+)`", ANNEX, re.MULTILINE)
    assert b"".join(bytes.fromhex(raw) for _, raw in found) == DATA
    at = 0
    for offset, raw in found:
        assert int(offset) == at
        at += len(bytes.fromhex(raw))
    assert len(DATA) < 600


def test_the_states_are_those_that_the_oracle_decodes():
    states = re.findall(r"X after step (\d+):\n\n((?:\|.*\n)+)", ANNEX)
    assert [int(step) for step, _ in states] == [0, 1]
    for step, text in states:
        tile = oracle.decode(DATA, cut=[[int(step) + 1]], check_digests=True).tiles[0]
        for row in table_rows(text):
            slot = int(row[0])
            assert row[1] == ("yes" if tile.live[slot] else "no")
            born = tile.born_from[slot]
            assert int(row[2]) == (-1 if born is None else born)
            numbers = [int(v) for cell in row[3:] for v in cell.split(", ")]
            assert numbers == [x[slot] for x in tile.channels]


def test_the_float_view_and_the_digest_are_those_that_the_oracle_decodes():
    scene = oracle.decode(DATA)
    text = ANNEX[ANNEX.index("The float view") :]
    values = [float(v) for row in table_rows(text) for v in row[2].split(", ")]
    assert tuple(values) == scene.float_view()[-1]
    assert f"`{scene.state_digest(0, 0).hex()}`" in text


def test_the_example_shows_each_kind_of_record_and_a_tie_of_round_shift():
    tree = read_coded_tree(stream())
    roots, changes = tree.tiles[0].steps
    assert (roots.adds.shape[1], sorted(changes.kinds.tolist())) == (3, [0, 1, 2])
    table, delta = tree.alpha[1, 0], int(changes.psi[0, 0]) * tree.quantisers[2][0].step
    product = table.entries[int(changes.alpha[0, 0])] * delta
    assert table.shift > 0
    assert product < 0
    assert product % (1 << table.shift) == 1 << (table.shift - 1)


def test_the_example_is_decoded_alike_by_the_codec():
    decoded = decode(DATA, verify=True)
    assert decoded.dump() == oracle.decode(DATA).dump()
    assert np.isfinite(decoded.leaves().channels()).all()
