"""Pictures as files: which kind a name asks for, and what size one has; none is decoded."""

from __future__ import annotations

import struct
from pathlib import Path

from evogs_codec.errors import InputError
from evogs_codec.io.files import JPEG, PICTURE, FileKind
from evogs_codec.io.plain_files import is_there

__all__ = ["kind_of_picture", "picture_size"]

ENDINGS = {".png": PICTURE, ".jpg": JPEG, ".jpeg": JPEG}
MAX_BEGIN = 1 << 20  # bytes from the start of a file; a photograph may begin with a large preview
SIZES = (*range(0xC0, 0xC4), *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0))


def kind_of_picture(path: Path) -> FileKind:
    """What is made under a name: as its ending says; without one, or of a device, a PNG.

    Raises:
        InputError: the ending is of no picture that is written.
    """
    is_device = path.exists() and not path.is_file() and not path.is_dir()
    if is_device or not path.suffix:
        return PICTURE
    if (kind := ENDINGS.get(path.suffix.lower())) is None:
        raise InputError(f"{path}: pictures are written as {', '.join(ENDINGS)}; name one of these")
    return kind


def picture_size(path: Path) -> tuple[int, int] | None:
    """In pixels; None if there is no file, or none that says it.

    Raises:
        InputError: what is there is no plain file, or the path cannot be looked at.
    """
    if not is_there(path, "picture"):
        return None
    try:
        with path.open("rb") as file:
            start = file.read(MAX_BEGIN)
    except OSError:
        return None
    if start[:8] == b"\x89PNG\r\n\x1a\n" and len(start) >= 24:
        width, height = struct.unpack_from(">II", start, 16)
        return width, height
    return _of_jpeg(start) if start.startswith(b"\xff\xd8") else None


def _of_jpeg(start: bytes) -> tuple[int, int] | None:
    """From the first segment that begins a frame (ITU T.81, B.2.2)."""
    at = 2
    while at + 9 <= len(start) and start[at] == 0xFF:
        kind = start[at + 1]
        if kind == 0xFF:  # fill bytes
            at += 1
            continue
        if kind in SIZES:
            height, width = struct.unpack_from(">HH", start, at + 5)
            return width, height
        at += 2 + struct.unpack_from(">H", start, at + 2)[0]
    return None
