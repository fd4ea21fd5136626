"""The command line as a new user meets it: files, options, errors, exit codes."""

import json
import subprocess
import sys

import numpy as np
import pytest

from evogs_codec import (
    PRESETS,
    SceneInfo,
    decode,
    encode,
    level_psnr,
    read_directory,
    read_ply,
    write_ply,
)
from evogs_codec.cli import commands
from evogs_codec.editing.level_psnr import with_level_psnr
from evogs_codec.encoding.measured_gains import N_ORDERING_VIEWS
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tests.support import damage

COMMANDS = ("encode", "decode", "lift", "info", "validate", "extract", "edit", "compare", "tileset")
QUICKLY = ("--preset", "trained", "--effort", 1)  # where it does not matter how it is encoded


def n_splats(path):
    return len(read_ply(path))


# --- the main job --------------------------------------------------------------------------------


def test_a_scene_is_encoded_looked_at_validated_and_decoded(evogs, made, tmp_path):
    code, out, err = evogs("encode", made / "scene.ply", tmp_path / "a.evogs", "--levels", 4)
    assert (code, err) == (0, "")
    assert "3,000 splats" in out
    assert evogs("validate", tmp_path / "a.evogs")[0] == 0
    code, out, _ = evogs("info", tmp_path / "a.evogs")
    assert code == 0
    assert "position" in out
    assert "level" in out
    code, out, _ = evogs("decode", tmp_path / "a.evogs", tmp_path / "a.ply", "--verify")
    assert code == 0
    assert "3,000 splats, SH degree 3" in out
    assert n_splats(tmp_path / "a.ply") == 3000
    sizes = []
    for level in range(4):
        evogs("decode", tmp_path / "a.evogs", tmp_path / "b.ply", "--level", level)
        sizes.append(n_splats(tmp_path / "b.ply"))
    assert sizes == sorted(sizes)
    assert sizes[-1] == 3000


def test_a_tree_is_encoded_and_a_scene_lifted_to_one(evogs, made, tmp_path):
    assert evogs("encode", made / "x.tree.npz", tmp_path / "x.evogs", "--near-lossless")[0] == 0
    assert evogs("validate", tmp_path / "x.evogs")[0] == 0
    code, out, _ = evogs("lift", made / "scene.ply", tmp_path / "l.tree.npz", "--levels", 3)
    assert code == 0
    assert "3,000 splats, 3 levels" in out
    code, _, _ = evogs("encode", tmp_path / "l.tree.npz", tmp_path / "l.evogs", "--preset", "scene")
    assert code == 0
    assert decode((tmp_path / "l.evogs").read_bytes()).n_leaves == 3000


def test_an_extracted_stream_decodes_to_what_the_whole_one_gives_at_that_cut(evogs, made, tmp_path):
    stream = made / "scene.evogs"
    for options in (
        ["--level", 1],
        ["--sh-degree", 0],
        ["--max-bytes", stream.stat().st_size // 2],
        ["--box", -1, -1, -1, 1, 1, 1],
        ["--level", 2, "--sh-degree", 1, "--max-bytes", 40_000],
    ):
        assert evogs("extract", stream, tmp_path / "s.evogs", *options)[0] == 0
        assert evogs("validate", tmp_path / "s.evogs")[0] == 0
        if "--max-bytes" in options:
            limit = options[options.index("--max-bytes") + 1]
            assert (tmp_path / "s.evogs").stat().st_size <= limit
        assert evogs("decode", tmp_path / "s.evogs", tmp_path / "s.ply")[0] == 0
        assert evogs("decode", stream, tmp_path / "w.ply", *options)[0] == 0
        small, whole = read_ply(tmp_path / "s.ply"), read_ply(tmp_path / "w.ply")
        k = small.sh.shape[1]
        assert np.array_equal(small.channels(), whole.channels()[: 11 + 3 * k])


def strictly(text):
    """The value of JSON text; NaN and Infinity are not JSON."""

    def refuse(name):
        raise ValueError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_json_output_is_json(evogs, made, tmp_path):
    code, out, _ = evogs("encode", made / "x.tree.npz", tmp_path / "x.evogs", "--json", *QUICKLY)
    assert (code, strictly(out)["splats"]) == (
        0,
        decode((tmp_path / "x.evogs").read_bytes()).n_leaves,
    )
    for stream in (made / "scene.evogs", tmp_path / "x.evogs"):
        code, out, _ = evogs("info", stream, "--json")
        figures = strictly(out)
        assert code == 0
        assert figures["size"] == figures["bytes_present"] == stream.stat().st_size
        whole = sum(group["n_bytes"] for group in figures["groups"].values())
        assert whole == pytest.approx(stream.stat().st_size, rel=1e-6)
        code, out, _ = evogs("validate", stream, "--json")
        assert (code, strictly(out)["valid"]) == (0, True)


def test_info_is_json_also_where_the_error_of_a_level_is_unknown(evogs, tmp_path):
    path = tmp_path / "x.evogs"
    path.write_bytes(damage.stream_of([damage.row()]))
    code, out, _ = evogs("info", path, "--json")
    assert (code, strictly(out)["levels"][0]["error"]) == (0, None)
    assert evogs("info", path)[0] == 0


def test_metadata_goes_into_the_stream_and_comes_out(evogs, made, tmp_path):
    options = [
        "--title",
        "Café\n\x1b[31m ☕",
        "--up-axis",
        "+z",
        "--unit",
        "metre",
        "--antialiased",
        *QUICKLY,
    ]
    assert evogs("encode", made / "x.tree.npz", tmp_path / "x.evogs", *options)[0] == 0
    code, out, _ = evogs("info", tmp_path / "x.evogs")
    assert code == 0
    assert "+z" in out
    assert "metre" in out
    assert "Café" in out
    assert "\x1b" not in out
    scene = strictly(evogs("info", tmp_path / "x.evogs", "--json")[1])["scene"]
    assert scene["title"] == options[1]
    code, _, err = evogs("decode", tmp_path / "x.evogs", tmp_path / "x.ply")
    assert (code, err) == (0, "")
    head = (tmp_path / "x.ply").read_bytes().split(b"end_header")[0]
    assert head.isascii()
    assert b"Caf" in head
    assert b"\x1b" not in head


# --- options -------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["decode", "extract"])
def test_options_out_of_range_are_refused(command, refused, made, tmp_path):
    stream, out = made / "scene.evogs", tmp_path / "out"
    refused(command, stream, out, "--level", 5, words=[stream, "level 5", "0..4"])
    refused(command, stream, out, "--max-bytes", 100, words=[stream, "100 bytes are too few"])
    for options in (
        ["--level", -1],
        ["--level", 64],
        ["--level", "one"],
        ["--sh-degree", 4],
        ["--max-bytes", -1],
        ["--box", 0, 0, 0, 1, 1],
        ["--box", 0, 0, 0, 1, 1, "nan"],
        ["--box", 0, 0, 0, 1, 1, "inf"],
        ["--nothing"],
    ):
        refused(command, stream, out, *options, code=2)
    assert not out.exists()


def test_a_box_may_have_its_corners_reversed_and_its_numbers_in_any_notation(evogs, made, tmp_path):
    whole = None
    for corners in (
        ["-1000", "-1000", "-1000", "1000", "1000", "1000"],
        ["1000", "1000", "1000", "-1000", "-1000", "-1000"],
        ["-1e3", "1e3", "-1E+3", "1e3", "-.1e4", "1000."],
    ):
        code, _, err = evogs("extract", made / "scene.evogs", tmp_path / "b", "--box", *corners)
        assert (code, err) == (0, "")
        whole = whole or (tmp_path / "b").read_bytes()
        assert (tmp_path / "b").read_bytes() == whole


def test_the_sh_degree_asked_for_may_be_above_that_of_the_stream(evogs, made, tmp_path):
    evogs("encode", made / "x.tree.npz", tmp_path / "x.evogs", *QUICKLY)
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "x.ply", "--sh-degree", 3)[0] == 0
    assert read_ply(tmp_path / "x.ply").sh_degree == 1
    leaves = decode((tmp_path / "x.evogs").read_bytes()).leaves(sh_degree=3)
    assert leaves.sh.shape == (len(leaves), 16, 3)
    assert not leaves.sh[:, 4:].any()


@pytest.mark.parametrize(
    "options",
    [
        ["--levels", 0],
        ["--levels", 65],
        ["--bits", 1],
        ["--bits", 17],
        ["--bits", 8, "--near-lossless"],
        ["--preset", "near-lossless"],
        ["--finer", 0],
        ["--finer", "nan"],
        ["--max-error", 1e-300],
        ["--max-error", 1e308],
        ["--max-error", "=3"],
        ["--tiles", 0],
        ["--effort", 23],
        ["--unit", "mile"],
    ],
)
def test_options_of_encode_out_of_range_are_a_mistake_of_use(options, refused, made, tmp_path):
    refused("encode", made / "scene.ply", tmp_path / "out", *options, code=2)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--levels", 1],
        pytest.param(["--levels", 64], marks=pytest.mark.thorough),
        ["--bits", 8],
        pytest.param(["--preset", "paper"], marks=pytest.mark.thorough),
        pytest.param(["--finer", 1e-3], marks=pytest.mark.thorough),
        pytest.param(["--finer", 1e6], marks=pytest.mark.thorough),
        pytest.param(["--tiles", 7], marks=pytest.mark.thorough),
        pytest.param(["--tiles", 65536], marks=pytest.mark.thorough),
        pytest.param(["--effort", 1], marks=pytest.mark.thorough),
    ],
)
def test_options_of_encode_at_their_ends_make_valid_streams_or_say_why_not(
    options, evogs, tmp_path
):
    path = tmp_path / "s.ply"
    write_ply(path, make_scene(8))
    code, _, err = evogs("encode", path, tmp_path / "s.evogs", *options)
    assert code in (0, 1)
    assert all(line.startswith("evogs: ") for line in err.splitlines())
    if code == 0:
        assert evogs("validate", tmp_path / "s.evogs")[0] == 0


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_has_examples_that_parse(command, evogs):
    code, out, _ = evogs(command, "--help")
    assert code == 0
    examples = [line.split() for line in out.split("examples:")[1].splitlines() if line.strip()]
    assert examples
    assert any(words[:2] == ["evogs", command] for words in examples)
    for words in examples:
        args = commands._parser().parse_args(words[1:])
        assert args.run.__name__ == f"run_{words[1]}"


@pytest.mark.parametrize("words", [("--up", "-y"), ("--up=-y",), ("--up-axis", "-z")])
def test_an_axis_may_begin_with_a_minus(words):
    args = commands._parser().parse_args(["encode", "a.ply", "a.evogs", *words])
    assert commands._parser().parse_args(["render", "a.ply", "a.png", "--up", "-y"]).up == "-y"
    assert (args.up, args.up_axis) in (("-y", "unspecified"), (None, "-z"))


@pytest.mark.thorough
def test_a_box_that_leaves_out_nothing_or_all_is_said_to(made, tmp_path, evogs):
    def said(stream, *box, expected=0):
        code, _, err = evogs("extract", stream, tmp_path / "part.evogs", "--box", *box)
        assert code == expected
        return err

    whole = (-1e9, -1e9, -1e9, 1e9, 1e9, 1e9)
    tiles = tmp_path / "tiles.evogs"
    write_ply(tmp_path / "few.ply", make_scene(300))
    assert evogs("encode", tmp_path / "few.ply", tiles, "--tiles", 8, *QUICKLY)[0] == 0
    splat = decode(tiles.read_bytes()).leaves().means[0]
    assert said(made / "scene.evogs", *splat, *splat) == (
        "evogs: warning: the box meets all tiles: nothing is left out;"
        " `evogs encode --tiles N` makes more\n"
    )
    assert said(made / "scene.evogs", *whole) == said(tiles, *whole) == ""
    assert "meets no tile, so nothing" in said(tiles, *[1e8] * 3, *[1e9] * 3, expected=1)
    assert said(tiles, *splat, *splat) == ""
    assert (tmp_path / "part.evogs").stat().st_size < tiles.stat().st_size


def test_without_a_command_or_with_an_unknown_one_the_usage_is_shown(refused):
    refused(code=2, words=["usage: evogs", "COMMAND"])
    refused("frobnicate", code=2, words=["usage: evogs", "frobnicate"])
    refused("encode", code=2, words=["usage: evogs encode", "IN"])


def test_the_version_is_shown(evogs):
    code, out, _ = evogs("--version")
    assert code == 0
    assert out.startswith("evogs ")


# --- as a program --------------------------------------------------------------------------------


def test_who_stops_reading_gets_no_error_and_what_was_written(made, tmp_path):
    command = [sys.executable, "-m", "evogs_codec.cli.commands", "extract"]
    target = tmp_path / "x.evogs"
    with subprocess.Popen(
        [*command, made / "scene.evogs", target],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        process.stdout = None
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (141, b"")
    assert target.read_bytes() == (made / "scene.evogs").read_bytes()


def program(*arguments):
    command = [sys.executable, "-m", "evogs_codec.cli.commands", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_the_module_runs_as_a_program(made, tmp_path):
    done = program("validate", made / "scene.evogs")
    assert (done.returncode, done.stderr) == (0, "")
    done = program("validate", made / "scene.ply")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    done = program()
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


@pytest.mark.thorough
def test_a_reader_of_the_output_that_leaves_is_no_error(made):
    command = f"'{sys.executable}' -m evogs_codec.cli.commands info '{made / 'scene.evogs'}' | true"
    done = subprocess.run(
        ["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False
    )
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


def test_a_stream_from_the_library_and_from_the_command_are_the_same(evogs, made, tmp_path):
    tree = damage.random_tree(20, 3, 1)
    evogs("encode", made / "x.tree.npz", tmp_path / "x.evogs", "--preset", "trained")
    info = SceneInfo(text={"generator": evogs("--version")[1].strip()})
    views = Views.of(tree.leaves(), n_views=N_ORDERING_VIEWS)
    plain = encode(tree, PRESETS["trained"], info=info, views=views)
    known = level_psnr(read_directory(tmp_path / "x.evogs"))
    assert known is not None
    assert (tmp_path / "x.evogs").read_bytes() == with_level_psnr(plain, known)
