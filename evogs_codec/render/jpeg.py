"""JPEG files, which Pillow writes: an extra, so that a PNG needs nothing."""

from __future__ import annotations

import io
from importlib.util import find_spec
from pathlib import Path

from evogs_codec.errors import InputError
from evogs_codec.io.files import write_atomic
from evogs_codec.io.makers import comment_of
from evogs_codec.render.png import Real, bytes_of_pixels

__all__ = ["need_pillow", "write_jpeg"]

QUALITY = 92


def need_pillow(path: Path) -> None:
    """Refuse a name that cannot be written under, before the work is done.

    Raises:
        InputError: Pillow is missing.
    """
    if find_spec("PIL") is None:
        raise InputError(f"{path}: a JPEG needs Pillow: pip install pillow, or name a .png")


def write_jpeg(path: Path, image: Real, *, made_by: str = "", quality: int = QUALITY) -> None:
    """Write an (H, W, 3) picture of values 0..1, without subsampling; others are clamped.

    Args:
        path: the file to make or replace.
        image: the picture.
        made_by: the command that it names as its maker, in ASCII.
        quality: as Pillow counts it, to 95.

    Raises:
        InputError: Pillow is missing.
    """
    need_pillow(path)
    from PIL import Image

    comment = {"comment": comment_of(made_by)} if made_by else {}
    file = io.BytesIO()
    Image.fromarray(bytes_of_pixels(image)).save(
        file, "JPEG", quality=quality, subsampling=0, **comment
    )
    write_atomic(path, file.getvalue())
