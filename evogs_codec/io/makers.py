"""Which command made a file: files that a command writes name it.

A `.ply` and a JPEG have a comment, a `.glb` and a page their `generator`, a `.tree.npz` an array
`made_by`, a PNG a text chunk `Software`, a stream its metadata. Files of others name nothing, or
something else.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

from evogs_codec.errors import InputError, StreamError
from evogs_codec.format.directory import HEADER_SIZE, read_directory, read_header
from evogs_codec.io.safe_npz import Npz

__all__ = [
    "MADE_BY",
    "SOFTWARE",
    "comment_of",
    "encoded_stream",
    "generator_of",
    "marked_gltf",
    "marked_jpeg",
    "marked_page",
    "marked_picture",
    "marked_scene",
    "marked_tree",
]

MADE_BY = "made_by"  # of a `.tree.npz`
SOFTWARE = b"tEXt"  # of a PNG: its keyword is Software
OLD_MARKS = {  # of a `.ply` from before files named commands
    "evogs decode": b"comment generator: evogs ",
    "python -m evogs_codec.render.demo_scene": b"comment procedural scene of evogs",
}
MAX_MARK = 1 << 20  # bytes from the start of a file that a mark is looked for in


def comment_of(command: str) -> str:
    """The comment of a `.ply` that a command makes."""
    return f"made by {command}"


def marked_scene(path: Path, command: str) -> bool:
    """Whether the header of a `.ply` names the command."""
    with path.open("rb") as file:
        lines = file.read(MAX_MARK).partition(b"\nend_header")[0].split(b"\n")
    if f"comment {comment_of(command)}".encode() in lines:
        return True
    old = OLD_MARKS.get(command)
    return old is not None and any(line.startswith(old) for line in lines)


def marked_gltf(path: Path, command: str) -> bool:
    """Whether the JSON of a `.glb` or `.gltf`, which begins with its asset, names the command."""
    with path.open("rb") as file:
        start = file.read(1 << 12)
    text = start[20:] if start.startswith(b"glTF") else start
    return text.startswith(b'{"asset":') and f'"{comment_of(command)}"'.encode() in start


def marked_tree(path: Path, command: str) -> bool:
    """Whether a `.tree.npz` names the command."""
    try:
        with Npz(path) as npz:
            return npz.text(MADE_BY) == command
    except InputError:
        return False


def marked_picture(path: Path, command: str) -> bool:
    """Whether a PNG names the command."""
    wanted = b"Software\0" + command.encode()
    with path.open("rb") as file:
        start = file.read(MAX_MARK)
    at = 8
    while at + 8 <= len(start):
        (size,) = struct.unpack_from(">I", start, at)
        kind, body = start[at + 4 : at + 8], start[at + 8 : at + 8 + size]
        if (kind, body) == (SOFTWARE, wanted):
            return True
        at += 12 + size
    return False


def marked_jpeg(path: Path, command: str) -> bool:
    """Whether a comment of a JPEG, near its beginning, names the command."""
    body = comment_of(command).encode()
    with path.open("rb") as file:
        return b"\xff\xfe" + struct.pack(">H", 2 + len(body)) + body in file.read(1 << 12)


def marked_page(path: Path, command: str) -> bool:
    """Whether a page names the command as its generator."""
    with path.open("rb") as file:
        return generator_of(command).encode() in file.read(1 << 12)


def generator_of(command: str) -> str:
    """The line of a page that says which command made it; commands have no character to escape."""
    return f'<meta name="generator" content="{comment_of(command)}">'


def encoded_stream(path: Path, _command: str) -> bool:
    """Whether this encoder made a stream; `evogs extract` leaves the name of the encoder in it."""
    try:
        with path.open("rb") as file:
            head = file.read(HEADER_SIZE)
            head += file.read(read_header(memoryview(head))["chunks_size"])
        text = read_directory(memoryview(head)).info.text
    except StreamError:
        return False
    return re.match(r"evogs\b", text.get("generator", "")) is not None
