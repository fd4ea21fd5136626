"""Streams by URL: the same results as from a file, of the bytes that a cut needs."""

import subprocess
import sys

import numpy as np
import pytest

from evogs_codec import (
    Fault,
    RemoteFile,
    StreamError,
    byte_ranges,
    choose_cut,
    decode,
    decode_leaves,
    decode_prefix,
    encode_scene,
    extract,
    read_directory,
)
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.stores import remote_file
from tests.support.range_server import serving

BOX = (-20, -20, -20, 0, 0, 20)


@pytest.fixture(scope="module")
def stream():
    return encode_scene(
        make_scene(2000), levels=5, n_tiles=12, preset="scene", effort=1, cameras=()
    )


@pytest.fixture
def site(stream, monkeypatch):
    """A server with `scene.evogs`; few bytes are fetched beside those that are needed."""
    pytest.importorskip("obstore", reason="URLs need obstore: pip install -e '.[stores]'")
    monkeypatch.setattr(remote_file, "FIRST_BYTES", 1 << 10)
    monkeypatch.setattr(remote_file, "MAX_GAP", 0)
    with serving({"scene.evogs": stream}) as site:
        yield site


def test_the_directory_takes_one_range_or_a_second_if_it_is_larger(site, stream, monkeypatch):
    size = read_directory(stream).data_offset
    for first, asked in ((1024, ["0-1023", f"1024-{size - 1}"]), (1 << 15, ["0-32767"])):
        monkeypatch.setattr(remote_file, "FIRST_BYTES", first)
        site.asked.clear()
        directory = read_directory(f"{site.url}scene.evogs")
        assert directory.size == len(stream)
        assert site.asked == [f"bytes={part}" for part in asked]


def test_a_cut_fetches_the_directory_and_its_packets(site, stream):
    directory = read_directory(stream)
    cut = choose_cut(directory, box=BOX, level=3)
    needed = sum(size for _, size in byte_ranges(directory, cut))
    with RemoteFile(f"{site.url}scene.evogs") as remote:
        found = decode(remote, cut)
        assert remote.n_fetched == directory.data_offset + needed < 0.6 * len(stream)
    assert found.dump() == decode(stream, cut).dump()


@pytest.mark.parametrize("make", [decode_leaves, pytest.param(decode, marks=pytest.mark.thorough)])
def test_a_url_is_decoded_as_its_file_is(site, stream, make):
    def leaves(data, **options):
        found = make(data, verify=True, **options)
        return (found if make is decode_leaves else found.leaves()).channels()

    url = f"{site.url}scene.evogs"
    assert np.array_equal(leaves(url, level=2), leaves(stream, level=2))
    assert np.array_equal(leaves(url), leaves(stream))


def test_a_url_is_extracted_from_as_its_file_is(site, stream):
    cut = choose_cut(read_directory(stream), box=BOX)
    url = f"{site.url}scene.evogs"
    assert extract(url, cut, box=BOX) == extract(stream, cut, box=BOX)


def test_fetching_tells_its_progress(site):
    told = []
    decode_leaves(f"{site.url}scene.evogs", progress=lambda stage, part: told.append((stage, part)))
    assert {"fetch", "decode"} == {stage for stage, _ in told}
    assert max(part for stage, part in told if stage == "fetch") == 1.0


def test_a_part_of_a_stream_is_the_part_it_is_on_the_disk_too(site, stream):
    half = len(stream) // 2
    site.files["half.evogs"] = stream[:half]
    url = f"{site.url}half.evogs"
    assert decode_prefix(url).dump() == decode_prefix(stream[:half]).dump()
    with pytest.raises(StreamError) as found:
        decode_leaves(url)
    assert found.value.fault is Fault.E_TRUNCATED


def test_more_than_a_stream_is_more_by_url_too(site, stream):
    site.files["more.evogs"] = stream + b"x"
    with pytest.raises(StreamError) as found:
        decode(f"{site.url}more.evogs", level=0)
    assert (found.value.fault, found.value.offset) == (Fault.E_TRAILING, len(stream))


@pytest.mark.thorough
def test_a_damaged_packet_is_named_by_its_place_in_the_file(site, stream):
    at = int(read_directory(stream).offsets[-1])
    site.files["bad.evogs"] = stream[:at] + bytes([stream[at] ^ 1]) + stream[at + 1 :]
    with pytest.raises(StreamError) as found:
        decode(f"{site.url}bad.evogs")
    assert (found.value.fault, found.value.offset) == (Fault.E_CRC, at)
    assert decode(f"{site.url}bad.evogs", level=0).n_leaves > 0


def test_a_directory_over_a_limit_is_not_fetched(site):
    with RemoteFile(f"{site.url}scene.evogs") as remote:
        with pytest.raises(StreamError) as found:
            read_directory(remote, {"chunks_size": 2000})
        assert found.value.fault is Fault.E_LIMIT
        assert remote.n_fetched == 1024


def test_the_library_is_loaded_for_urls_alone():
    program = "import sys, evogs_codec.cli.commands; print('obstore' in sys.modules)"
    command = [sys.executable, "-c", program]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b"False\n"
