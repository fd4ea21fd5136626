"""The bytes of a stream may change while it is decoded, as those of a mapped file may."""

from random import Random

import numpy as np
import pytest

from conformance.generator.builder import places
from conformance.generator.random_streams import random_stream
from evogs_codec import PRESETS, EvolutionTree, decode, encode
from evogs_codec.decoding.compiled import dispatch
from evogs_codec.format.crc import crc32
from evogs_codec.format.directory import read_directory
from evogs_codec.render.demo_scene import make_scene


@pytest.mark.parametrize("min_compiled", [0, dispatch.MIN_COMPILED])
def test_bytes_that_change_after_their_checksum_was_checked_do_not_matter(
    monkeypatch, min_compiled
):
    monkeypatch.setattr(dispatch, "MIN_COMPILED", min_compiled)
    tree = EvolutionTree.of_splats(make_scene(50))
    right, data = (
        decode(encode(tree, PRESETS["trained"])).dump(),
        bytearray(encode(tree, PRESETS["trained"])),
    )
    begin, end = places(bytes(data)).packets[0]
    before = crc32

    def and_change(covered, *more):
        found = before(covered, *more)
        if len(covered) == end - begin:
            data[begin + 1] = 250  # the number of frames
        return found

    monkeypatch.setattr(dispatch, "crc32", and_change)
    monkeypatch.setattr("evogs_codec.format.directory.crc32", and_change)
    assert decode(memoryview(data)).dump() == right


def test_header_reading_writes_no_more_frames_than_there_is_room_for():
    kernels = pytest.importorskip(
        "evogs_codec.decoding.compiled.channels", reason="numba is an extra"
    )
    data = encode(EvolutionTree.of_splats(make_scene(50)), PRESETS["trained"])
    directory = read_directory(data)
    row = directory.packets[:1]
    counts = np.array([[int(row["n_adds"][0]), 0, 0, 0]])
    n = kernels.MAX_LISTS
    frames = np.full((40, 3), -1, np.int64)
    found = kernels.read_headers(
        np.frombuffer(data, np.uint8), directory.offsets[:1], row["size"].astype(np.int64),
        np.zeros(1, np.int64), counts, np.empty((1, n), np.uint8), np.empty((1, n), np.int64),
        np.empty(1, np.int64), frames[:0],
    )  # fmt: skip
    assert not found
    assert (frames == -1).all()


def test_random_streams_decode_alike_from_bytes_that_may_change():
    for seed in range(20):
        data = random_stream(Random(seed))
        assert decode(memoryview(bytearray(data))).dump() == decode(data).dump()
