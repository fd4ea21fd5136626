"""The second worked example decodes to what its annex says, and has what the first one lacks."""

import re
from pathlib import Path

import numpy as np

from conformance.decoders import oracle
from conformance.generator.builder import PALETTE, PICKS
from evogs_codec.decoding.decode import decode
from evogs_codec.format.directory import read_directory
from tools.example_2 import stream

SPEC = Path(__file__).resolve().parents[2] / "spec"
DATA = (SPEC / "example-2.evogs").read_bytes()
ANNEX = (
    (SPEC / "evogs.md")
    .read_text(encoding="utf-8")
    .split("<!-- table example2 -->")[1]
    .split("<!-- end example2 -->")[0]
)


def test_it_is_made_to_the_byte_and_the_rows_are_its_bytes():
    found = re.findall(r"^\| (\d+) \| `([0-9A-F ]+)`", ANNEX, re.MULTILINE)
    assert b"".join(bytes.fromhex(raw) for _, raw in found) == DATA == stream()
    at = 0
    for offset, raw in found:
        assert int(offset) == at
        at += len(bytes.fromhex(raw))
    assert 900 < len(DATA) < 1100


def test_the_dump_is_that_of_the_oracle_and_of_the_codec():
    lines = re.findall(r"^[0-9A-F]{4}  ([0-9A-F ]+)$", ANNEX, re.MULTILINE)
    dump = bytes.fromhex(" ".join(lines))
    assert (
        dump == oracle.decode(DATA, check_digests=True).dump() == decode(DATA, verify=True).dump()
    )


def test_the_slots_are_those_that_the_oracle_decodes():
    tiles = re.findall(r"X of tile (\d), as shown:\n\n((?:\|.*\n)+)", ANNEX)
    scene = oracle.decode(DATA)
    assert [int(number) for number, _ in tiles] == [0, 1]
    for number, text in tiles:
        tile = scene.tiles[int(number)]
        rows = [line.strip("|").split(" | ") for line in text.splitlines()[2:]]
        assert len(rows) == tile.n_slots
        for slot, row in enumerate(rows):
            numbers = [int(v) for cell in row[3:] for v in cell.split(", ")]
            assert numbers == [x[slot] for x in tile.channels]


def test_it_has_tiles_a_palette_late_picks_a_packet_of_size_0_and_frames_of_both_kinds():
    directory = read_directory(memoryview(DATA))
    packets = directory.packets
    assert len(directory.tiles) == 2
    assert np.count_nonzero(packets["component"] == PALETTE) == 2
    assert packets["size"][packets["component"] == PICKS].min() == 0
    assert (directory.chain_lengths == [[2, 1], [1, 1]]).all()  # of core and picks
    kinds, n_frames = set(re.findall(r"block header \| (\S+),", ANNEX)), DATA[617]
    assert kinds == {"raw", "RLE"}
    assert n_frames == 3
    late = decode(DATA).leaves().sh[:, 1:]
    assert late[2].any()  # slot 3, born from slot 0
    assert not late[3].any()  # an add of the step without picks
