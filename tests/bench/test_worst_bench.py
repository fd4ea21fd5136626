"""The streams of the benchmark of worst cases are what it says they are."""

from random import Random

import pytest

from conformance.fuzzing.costly import BUDGET, Shape, stream_of
from evogs_codec import InputError, StreamError, decode, read_directory
from tools.bench.cli import main
from tools.bench.worst.commands import COMMANDS as MEASURED
from tools.bench.worst.known import KNOWN
from tools.bench.worst.search import changed, random_shape, uphill
from tools.bench.worst.table import COMMANDS, _chosen

SMALL = 6_000  # bytes


def random_streams(n):
    rng = Random(5)
    for _ in range(n):
        shape = changed(random_shape(rng), rng)
        try:
            yield shape, stream_of(shape, SMALL)
        except ValueError:  # its chunks take all the room
            continue


def fault_of(data):
    try:
        decode(data)
    except StreamError as error:
        return error.fault.name
    return ""


@pytest.mark.thorough
def test_random_shapes_are_legal_but_for_the_fault_they_name():
    found = set()
    for shape, data in random_streams(80):
        assert len(data) <= SMALL
        faults = {"": ("",), "crc": ("E_CRC", ""), "trailing": ("E_TRAILING",)}[shape.fault]
        assert fault_of(data) in faults, shape  # there may be no packet with a checksum
        found.add(shape.fault)
    assert found == {"", "crc", "trailing"}


@pytest.mark.parametrize("name", KNOWN)
def test_known_shapes_take_at_most_their_bytes(name):
    data = stream_of(KNOWN[name])
    assert 0.5 * BUDGET < len(data) <= BUDGET
    assert len(read_directory(data).packets)


def test_the_search_climbs_to_the_costliest_shape_it_tries():
    costs = []

    def cost(shape):
        costs.append(shape.tiles * shape.levels)
        return float(costs[-1])

    best, shape = uphill(cost, Shape(), Random(2), n_random=20, n_steps=40)
    assert best == max(costs) == shape.tiles * shape.levels
    assert len(costs) == 61


def test_every_command_of_the_table_can_be_measured():
    assert set(COMMANDS) == set(MEASURED)


def test_a_part_of_the_rows_can_be_made_but_not_into_the_page(monkeypatch, tmp_path, capsys):
    assert _chosen(["validate", "feed 100"]) == ["validate", "feed 100"]
    assert _chosen(["feed"]) == [name for name in COMMANDS if name.startswith("feed")]
    assert _chosen([]) == list(COMMANDS)
    with pytest.raises(InputError, match="no row has fed; there are: decode to"):
        _chosen(["fed"])
    words = ["bench", "--only", "worst", "--rows", "feed"]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 1
    assert "--out" in capsys.readouterr().err
    asked = []

    def run(args):
        asked.append(args.rows)
        return 0

    monkeypatch.setattr("tools.bench.cli.run", run)
    monkeypatch.setattr("sys.argv", [*words, "--out", str(tmp_path)])
    assert (main(), asked) == (0, [["feed"]])
