"""`--limits` of the command line: the same file and meaning as for a decoder under test."""

import json

import pytest

from conformance.decoders.outcomes import OVER_LIMIT
from conformance.decoders.reference import main as decoder
from evogs_codec import read_directory

COMMANDS = ("decode", "validate", "info", "extract", "edit", "render", "psnr", "compare")
DECODING = ("decode", "validate", "info", "extract")


@pytest.fixture
def sizes(made):
    """What the stream has of what limits bound."""
    directory = read_directory((made / "scene.evogs").read_bytes())
    return {
        "n_tiles": len(directory.tiles),
        "n_packets": len(directory.packets),
        "n_levels": directory.n_levels,
        "chunks_size": directory.data_offset - 64,
        "tile_steps": int(directory.steps.max()) + 1,
    }


def arguments_of(command, made, tmp_path, limits):
    path = tmp_path / "limits.json"
    path.write_text(limits if isinstance(limits, str) else json.dumps(limits))
    stream = made / "scene.evogs"
    others = {
        "decode": [tmp_path / "out.ply"],
        "extract": [tmp_path / "out.evogs"],
        "edit": [tmp_path / "out.ply", "--scale", 2],
        "render": [tmp_path / "out.png", "--size", 8],
        "psnr": [made / "scene.ply", "--size", 8],
        "compare": [made / "scene.ply", "--size", 8],
    }
    return [command, stream, *others.get(command, []), "--limits", path]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_stream_over_a_limit_is_refused_and_nothing_is_written(
    command, refused, evogs, made, tmp_path, sizes
):
    assert evogs(*arguments_of(command, made, tmp_path, sizes))[0] == 0
    for path in tmp_path.glob("out.*"):
        path.unlink()
    words = [made / "scene.evogs", "E_LIMIT", f"n_packets {sizes['n_packets']} exceeds"]
    limits = sizes | {"n_packets": sizes["n_packets"] - 1}
    refused(*arguments_of(command, made, tmp_path, limits), words=words)
    assert not list(tmp_path.glob("out.*"))


def test_a_command_and_a_decoder_under_test_refuse_the_same_limits(evogs, made, tmp_path, sizes):
    for name, size in sizes.items():
        for limit, passes in ((size, True), (size - 1, False)):
            arguments = arguments_of("validate", made, tmp_path, {name: limit})
            assert (evogs(*arguments)[0] == 0) is passes, (name, limit)
            options = ["--in", made / "scene.evogs", "--out", tmp_path / "dump", *arguments[2:]]
            assert decoder(list(map(str, options))) == (0 if passes else OVER_LIMIT)


def test_validate_says_the_code_as_json(evogs, made, tmp_path):
    arguments = arguments_of("validate", made, tmp_path, {"slots": 5})
    code, out, err = evogs(*arguments, "--json")
    assert (code, json.loads(out)["fault"], err) == (1, "E_LIMIT", "")


def test_a_part_of_a_stream_is_refused_too(refused, made, tmp_path):
    part = tmp_path / "part"
    part.mkdir()
    (part / "scene.evogs").write_bytes((made / "scene.evogs").read_bytes()[:30_000])
    arguments = arguments_of("decode", part, tmp_path, {"slots": 5})
    refused(*arguments, "--partial", words=["E_LIMIT"])


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ("", "is not JSON"),
        ("[" * 100_000, "nested too deeply"),
        ("3", "is no object of limits"),
        ({"slot": 3}, "'slot' is no limit; limits are n_tiles"),
        ({"a\x1b[2J\u202e": 3}, r"'a\x1b[2J\u202e' is no limit"),
        ({"slots": -1}, "slots is no whole number of 0 or more"),
        ({"slots": 1.5}, "slots is no whole number"),
        ({"slots": True}, "slots is no whole number"),
        ({"slots": "9"}, "slots is no whole number"),
    ],
)
@pytest.mark.parametrize("command", DECODING)
def test_a_file_that_is_no_limits_is_refused_in_one_line(
    command, limits, words, refused, made, tmp_path
):
    arguments = arguments_of(command, made, tmp_path, limits)
    refused(*arguments, words=[tmp_path / "limits.json", words])


def test_a_missing_file_of_limits_is_named(refused, made, tmp_path):
    refused("info", made / "scene.evogs", "--limits", tmp_path / "no.json", words=["no.json"])
