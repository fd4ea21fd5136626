"""What decoding takes and answers: sources, levels, what is complete, which bytes to fetch."""

from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from evogs_codec import (
    PRESETS,
    Cut,
    Decoder,
    Fault,
    SceneInfo,
    SplatParams,
    StreamError,
    byte_ranges,
    choose_cut,
    decode,
    decode_leaves,
    decode_prefix,
    encode,
    extract,
    lift,
    read_directory,
)
from evogs_codec.format import directory as directory_module
from evogs_codec.render.demo_scene import make_scene


@cache
def stream():
    """300 splats in 4 levels and 2 tiles."""
    info = SceneInfo(text={"title": "x" * 500})
    return encode(lift(make_scene(300), 4), PRESETS["scene"], n_tiles=2, info=info)


def fed(*parts):
    """A decoder that got these (offset, bytes)."""
    decoder = Decoder()
    for at, data in parts:
        decoder.feed(data, at)
    return decoder


# --- what is given --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, np.frombuffer, "path", "str"])
def test_bytes_of_any_kind_or_a_path_are_taken(kind, tmp_path):
    (tmp_path / "a.evogs").write_bytes(stream())
    make: Any = {
        "path": lambda _: tmp_path / "a.evogs",
        "str": lambda _: str(tmp_path / "a.evogs"),
        np.frombuffer: partial(np.frombuffer, dtype=np.uint8),
    }.get(kind, kind)
    source = make(stream())
    right = decode(stream())
    assert read_directory(source).size == len(stream())
    assert decode(source).dump() == decode_prefix(source).dump() == right.dump()
    assert np.array_equal(decode_leaves(source).channels(), right.leaves().channels())
    assert extract(source, Cut.full(right.directory)) == stream()


@pytest.mark.parametrize("call", [decode, decode_leaves, decode_prefix, read_directory])
def test_what_is_neither_bytes_nor_a_path_is_refused(call):
    with pytest.raises(TypeError, match="the bytes of a stream, or its path, not SplatParams"):
        call(make_scene(3))
    with pytest.raises(FileNotFoundError):
        call("no-such-file.evogs")


def test_a_level_may_be_asked_for_by_its_number():
    directory = read_directory(stream())
    for level in range(4):
        by_cut = decode(stream(), Cut.of_level(directory, level))
        assert decode(stream(), level=level).dump() == by_cut.dump()
        leaves = decode_leaves(stream(), level=level).channels()
        assert np.array_equal(leaves, by_cut.leaves().channels())
    with pytest.raises(TypeError, match=r"not 2: decode\(data, level=2\)"):
        decode(stream(), 2)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="see choose_cut"):
        decode_leaves(stream(), lambda _: None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="exclude each other"):
        decode(stream(), Cut.full(directory), level=1)
    with pytest.raises(ValueError, match=r"level 4 is not one of 0\.\.3"):
        decode(stream(), level=4)


def test_a_directory_that_was_read_is_not_read_again(monkeypatch):
    directory = read_directory(stream())
    right = decode(stream()).dump()
    smaller = extract(stream(), Cut.of_level(directory, 1))

    def never(*_):
        raise AssertionError("the header is read again")

    monkeypatch.setattr(directory_module, "read_header", never)
    assert decode(stream(), directory=directory).dump() == right
    assert len(decode_leaves(stream(), directory=directory)) == 300
    assert extract(stream(), Cut.of_level(directory, 1), directory=directory) == smaller


def test_progress_has_a_stage_and_a_part():
    seen: list[tuple[str, float]] = []
    decode(stream(), progress=lambda stage, part: seen.append((stage, part)))
    assert {stage for stage, _ in seen} == {"decode"}
    assert seen[-1][1] == 1


# --- a stream that is coming ----------------------------------------------------------------------


def test_a_decoder_says_whether_it_is_complete():
    half = len(stream()) // 2
    decoder, found = Decoder(), []
    for piece in (b"", stream()[:half], stream()[half:]):
        decoder.feed(piece)
        found.append((decoder.is_complete, decoder.verdict))
    assert found == [(False, None), (False, None), (True, None)]


def test_the_verdict_is_the_first_fault_known_whatever_is_missing():
    directory = read_directory(stream())
    rows = directory.packets
    roots = np.flatnonzero((rows["component"] == 0) & (directory.steps == 0))  # one of each tile
    at, size = int(directory.offsets[roots[1]]), int(rows["size"][roots[1]])
    damaged = bytes(byte ^ 255 for byte in stream()[at : at + size])
    decoder = fed((0, stream()[: directory.data_offset]), (at, damaged))
    assert decoder.verdict is not None
    assert (decoder.verdict.fault, decoder.verdict.offset) == (Fault.E_CRC, at)
    with pytest.raises(StreamError, match="E_TRUNCATED"):
        decoder.close()
    decoder = fed((0, stream() + b"more"))
    assert decoder.is_complete
    assert decoder.verdict is not None
    assert decoder.verdict.fault is Fault.E_TRAILING
    with pytest.raises(StreamError, match="E_TRAILING"):
        decoder.close()


def test_the_header_is_read_once(monkeypatch):
    calls = []

    def read(*args):
        calls.append(args)
        return directory_module.read_header(*args)

    monkeypatch.setattr("evogs_codec.decoding.progressive.read_header", read)
    decoder = Decoder()
    for at in range(len(stream())):
        decoder.feed(stream()[at : at + 1])
    assert decoder.is_complete
    assert len(calls) == 1


def test_leaves_are_those_of_decoding_in_shape_and_numbers():
    directory = read_directory(stream())
    for k in (0, 1, 7, len(directory.packets)):
        end = int(directory.offsets[k]) if k < len(directory.packets) else len(stream())
        decoder, decoded = fed((0, stream()[:end])), decode_prefix(stream()[:end])
        assert decoder.cut == decoded.cut
        for degree in (None, 0, 3):
            found = decoder.leaves(sh_degree=degree)
            expected = decoded.leaves(sh_degree=degree)
            assert np.array_equal(found.channels(), expected.channels())
    assert Decoder().leaves(sh_degree=2).sh.shape == (0, 9, 3)


# --- which bytes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0, 300, 10**6])
def test_ranges_hold_the_packets_of_a_cut_and_no_others(gap):
    directory = read_directory(stream())
    head = stream()[: directory.data_offset]
    before = Cut.of_level(directory, 0)
    for cut in (Cut.of_level(directory, 2), choose_cut(directory, sh_degree=1)):
        ranges = byte_ranges(directory, cut, gap=gap)
        assert all(size > 0 for _, size in ranges)
        assert all(b[0] - sum(a) > gap for a, b in pairwise(ranges))
        decoder = fed((0, head), *((at, stream()[at : at + size]) for at, size in ranges))
        assert decoder.cut.contains(cut)
        if gap == 0:
            assert decoder.cut == cut
            wanted = cut.packets(directory)
            n_bytes = int(directory.packets["size"][wanted].sum())
            assert sum(size for _, size in ranges) == n_bytes
        more = byte_ranges(directory, cut, have=before, gap=gap)
        decoder = fed(
            (0, head),
            *((at, stream()[at : at + n]) for at, n in byte_ranges(directory, before)),
            *((at, stream()[at : at + n]) for at, n in more),
        )
        assert decoder.cut.contains(cut)
        assert sum(n for _, n in more) < sum(n for _, n in ranges)
    assert byte_ranges(directory, before, have=before) == []
    assert byte_ranges(directory, Cut.full(directory)) == [
        (directory.data_offset, directory.size - directory.data_offset)
    ]
    with pytest.raises(ValueError, match="a gap of -1 bytes"):
        byte_ranges(directory, before, gap=-1)


# --- how objects are shown and compared -----------------------------------------------------------


def test_cuts_are_equal_if_their_numbers_are():
    directory = read_directory(stream())
    one, two = (Cut.of_level(directory, 1) for _ in range(2))
    assert one == two
    assert len({one, two, Cut.full(directory)}) == 2
    assert one != Cut(one.steps, 1)
    assert one != "a cut"


def test_objects_are_shown_in_one_short_line():
    tree = lift(make_scene(300), 4)
    directory = read_directory(stream())
    cut = Cut.of_level(directory, 0)
    assert repr(make_scene(300)) == "SplatParams(300 splats, SH degree 3)"
    assert (
        repr(tree) == f"EvolutionTree(300 leaves, 4 levels, {len(tree.steps)} steps, SH degree 3)"
    )
    assert repr(directory) == (
        f"Directory({len(stream())} bytes, 4 levels, 2 tiles, {len(directory.packets)} packets,"
        " SH degree 3)"
    )
    assert repr(cut) == "Cut(2 tiles, 4 components: steps 1, 1, 1, 1)"
    decoded = decode(stream(), cut)
    assert repr(decoded) == f"Decoded({decoded.n_leaves} splats, {cut!r})"
    assert "have not come yet" in repr(Decoder())
    n = len(directory.packets)
    assert repr(fed((0, stream()))) == f"Decoder({n} of {n} packets applied)"
    assert isinstance(decoded.leaves(), SplatParams)
