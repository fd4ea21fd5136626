"""Huffman-coded literals: libzstd takes what R-5.10-12 to R-5.10-14 refuse, so they are checked."""

from collections import Counter
from random import Random

import numpy as np
import pytest
import zstandard

from conformance.decoders import oracle
from conformance.decoders.cleanroom import decoder as cleanroom
from conformance.fuzzing.literals import damaged_literals
from conformance.generator import builder
from conformance.generator.builder import places
from conformance.generator.cases import zstd_huffman, zstd_libraries, zstd_sequences
from evogs_codec.errors import StreamError
from evogs_codec.format import frames, literals
from evogs_codec.format.compiled_frames import read_frames

RECIPES = zstd_huffman.RECIPES + zstd_libraries.RECIPES + zstd_sequences.RECIPES
# 256 literals of a bit each in four streams, which libzstd 1.5.7 takes. Those of the last two
# differ in the last byte of the stream before the one that lacks a bit.
FROM_IMPLEMENTERS = [
    "28b52ffd60000085010006100b8010090009000900aaaaaaaaaaaaaaaa01aaaaaaaaaaaaaaaa02"
    "aaaaaaaaaaaaaaaa01aaaaaaaaaaaaaaaa0100",
    "28b52ffd6000007d010006d00a8010090008000900aaaaaaaaaaaaaaaa0155555555555555aa"
    "aaaaaaaaaaaaaaaa01aaaaaaaaaaaaaaaa0100",
    "28b52ffd6000007d010006d00a8010090008000900aaaaaaaaaaaaaaaa8055555555555555aa"
    "aaaaaaaaaaaaaaaa01aaaaaaaaaaaaaaaa0100",
]


def content(frame, size, monkeypatch, may_compile):
    """What the codec makes of a frame: its content, or the name of the fault."""
    monkeypatch.setattr(frames, "MAY_COMPILE", may_compile)
    try:
        return frames.decompress(memoryview(frame), size, 7)
    except StreamError as fault:
        return fault.fault.name


def by_oracle(frame, size):
    try:
        return oracle.read_frame(frame, size)
    except oracle.FaultError as fault:
        return fault.code


def by_cleanroom(frame, size):
    try:
        return cleanroom.read_frame(memoryview(frame), size)
    except cleanroom.FaultError as fault:
        return str(fault)


def one_frame(data):
    """The frame of a packet of adds of one channel, and the size of its content."""
    ((begin, end),) = places(data).packets
    frame = data[begin + 37 + 5 : end]
    return frame, zstandard.frame_content_size(frame)


@pytest.mark.parametrize("may_compile", [False, True])
@pytest.mark.parametrize("frame", FROM_IMPLEMENTERS)
def test_frames_on_which_libzstd_and_the_rfc_differ_are_refused(frame, may_compile, monkeypatch):
    frame = bytes.fromhex(frame)
    assert len(zstandard.ZstdDecompressor().decompress(frame)) == 256
    assert content(frame, 256, monkeypatch, may_compile) == "E_ZSTD"
    places_of = np.array([[0, len(frame), 256]])
    with pytest.raises(StreamError, match="E_ZSTD"):
        frames.decompress_all(memoryview(frame), places_of)


def test_the_message_names_the_requirements():
    with pytest.raises(StreamError, match=r"R-5\.10-12 to R-5\.10-14"):
        frames.decompress(memoryview(bytes.fromhex(FROM_IMPLEMENTERS[0])), 256, 7)


@pytest.mark.parametrize("case", [c for recipe in RECIPES for c in recipe()])
def test_vectors_mean_the_same_with_and_without_compiled_loops(case, monkeypatch):
    frame, size = one_frame(case.data)
    plain = content(frame, size, monkeypatch, may_compile=False)
    assert content(frame, size, monkeypatch, may_compile=True) == plain
    assert (plain if isinstance(plain, str) else None) == case.expect


def test_damaged_literals_mean_the_same_to_all_decoders(monkeypatch):
    found = Counter[tuple[bool, bool]]()
    for seed in range(150):
        frame, size = one_frame(damaged_literals(Random(seed)))
        right = by_oracle(frame, size)
        assert by_cleanroom(frame, size) == right
        for may_compile in (False, True):
            assert content(frame, size, monkeypatch, may_compile) == right
        try:
            takes = len(zstandard.ZstdDecompressor().decompress(frame)) == size
        except zstandard.ZstdError:
            takes = False
        found[takes, right == "E_ZSTD"] += 1
    # libzstd takes some that are refused, and refuses none that is not.
    assert found[True, True] > 5
    assert found[True, False] > 20
    assert (False, False) not in found


@pytest.mark.parametrize("level", [1, 3, 9, 19])
def test_what_libzstd_writes_is_kept(level, monkeypatch):
    rng = np.random.default_rng(level)
    for spread in (1, 4, 20, 60):
        data = np.abs(rng.normal(0, spread, 300_000)).clip(0, 255).astype(np.uint8).tobytes()
        data = data[:200_000] + data[:1000] + data[200_000:]
        frame = frames.compress(data, level)
        for may_compile in (False, True):
            assert content(frame, len(data), monkeypatch, may_compile) == data


def test_trees_that_are_used_again_are_not_decoded_again():
    asked = []

    def decompress(frame, n):
        asked.append(n)
        return frames._decompress_some(frame, n)

    n_blocks = 40
    first = zstd_huffman.literals(zstd_huffman.PLAIN) + zstd_huffman.NO_SEQUENCE
    again = zstd_huffman.literals([0, 1] * 5, 1, tree=b"") + zstd_huffman.NO_SEQUENCE
    blocks = [(2, len(first), first)] + [(2, len(again), again)] * n_blocks
    size = 256 + 10 * n_blocks
    frame = builder.frame(size, blocks)
    assert literals.are_exact(memoryview(frame), decompress)
    assert sum(asked) == size + n_blocks  # and one of the block that hands the tree on


def test_literals_that_do_not_fit_their_frame_lead_nowhere():
    """The compiled reader is not led out of a frame, nor past its content; it errs in no way."""
    rng = Random(5)
    for seed in range(60):
        frame, size = one_frame(damaged_literals(Random(seed)))
        for _ in range(20):
            torn = bytearray(frame)
            for _ in range(rng.choice((1, 2, 8))):
                torn[rng.randrange(8, min(len(torn), 80))] = rng.randrange(256)
            if rng.random() < 0.3:
                del torn[rng.randrange(12, len(torn)) :]
            out = np.full(size + 64, 7, np.uint8)
            places_of = np.array([[0, len(torn), size]])
            is_read = read_frames(np.frombuffer(bytes(torn), np.uint8), places_of, out[:size])
            assert (out[size:] == 7).all()
            if is_read:
                assert oracle.read_frame(bytes(torn), size) == out[:size].tobytes()
