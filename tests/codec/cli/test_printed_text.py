"""What commands print of files: nothing that a terminal obeys, nothing endless, no failure."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from evogs_codec import PRESETS, EvolutionTree, SceneInfo, encode, read_ply, write_ply
from evogs_codec.common.printable import MAX_LINE, MAX_NAME, shown
from evogs_codec.render.demo_scene import make_scene
from tests.codec.io.test_ply import columns_of, ply_bytes, scene_of

ESCAPES = "\x1b[2J\x07\u202e\u2066\u200b\x9b31m\x7f"
IN_ASCII = "\x1b[2J\x07\x7f"


def stream_of(text):
    tree = EvolutionTree.of_splats(make_scene(5))
    return encode(tree, PRESETS["trained"], info=SceneInfo(text=text))


def plain(text):
    """Whether the text has nothing but printable characters in its lines."""
    return all(line.isprintable() for line in text.split("\n"))


# --- the function --------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [ESCAPES, "\udcff\ud800", "a\nb\r\tc", "\u2028\u2029\u00a0", "\0"])
def test_what_is_not_printable_is_escaped(text):
    assert shown(text).isprintable()
    assert shown(text).encode("utf-8").decode("unicode_escape") == text
    assert shown("Café ☕ 日本") == "Café ☕ 日本"


@pytest.mark.parametrize("text", ["x" * 10**6, "\x1b" * 10**6, "x" * 199 + "\x1b"])
def test_a_long_text_is_cut_in_its_middle(text):
    assert len(shown(text)) <= MAX_NAME
    assert "..." in shown(text)
    assert shown("begin" + "x" * 1000 + "end", 20) == "beginxxxx...xxxxxend"
    assert shown("x" * MAX_NAME) == "x" * MAX_NAME


# --- files ---------------------------------------------------------------------------------------

COLUMNS = columns_of(scene_of(2, 0))
PLYS = {
    "an element": ply_bytes(COLUMNS, first=[f"element {IN_ASCII} 0"]).replace(b"vertex", b"v"),
    "a long element": ply_bytes(COLUMNS, first=["element " + "x" * 90_000 + " 0"]).replace(
        b"vertex", b"v"
    ),
    "many elements": ply_bytes(COLUMNS, first=[f"element e{i} 0" for i in range(9000)]).replace(
        b"vertex", b"v"
    ),
    "a list": ply_bytes(COLUMNS, last=[f"property list uchar float {IN_ASCII}"]),
    "a type": ply_bytes(COLUMNS, last=[f"property {IN_ASCII} x"]),
    "a count": ply_bytes(COLUMNS, first=[f"element f {IN_ASCII}"]),
    "a number": ply_bytes(COLUMNS, "ascii").replace(b"-3.0", IN_ASCII.encode()),
    "a line": ply_bytes(COLUMNS, last=[IN_ASCII + "x" * 90_000]),
}


@pytest.mark.parametrize("name", PLYS)
@pytest.mark.parametrize("command", ["encode", "lift"])
def test_names_of_a_ply_are_escaped_and_cut(command, name, refused, tmp_path):
    path = tmp_path / "x.ply"
    path.write_bytes(PLYS[name])
    said = refused(command, path, tmp_path / "out", words=[path])
    assert plain(said)
    assert len(said) < len(str(path)) + 2 * MAX_NAME + 100


def test_a_title_is_escaped_and_cut_in_text_and_whole_in_json(evogs, tmp_path):
    title = ESCAPES + "x" * 60_000
    (tmp_path / "x.evogs").write_bytes(stream_of({"title": title, "author": "Zoë"}))
    code, out, _ = evogs("info", tmp_path / "x.evogs")
    assert code == 0
    assert plain(out)
    assert "Zoë" in out
    assert max(map(len, out.splitlines())) < MAX_NAME + 30
    code, out, _ = evogs("info", tmp_path / "x.evogs", "--json")
    assert plain(out)
    assert json.loads(out)["scene"]["title"] == title


def test_metadata_of_any_size_makes_a_ply_that_is_read_again(evogs, tmp_path):
    text = {f"key.{number}": "漢" * 3000 for number in range(200)}
    (tmp_path / "x.evogs").write_bytes(stream_of(text))
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "x.ply")[0] == 0
    assert len(read_ply(tmp_path / "x.ply")) == 5


def test_a_name_of_a_chunk_is_escaped(refused, tmp_path):
    from tests.support.damage import repaired

    data = bytearray(stream_of({}))
    data[64:68] = b"\x1b[2J"
    (tmp_path / "x.evogs").write_bytes(repaired(bytes(data)))
    assert plain(refused("validate", tmp_path / "x.evogs"))


# --- names of files ------------------------------------------------------------------------------

NAMES = {
    "escapes": f"a{ESCAPES}b".encode(),
    "line break": b"a\nevogs: all is well\nb",
    "no UTF-8": b"a\xff\xfeb",
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_of_a_file_is_escaped_where_it_is_printed(name, evogs, refused, tmp_path):
    source = tmp_path / os.fsdecode(NAMES[name] + b".ply")
    refused("encode", source, tmp_path / "x.evogs", words=["No such file"])
    write_ply(source, make_scene(5))
    target = tmp_path / os.fsdecode(NAMES[name] + b".evogs")
    for command in (["encode", source, target], ["validate", target], ["lift", source, target]):
        code, out, err = evogs(*command)
        assert plain(out)
        assert plain(err)
        assert (out + err).isascii()
        assert code == (command[0] == "lift"), err
    assert evogs("validate", source)[0] == 1


@pytest.mark.thorough
@pytest.mark.parametrize(
    "encoding",
    [
        "ascii",
        pytest.param("utf-8", marks=pytest.mark.thorough),
        pytest.param("cp1252", marks=pytest.mark.thorough),
    ],
)
def test_an_output_without_the_characters_of_a_name_is_no_failure(encoding, tmp_path):
    source = tmp_path / os.fsdecode(b"\xff\xe2\x98\x95.evogs")
    source.write_bytes(stream_of({"title": "日本 ☕"}))
    folder = tmp_path / "folder"
    folder.mkdir()
    for command in (["info", source], ["validate", source], ["extract", source, source.name]):
        done = subprocess.run(
            [sys.executable, "-m", "evogs_codec.cli.commands", *command],
            env=os.environ | {"PYTHONIOENCODING": encoding},
            cwd=folder,
            capture_output=True,
            check=False,
            timeout=60,
        )
        assert (done.returncode, done.stderr) == (0, b"")
        assert done.stdout.decode(encoding).splitlines()


def test_a_long_message_keeps_its_path_and_its_end(refused, tmp_path):
    folder = tmp_path
    for _ in range(12):
        folder = folder / ("d" * 200)
    folder.mkdir(parents=True)
    scene = make_scene(5)
    means = np.full((5, 3), np.nan)
    write_ply(folder / "x.ply", scene.take(np.arange(0)))
    write_ply(folder / "x.ply", type(scene)(means, *list(vars(scene).values())[1:]))
    said = refused("encode", folder / "x.ply", tmp_path / "out", words=["--drop-invalid"])
    assert len(said) < MAX_LINE + 20
    assert said.startswith(f"evogs: {tmp_path}")
