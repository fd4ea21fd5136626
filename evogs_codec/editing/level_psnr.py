"""PSNR of levels in the metadata of a stream (spec 8.4), so that a player can choose a level.

It is measured where a stream is made. Whoever reads it needs the directory alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.stores.sources import Source, bytes_of

__all__ = ["KEY", "LevelPsnr", "level_psnr", "with_level_psnr", "without_level_psnr"]

KEY = "psnr"
MAX_PSNR = 99.99  # dB that are written, so that each number takes five characters
_VALUE = re.compile(r"(\d{1,3}\.\d\d(?: \d{1,3}\.\d\d)*); (.+)", re.ASCII | re.DOTALL)


@dataclass(frozen=True)
class LevelPsnr:
    """What the encoder measured.

    Attributes:
        decibels: mean PSNR of pictures of levels 0, 1, ..., each whole, against what was encoded.
        views: says what pictures, for people.
    """

    decibels: tuple[float, ...]
    views: str

    def __str__(self) -> str:
        """The value of the metadata key."""
        numbers = (f"{min(max(number, 0.0), MAX_PSNR):05.2f}" for number in self.decibels)
        return f"{' '.join(numbers)}; {self.views}"


def level_psnr(directory: Directory) -> LevelPsnr | None:
    """The PSNR of the levels of a stream; None if it does not say, or nothing that is understood.

    A part of a stream says what the whole one did: the PSNR of whole levels.
    """
    match = _VALUE.fullmatch(directory.info.text.get(KEY, ""))
    if match is None:
        return None
    decibels = tuple(float(number) for number in match[1].split(" "))
    return LevelPsnr(decibels, match[2]) if len(decibels) <= directory.n_levels else None


def with_level_psnr(data: Source, measured: LevelPsnr) -> bytes:
    """The stream with these numbers in its metadata, whatever they said before.

    Raises:
        StreamError: header or chunks are not legal.
    """
    return _with_text(data, {KEY: str(measured)})


def without_level_psnr(data: Source) -> bytes:
    """The stream without such numbers in its metadata.

    Raises:
        StreamError: header or chunks are not legal.
    """
    return _with_text(data, {})


def _with_text(data: Source, own: Mapping[str, str]) -> bytes:
    """The stream with this text for `KEY`, or none."""
    view = bytes_of(data)
    directory = read_directory(view)
    others = {key: text for key, text in directory.info.text.items() if key != KEY}
    text = {**others, **own}
    changed = replace(directory, info=replace(directory.info, text=text))
    head = rebuild_directory(changed, directory.tiles, directory.packets, directory.digests)
    return b"".join([head, view[directory.data_offset : directory.size]])
