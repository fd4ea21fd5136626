"""Vectors are explained byte by byte, whatever is wrong with them."""

import random
from dataclasses import replace

import pytest

from conformance.generator.builder import DELTA, DROP, REFINE, SPLIT, Packet, Stream, X, build
from conformance.harness.cli import main
from conformance.harness.manifest import SuiteError, load
from conformance.harness.reporting.anatomy import anatomy
from conformance.harness.reporting.explain import explain
from tests.conformance.tiny import EXAMPLE, ROOT

VECTORS = ROOT / "conformance" / "vectors"


def values(data):
    return {piece.name: piece.value for piece in anatomy(data)}


def test_every_field_of_the_example_has_the_name_and_value_of_the_annex():
    found = values(EXAMPLE)
    assert found["grid_exponents"] == "10, 6, 5, 5, 7"
    assert found["chunks_size"] == "307"
    assert found["a"] == "-1 / 2^0"
    assert found["TILE 0: origin"] == "10240, 0, -5"
    assert found["PACK 1: n_splits"] == "1"
    assert found["psi of level 1, scale: mantissa, shift"] == "1, 1"
    assert found["value"] == "'Annex A'"
    assert found["frame 0: Frame_Content_Size"] == "11"
    assert not any(piece.remark for piece in anatomy(EXAMPLE))
    starts = [piece.at for piece in anatomy(EXAMPLE) if piece.starts]
    assert starts == [0, 64, 121, 147, 207, 291, 344, 371, 457]


def test_what_is_wrong_is_remarked():
    broken = bytearray(EXAMPLE)
    broken[0], broken[100], broken[500] = 0, 2, 0
    remarks = {piece.at: piece.remark for piece in anatomy(bytes(broken) + b"xy") if piece.remark}
    assert "R-5.1-1" in remarks[0]
    assert "R-6.3-1" in remarks[72]
    assert "R-6.3-1" in remarks[457]
    assert "R-5.10-1" in remarks[499]
    assert "R-6.2-1" in remarks[519]


def test_packets_of_a_palette_have_their_own_lists():
    codings = {"adds 0": 4 | DELTA}
    stream = Stream(
        [
            Packet(adds={X: [1, 2]}, level=1),
            Packet(component=5, level=1, adds={0: [3, 3], 23: [-1, 0]}, codings=codings),
            Packet(component=4, picks=[2, 0], repicks=[]),
        ],
        degree=2,
        has_palette=True,
        n_levels=2,
    )
    found = values(build(stream))
    assert found["coding bytes of entries"] == "SH 1 R (band 1) 4+0d, SH 8 B (band 2) 1+0"
    assert found["coding bytes of picks"] == "picks 2+0"
    pieces = [piece for piece in anatomy(build(stream)) if piece.name.startswith("coding bytes of")]
    assert [len(piece.raw) for piece in pieces[-2:]] == [24, 1]
    starts = [piece.starts for piece in anatomy(build(stream)) if piece.starts.startswith("packet")]
    assert starts[1:] == [
        "packet 1 (tile 0, step 0, component 5: palette of level 1)",
        "packet 2 (tile 0, step 0, component 4: picks)",
    ]
    assert not any(piece.remark for piece in anatomy(build(stream)))
    bands = build(replace(stream, has_palette=False, header={"flags": 0}))
    assert "coding bytes of picks" not in values(bands)
    assert "R-4.4-1" in next(p.remark for p in anatomy(bands) if p.name == "packet 2: flags")


def test_sibling_differences_are_shown_and_remarked_where_they_may_not_be():
    births = [Packet(adds={X: [1]}), Packet(records={0: SPLIT})]
    layer = Packet(records={0: REFINE, 1: REFINE}, psi={X: [5, 2], 1: [1, 1]}, siblings={X})
    band = Packet(component=1, psi={8: [3, 1]}, siblings={8})
    bands = [Packet(component=1)] * 2
    data = build(Stream([*births, layer, *bands, band], degree=1))
    psi = [piece for piece in anatomy(data) if piece.name == "coding bytes of psi"]
    assert [piece.value for piece in psi[-2:]] == [
        "position x 4+0s, position y 2+0",
        "SH 3 B (band 1) 4+0s",
    ]
    assert not any(piece.remark for piece in anatomy(data))
    for kind in (SPLIT, DROP):
        mixed = replace(layer, records={0: REFINE, 1: REFINE, 2: kind}, psi={X: [5, 2]})
        more = replace(births[0], adds={X: [1, 2]})
        data = build(Stream([more, births[1], mixed, *bands, band], degree=1))
        psi = [piece for piece in anatomy(data) if piece.name == "coding bytes of psi"]
        assert ["R-5.9-3" in piece.remark for piece in psi] == [False, False, True, True]


@pytest.mark.parametrize("size", range(0, len(EXAMPLE), 7))
def test_every_prefix_is_covered(size):
    pieces = anatomy(EXAMPLE[:size])
    assert sum(len(piece.raw) for piece in pieces) == size


@pytest.mark.parametrize("seed", range(60))
def test_random_damage_is_covered(seed):
    choice, data = random.Random(seed), bytearray(EXAMPLE)
    for _ in range(choice.randrange(1, 30)):
        data[choice.randrange(len(data))] = choice.randrange(256)
    at = 0
    for piece in anatomy(bytes(data)):
        assert piece.at == at
        at += len(piece.raw)
    assert at == len(data)


def test_an_explanation_says_what_is_tested_and_where_the_fault_is(made_suite):
    text = explain(made_suite, "crc-of-a-packet")
    assert "tests        tests crc-of-a-packet" in text
    assert "run 0: file: exit 1, rejected, E_CRC at 457" in text
    assert "--- 457: packet 1 (tile 0, step 1, component 0)   <-- E_CRC" in text
    assert "--- 64: chunk 'QUAN'" in text
    assert "(R-6.3-1)" in text
    assert "R-6.3-1      Every `crc` is the CRC-32 of the bytes it covers." in text


def test_cases_of_families_are_explained(made_suite):
    text = explain(made_suite, "prefix-example@460#1")
    assert "prefix-example@460 (460 bytes" in text
    assert "<-- E_TRUNCATED" in text
    assert "cut short (R-6.2-2)" in text


def test_a_wrong_id_gets_a_hint(made_suite, capsys):
    with pytest.raises(SuiteError, match="near: core-example"):
        explain(made_suite, "core-exampel")
    assert main(["explain", "x@1", "--vectors", str(made_suite)]) == 1
    assert "no vector" in capsys.readouterr().err


@pytest.mark.thorough
def test_every_committed_vector_is_explained():
    suite = load(VECTORS)
    for vector in suite.vectors:
        anatomy(suite.read(vector))
    for vector in suite.vectors[::40]:
        assert explain(VECTORS, vector.id).startswith(vector.id)
