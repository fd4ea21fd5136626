"""Types of arguments of the command line: sizes."""

import argparse

import pytest

from evogs_codec.cli.argument_types import parse_size

WHOLE = 1000


@pytest.mark.parametrize(
    ("text", "n_bytes"),
    [
        ("0", 0),
        ("5000000", 5_000_000),
        ("9007199254740993", 2**53 + 1),
        ("5MB", 5_000_000),
        ("5 mb", 5_000_000),
        ("4.5MiB", 4_718_592),
        ("1.5 kB", 1500),
        ("2KiB", 2048),
        ("1GB", 10**9),
        ("1GiB", 1 << 30),
        ("7B", 7),
        ("20%", 200),
        ("0.15 %", 2),
        ("100%", 1000),
    ],
)
def test_a_size_is_bytes_or_a_part_of_the_file(text, n_bytes):
    assert parse_size(text).of(WHOLE) == n_bytes


@pytest.mark.parametrize(
    "text",
    ["", "MB", "-1", "5 TB", "101%", "1e6", "5%%", "nan", "inf", "9" * 20, "9" * 400, "5M B"],
)
def test_what_is_no_size_is_refused_with_examples(text):
    with pytest.raises(argparse.ArgumentTypeError, match="try 5000000, 5MB"):
        parse_size(text)


def test_a_part_of_a_stream_is_extracted(evogs, made, tmp_path):
    stream, out = made / "scene.evogs", tmp_path / "half.evogs"
    evogs("extract", stream, out, "--max-bytes", "50%")
    assert 0.3 * stream.stat().st_size < out.stat().st_size <= 0.5 * stream.stat().st_size


def test_a_target_of_no_bytes_is_refused(made, refused, tmp_path):
    options = ["--target-bytes", "0%"]
    refused("encode", made / "scene.ply", tmp_path / "a.evogs", *options, words=["at least one"])
