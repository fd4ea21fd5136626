"""What a file is that is no scene of ours, and what to do with it: for messages."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

from evogs_codec.io.files import PICTURE, STREAM, TREE, kind_of

__all__ = ["WITHOUT_MAGIC", "hint_for_no_ply", "hint_for_zip"]

CONVERT = "`read_scene` reads it, `evogs convert` makes a .ply of it"
BEGINS = (
    (b"NGSP", f"is an .spz: {CONVERT}"),
    (b"glTF", f"is a .glb: {CONVERT}"),
    (b"\xff\xd8\xff", "is a JPEG, not a scene: give a 3DGS .ply"),
    (b"version https://git-lfs", "is a pointer of Git LFS: get the file with `git lfs pull`"),
)
WITHOUT_MAGIC = (".splat", ".ksplat")  # told by their names alone
PAGES = (b"<!doctype html", b"<html")


def hint_for_no_ply(start: bytes, path: Path) -> str:
    """What a file that begins with these bytes seems to be, and what to do.

    Args:
        start: its first bytes; all of them if they are few.
        path: its name counts where its bytes say nothing.
    """
    if not start:
        return "is empty; expected a 3DGS .ply, or another scene"
    if not any(start):
        return "has only zeros, as of an interrupted copy or download: get the file again"
    kind = kind_of(start)
    if kind is STREAM:
        return f"is an EvoGS stream: `evogs decode {path} OUT.ply` makes a .ply of it"
    if kind is TREE:
        return hint_for_zip(path) or "is a zip, not a scene: give a 3DGS .ply"
    if kind is PICTURE:
        return "is a PNG, not a scene: give a 3DGS .ply"
    for begin, hint in BEGINS:
        if start.startswith(begin):
            return hint
    if start.startswith(b"\x1f\x8b"):
        return _hint_for_gzip(start)
    if start[:100].lstrip().lower().startswith(PAGES):
        return "is a web page, as where a download needs a login: get the file itself"
    if path.suffix.lower() in WITHOUT_MAGIC:
        return f"seems to be a {path.suffix.lower()}: {CONVERT}"
    return (
        "does not start with the line 'ply'; expected a 3DGS .ply, .spz, .sog or glTF by its bytes,"
        " or a .splat or .ksplat by its name"
    )


def hint_for_zip(path: Path) -> str:
    """What a zip is that is no `.tree.npz`, and what to do; empty if nothing is known of it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except Exception:  # whatever `zipfile` raises, it could not read it
        return ""
    if "meta.json" in names:
        return f"is a .sog: {CONVERT}"
    if any(name.lower().endswith(".ply") for name in names):
        return "is a zip with a .ply in it: unpack it first"
    return ""


def _hint_for_gzip(start: bytes) -> str:
    try:
        inside = zlib.decompressobj(wbits=31).decompress(start, 16)
    except zlib.error:
        inside = b""
    if inside.startswith(b"NGSP"):
        return f"is an .spz: {CONVERT}"
    return "is compressed with gzip: unpack it first"
