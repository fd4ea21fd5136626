"""Files whose end is missing, by the command line: what is there is taken, and said."""

import json
import shutil

import numpy as np
import pytest

from evogs_codec import decode_prefix, read_directory, read_ply
from evogs_codec.render import cameras_around, render
from evogs_codec.render.png import write_png

PIXELS = 16
SIZE = ["--size", PIXELS]


@pytest.fixture
def half(made, tmp_path):
    """The first half of the stream: 4 of its 5 levels, and no late SH."""
    data = (made / "scene.evogs").read_bytes()
    path = tmp_path / "half.evogs"
    path.write_bytes(data[: len(data) // 2])
    return path


@pytest.fixture
def without_splats(made, tmp_path):
    """The header, the directory and one byte."""
    data = (made / "scene.evogs").read_bytes()
    path = tmp_path / "nothing.evogs"
    path.write_bytes(data[: read_directory(data).data_offset + 1])
    return path


def said_of(path, made):
    size, whole = path.stat().st_size, (made / "scene.evogs").stat().st_size
    return f"from {size:,} of {whole:,} bytes (50.0 %) with 4 of 5 levels (SH in part)"


def test_a_part_is_decoded_and_its_size_and_levels_are_said(half, evogs, made, tmp_path):
    code, out, err = evogs("decode", half, tmp_path / "half.ply", "--partial")
    assert (code, err) == (0, "")
    splats = read_ply(tmp_path / "half.ply")
    part = decode_prefix(half).leaves()
    assert np.array_equal(splats.channels(), part.channels())
    said = f"{len(splats):,} splats, SH degree 0, {said_of(half, made)}"
    assert out == f"{tmp_path / 'half.ply'}: {said}\n"


def test_a_part_is_rendered_as_its_splats_are(half, evogs, made, tmp_path):
    words = ("--partial", *SIZE, "--view", 0)
    code, out, err = evogs("render", half, tmp_path / "half.png", *words)
    assert (code, err) == (0, "")
    splats = decode_prefix(half).leaves()
    white = render(splats, cameras_around(splats, "z", PIXELS)[0], (1.0, 1.0, 1.0))
    write_png(tmp_path / "expected.png", white, made_by="evogs render")
    assert (tmp_path / "half.png").read_bytes() == (tmp_path / "expected.png").read_bytes()
    assert out.endswith(f"{len(splats):,} splats, 1 view, {said_of(half, made)}\n")


def test_a_sheet_of_a_part_has_the_levels_that_are_there(half, evogs, made, tmp_path, monkeypatch):
    rows = []

    def contact_sheet(_pictures, labels):
        rows.extend(labels)
        return np.zeros((2, 2, 3))

    monkeypatch.setattr("evogs_codec.render.png.contact_sheet", contact_sheet)
    sheet = ["render", half, tmp_path / "sheet.png", "--sheet", "--partial", *SIZE]
    code, out, _ = evogs(*sheet, "--reference", made / "scene.ply")
    assert (code, [row.split(":")[0] for row in rows]) == (
        0,
        ["level 0", "level 1", "level 2", "level 3", "reference"],
    )
    assert said_of(half, made) in out


def test_a_part_has_a_psnr(half, evogs, made):
    code, out, err = evogs("psnr", half, made / "scene.ply", "--partial", *SIZE)
    assert (code, err) == (0, "")
    assert out.endswith(f" over 24 views, {said_of(half, made)}\n")


def test_a_reference_that_is_a_part_is_named_and_refused(half, refused, made):
    words = [half, "E_TRUNCATED", "the reference must be whole"]
    refused("psnr", made / "scene.evogs", half, "--partial", *SIZE, words=words)


def test_without_the_option_a_part_is_refused_with_a_hint(half, refused, made, tmp_path):
    words = [half, "E_TRUNCATED", "--partial takes what is there"]
    refused("decode", half, tmp_path / "x.ply", words=words)
    refused("render", half, tmp_path / "x.png", *SIZE, words=words)
    refused("render", half, tmp_path / "x.png", "--sheet", *SIZE, words=words)
    refused("psnr", half, made / "scene.ply", *SIZE, words=words)
    assert [path.name for path in tmp_path.iterdir()] == ["half.evogs"]


@pytest.mark.parametrize("command", ["decode", "render", "sheet", "psnr"])
def test_a_part_without_splats_is_refused_and_the_bytes_needed_are_said(
    command, without_splats, refused, evogs, made, tmp_path
):
    target = tmp_path / "out"
    options = {
        "decode": ["decode", without_splats, target],
        "render": ["render", without_splats, target],
        "sheet": ["render", without_splats, target, "--sheet"],
        "psnr": ["psnr", without_splats, made / "scene.ply"],
    }[command]
    said = refused(*options, "--partial", words=[without_splats, "no splat is there yet"])
    assert not target.exists()
    needed = int(said.split("first splats need ")[1].split(" ")[0].replace(",", ""))
    data = (made / "scene.evogs").read_bytes()
    without_splats.write_bytes(data[: needed - 1])
    refused("decode", without_splats, target, "--partial", words=[f"{needed - 1:,} are there"])
    without_splats.write_bytes(data[:needed])
    assert evogs("decode", without_splats, target, "--partial")[0] == 0
    assert len(read_ply(target)) > 0


@pytest.mark.parametrize("n_bytes", [0, 10, 64, 100])
def test_a_part_without_its_directory_is_refused_and_the_bytes_needed_are_said(
    n_bytes, refused, made, tmp_path
):
    data = (made / "scene.evogs").read_bytes()
    (tmp_path / "x.evogs").write_bytes(data[:n_bytes])
    needed = f"{read_directory(data).data_offset:,} bytes" if n_bytes >= 64 else "64 bytes"
    for command in (["decode"], ["decode", "--partial"], ["render"], ["info"]):
        target = [] if command[0] == "info" else [tmp_path / "out"]
        refused(*command, tmp_path / "x.evogs", *target, words=["E_TRUNCATED", needed])
    assert not (tmp_path / "out").exists()


def test_a_whole_file_is_a_part_of_all_of_it(evogs, made, tmp_path):
    stream = made / "scene.evogs"
    code, out, _ = evogs("decode", stream, tmp_path / "part.ply", "--partial")
    assert code == 0
    assert out.endswith("bytes (100.0 %) with 5 of 5 levels\n")
    evogs("decode", stream, tmp_path / "whole.ply")
    assert (tmp_path / "part.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_info_marks_the_levels_of_a_part(half, evogs, made):
    code, out, _ = evogs("info", half)
    assert code == 0
    rows = [line.split("  ")[-1] for line in out.splitlines()[-5:]]
    assert rows == ["in part: all splats, not all SH"] * 4 + ["missing"]
    levels = json.loads(evogs("info", half, "--json")[1])["levels"]
    assert [level["presence"] for level in levels] == ["in part"] * 4 + ["missing"]
    assert [level["has_all_splats"] for level in levels] == [True] * 4 + [False]
    levels = json.loads(evogs("info", made / "scene.evogs", "--json")[1])["levels"]
    assert {level["presence"] for level in levels} == {"present"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "5 of 5 levels, 3,000 of 3,000 splats, SH degree 3 of 3, "),
        (["--level", 2], "3 of 5 levels, 768 of 3,000 splats, SH degree 3 of 3, "),
        (["--sh-degree", 1], "5 of 5 levels, 3,000 of 3,000 splats, SH degree 1 of 3, "),
        (["--level", 0, "--sh-degree", 0], "1 of 5 levels, 198 of 3,000 splats, SH degree 0 of 3"),
        (["--max-bytes", 30_000], "4 of 5 levels (SH in part), 1,516 of 3,000 splats, SH degree 0"),
        (["--max-bytes", 6_000], "1 of 5 levels (SH in part), 198 of 3,000 splats, SH degree 0"),
    ],
)
def test_extract_says_what_it_keeps(options, said, evogs, made, tmp_path):
    code, out, _ = evogs("extract", made / "scene.evogs", tmp_path / "x.evogs", *options)
    size = (tmp_path / "x.evogs").stat().st_size
    whole = (made / "scene.evogs").stat().st_size
    assert code == 0
    assert out.startswith(f"{tmp_path / 'x.evogs'}: {said}")
    assert out.endswith(f", {size:,} of {whole:,} bytes\n")


@pytest.mark.thorough
def test_a_part_of_an_extraction_by_level_is_said_to_be_one(evogs, made, tmp_path):
    shutil.copy(made / "scene.ply", tmp_path / "scene.ply")
    tiles = tmp_path / "tiles.evogs"
    options = ["--tiles", 8, "--levels", 5, "--preset", "scene"]
    assert evogs("encode", tmp_path / "scene.ply", tiles, *options)[0] == 0
    target = tmp_path / "x.evogs"
    out = evogs("extract", tiles, target, "--box", *[-1e9] * 3, *[1e9] * 3, "--level", 1)[1]
    assert "2 of 5 levels, " in out
    out = evogs("extract", tiles, target, "--max-bytes", tiles.stat().st_size // 20)[1]
    assert "0 of 5 levels, part of level 0, " in out
