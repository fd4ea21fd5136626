"""The reference decoder keeps the contract of conformance/README.md, as a process."""

import argparse
import json
import subprocess
import sys

import pytest

from conformance.commands import register
from conformance.decoders import oracle, reference
from conformance.decoders.contract import CAPABILITIES, MODES
from conformance.decoders.outcomes import Run
from tests.conformance.tiny import EXAMPLE, ROOT

COMMAND = [sys.executable, "-m", "conformance.decoders.reference"]
WHOLE = oracle.decode(EXAMPLE).dump()


def call(tmp_path, *options, data=EXAMPLE, mode="file"):
    """(exit, standard output, bytes of OUT or None) of the command."""
    source, target = tmp_path / "in", tmp_path / "out"
    source.write_bytes(data)
    target.unlink(missing_ok=True)
    command = [*COMMAND, "--in", str(source), "--out", str(target), "--mode", mode]
    done = subprocess.run(
        [*command, *options], capture_output=True, text=True, cwd=ROOT, check=False
    )
    return done.returncode, done.stdout, target.read_bytes() if target.exists() else None


def ask(tmp_path, data=EXAMPLE, **options):
    """(exit, code, offset, bytes of OUT or None) of the functions behind it."""
    source, target = tmp_path / "in", tmp_path / "out"
    source.write_bytes(data)
    target.unlink(missing_ok=True)
    came = reference.answer(source, target, Run(**{"mode": "progressive"} | options))
    dump = target.read_bytes() if target.exists() else None
    assert came.dump == dump
    return came.exit, came.code, came.offset, dump


def test_an_accepted_stream_leaves_its_dump_and_no_word(tmp_path):
    assert call(tmp_path) == (0, "", WHOLE)
    level_0 = oracle.decode(EXAMPLE, level=0).dump()
    assert call(tmp_path, "--level", "0") == (0, "", level_0)


def test_a_fault_is_one_line_of_json_and_no_output(tmp_path):
    exit_code, said, dump = call(tmp_path, data=EXAMPLE[:-1])
    assert (exit_code, json.loads(said), dump) == (1, {"code": "E_TRUNCATED", "offset": 457}, None)


def test_limits_and_arrival_are_files(tmp_path):
    limits, arrival = tmp_path / "limits", tmp_path / "arrival"
    limits.write_text('{"slots": 3}')
    arrival.write_text("[[100, 419], [0, 100]]")
    exit_code, said, dump = call(tmp_path, "--limits", str(limits))
    assert (exit_code, json.loads(said)["code"], dump) == (4, "E_LIMIT", None)
    assert call(tmp_path, "--arrival", str(arrival), mode="progressive") == (0, "", WHOLE)


def test_the_commands_register_with_the_command_line(made_suite, capsys):
    parser = argparse.ArgumentParser()
    register(parser.add_subparsers())
    args = parser.parse_args(["conformance", "decoder", "--capabilities"])
    assert args.run(args) == 0
    assert json.loads(capsys.readouterr().out) == reference.NAME | CAPABILITIES
    args = parser.parse_args(["conformance", "decoder", "--mode", "file"])
    assert args.run(args) == 2
    options = ["explain", "core-example", "--vectors", str(made_suite)]
    args = parser.parse_args(["conformance", *options])
    assert args.run(args) == 0
    assert "core-example (519 bytes" in capsys.readouterr().out


def test_capabilities_say_that_it_does_everything():
    done = subprocess.run(
        [*COMMAND, "--capabilities"], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert json.loads(done.stdout) == reference.NAME | CAPABILITIES


def test_a_batch_answers_each_line_in_turn(tmp_path):
    source = tmp_path / "in"
    source.write_bytes(EXAMPLE)
    requests = [
        {"id": 7, "in": str(source), "out": str(tmp_path / "a"), "mode": "file"},
        {"id": 7, "in": str(source), "out": str(tmp_path / "b"), "mode": "file", "level": 0},
        {"id": 3, "in": __file__, "out": str(tmp_path / "c"), "mode": "progressive"},
    ]
    done = subprocess.run(
        [*COMMAND, "--batch"],
        input="".join(json.dumps(request) + "\n" for request in requests),
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert [json.loads(line) for line in done.stdout.splitlines()] == [
        {"id": 7, "exit": 0},
        {"id": 7, "exit": 0},
        {"id": 3, "exit": 1, "code": "E_SIGNATURE", "offset": 0},
    ]
    assert (tmp_path / "a").read_bytes() == WHOLE
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("level", [2, 64, -1])
def test_a_level_that_the_stream_does_not_have_is_a_mistake_of_the_caller(tmp_path, mode, level):
    broken = EXAMPLE[:460] + b"\xff" + EXAMPLE[461:]  # in a packet: it is not examined
    for data in (EXAMPLE, broken):
        assert ask(tmp_path, data, mode=mode, level=level) == (2, None, None, None)
    broken = EXAMPLE[:100] + b"\xff" + EXAMPLE[101:]  # in a chunk: it is examined first
    assert ask(tmp_path, broken, mode=mode, level=level)[:2] == (1, "E_CRC")


def test_a_mistake_of_the_caller_is_said_on_standard_error_and_ends_no_batch(tmp_path):
    assert call(tmp_path, "--level", "2") == (2, "", None)
    assert call(tmp_path, "--level", "2", data=EXAMPLE[:300], mode="progressive") == (3, "", None)
    requests = [
        {"id": k, "in": str(tmp_path / "in"), "out": str(tmp_path / "a"), "mode": mode, "level": 2}
        for k, mode in enumerate(["file", "progressive"])
    ]
    (tmp_path / "in").write_bytes(EXAMPLE)
    done = subprocess.run(
        [*COMMAND, "--batch"],
        input="".join(json.dumps(request) + "\n" for request in requests),
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert answers == [{"id": 0, "exit": 2}, {"id": 1, "exit": 2}]
    assert done.stderr.splitlines() == ["level 2 is not one of 0..1"] * 2


def test_missing_bytes_are_no_fault_of_a_progressive_decoder(tmp_path):
    assert ask(tmp_path, EXAMPLE[:370]) == (3, None, None, None)
    nothing = oracle.decode_prefix(EXAMPLE[:371]).dump()
    assert ask(tmp_path, EXAMPLE[:456]) == (3, None, None, nothing)
    first = oracle.decode(EXAMPLE, level=0).dump()
    assert ask(tmp_path, EXAMPLE[:518]) == (3, None, None, first)
    assert ask(tmp_path, b"") == (3, None, None, None)


def test_a_fault_behind_a_missing_packet_of_another_chain_is_reported_at_the_end(tmp_path):
    broken = EXAMPLE[:-1] + bytes([EXAMPLE[-1] ^ 1])
    assert ask(tmp_path, broken) == (1, "E_CRC", 457, None)
    # The packet before it is missing, so it is not in the cut and not examined.
    assert ask(tmp_path, broken, arrival=[[0, 400], [457, 62]])[0] == 3
    assert ask(tmp_path, EXAMPLE + b"x") == (1, "E_TRAILING", 519, None)


@pytest.mark.parametrize("size", [0, 63, 370, 371, 456, 457, 518, 519])
@pytest.mark.parametrize("verify", [False, True])
def test_fed_or_seen_from_the_end_the_answer_is_the_same(tmp_path, size, verify):
    data = EXAMPLE[:size]
    assert ask(tmp_path, data, verify=verify) == ask(tmp_path, data)


@pytest.mark.parametrize("size", [400, 457, 500])
def test_of_a_level_only_its_packets_need_to_have_come(tmp_path, size):
    expected = 0 if size >= 457 else 3
    assert ask(tmp_path, EXAMPLE[:size], level=0)[0] == expected
    broken = EXAMPLE[:460] + b"\xff" + EXAMPLE[461:]  # in the packet of level 1 (R-6.2-3)
    assert ask(tmp_path, broken[:size], level=0)[0] == expected
