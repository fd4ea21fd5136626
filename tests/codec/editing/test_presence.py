"""Which levels a cut has, against what its packets say one by one."""

import numpy as np
import pytest

from evogs_codec import PRESETS, Cut, choose_cut, decode_prefix, encode, read_directory
from evogs_codec.editing.presence import bytes_for_first_splats, level_presence
from tests.support import damage
from tests.support.shared_scenes import shared_scene, shared_tree

STREAMS = {
    "tiles": damage.stream(n_roots=20, n_levels=3, degree=2, n_tiles=4),
    "no SH": damage.stream(n_roots=5, n_levels=3, degree=0, n_tiles=1),
    "palette": encode(shared_tree(shared_scene(300, 20))[1], PRESETS["scene"]),
}


def ends_of(directory):
    return sorted({directory.data_offset, *(directory.offsets + directory.packets["size"])})


@pytest.mark.parametrize("name", STREAMS)
def test_levels_of_every_prefix_are_those_of_its_packets(name):
    directory = read_directory(STREAMS[name])
    for n_bytes in ends_of(directory):
        cut = Cut.of_prefix(directory, n_bytes)
        has = cut.packets(directory)
        core = directory.packets["component"] == 0
        for level, found in enumerate(level_presence(directory, cut)):
            to_level, of_level = directory.labels <= level, directory.labels == level
            some = has & of_level & (directory.packets["size"] > 0)
            assert found.has_all_splats == has[to_level & core].all()
            assert (found.state == "present") == has[to_level].all()
            if found.state == "missing":
                assert not some.any()
            elif found.state == "in part":
                assert some.any() or found.has_all_splats
        assert [found.state for found in level_presence(directory, cut, cut)] == [
            "present"
        ] * directory.n_levels


@pytest.mark.parametrize("name", STREAMS)
def test_a_level_that_is_present_is_contained_in_the_cut(name):
    directory = read_directory(STREAMS[name])
    for n_bytes in ends_of(directory):
        cut = Cut.of_prefix(directory, n_bytes)
        for level, found in enumerate(level_presence(directory, cut)):
            assert (found.state == "present") == cut.contains(Cut.of_level(directory, level))


def test_the_whole_can_be_a_part_of_the_file():
    directory = read_directory(STREAMS["tiles"])
    low = choose_cut(directory, level=1, sh_degree=1)
    states = [found.state for found in level_presence(directory, low)]
    assert states == ["in part", "in part", "missing"]
    states = [
        found.state
        for found in level_presence(directory, low, Cut.full(directory).with_sh_degree(1))
    ]
    assert states == ["present", "present", "missing"]


@pytest.mark.parametrize("name", STREAMS)
def test_the_first_splats_are_there_with_so_many_bytes_and_not_with_one_less(name):
    data = STREAMS[name]
    needed = bytes_for_first_splats(read_directory(data), Cut.full(read_directory(data)))
    assert needed is not None
    assert decode_prefix(data[:needed]).n_leaves > 0
    assert decode_prefix(data[: needed - 1]).n_leaves == 0


def test_a_cut_without_splats_needs_no_bytes():
    directory = read_directory(STREAMS["tiles"])
    nothing = Cut(np.zeros_like(directory.chain_lengths))
    assert bytes_for_first_splats(directory, nothing) is None
