"""Dumps (spec 7.7): where one differs first from the golden one, in the words of the spec."""

from __future__ import annotations

import math
import struct
from array import array
from dataclasses import dataclass

__all__ = ["DumpError", "Tile", "channel_name", "difference", "tiles_of"]

HEADER = struct.Struct("<4sBB5bBI")
HEADER_FIELDS = (
    *("magic", "version", "sh_degree"),
    *(f"grid_exponents[{group}]" for group in range(5)),
    *("reserved", "n_tiles"),
)
TILE = struct.Struct("<3qI")
NAMES = (
    *("position x", "position y", "position z"),
    *("rotation w", "rotation x", "rotation y", "rotation z"),
    *("scale x", "scale y", "scale z", "opacity"),
)


class DumpError(Exception):
    """The bytes are not a dump."""


@dataclass(frozen=True)
class Tile:
    """A tile of a dump: origin, live bytes, and the integers of each channel."""

    origin: tuple[int, ...]
    live: bytes
    channels: tuple[array[int], ...]


def difference(found: bytes, golden: bytes) -> str:
    """The first difference, in one line; "" if there is none."""
    if found == golden:
        return ""
    if not found:
        return "the dump is empty"
    if len(found) < HEADER.size:
        return f"the dump has {len(found)} bytes: not even a dump header"
    for name, value, right in zip(
        HEADER_FIELDS, HEADER.unpack_from(found), HEADER.unpack_from(golden), strict=True
    ):
        if value != right:
            return f"dump header: {name} is {_show(value)}, not {_show(right)}"
    rights = tiles_of(golden)
    try:
        tiles, rest = _tiles(found)
    except DumpError as error:
        return _difference_of_a_part(found, golden) or str(error)
    for number, (tile, right_tile) in enumerate(zip(tiles, rights, strict=True)):
        text = _difference_of_tiles(tile, right_tile)
        if text:
            return f"tile {number}{text}"
    return f"{rest} bytes follow the dump"


def tiles_of(dump: bytes) -> list[Tile]:
    """The tiles of a dump, which must be whole.

    Raises:
        DumpError: it is not.
    """
    if len(dump) < HEADER.size or dump[:4] != b"EVGD":
        raise DumpError("no dump header")
    tiles, rest = _tiles(dump)
    if rest:
        raise DumpError(f"{rest} bytes follow the dump")
    return tiles


def channel_name(channel: int) -> str:
    """A channel (spec 3.2) in words."""
    if channel < len(NAMES):
        return NAMES[channel]
    coefficient, colour = divmod(channel - len(NAMES), 3)
    return f"SH {coefficient} {'RGB'[colour]} (band {math.isqrt(coefficient)})"


def _tiles(dump: bytes) -> tuple[list[Tile], int]:
    """The tiles, and how many bytes follow them."""
    _, _, sh_degree, *_, n_tiles = HEADER.unpack_from(dump)
    n_channels = len(NAMES) + 3 * (sh_degree + 1) ** 2
    tiles, at = list[Tile](), HEADER.size
    for number in range(n_tiles):
        if len(dump) - at < TILE.size:
            raise DumpError(f"the dump ends at byte {len(dump)}, in the head of tile {number}")
        *origin, n_slots = TILE.unpack_from(dump, at)
        at += TILE.size
        end = at + n_slots * (1 + 4 * n_channels)
        if len(dump) < end:
            raise DumpError(
                f"the dump ends at byte {len(dump)}, in tile {number} of {n_slots} slots"
                f" and {n_channels} channels, which ends at byte {end}"
            )
        live, at = dump[at : at + n_slots], at + n_slots
        channels = []
        for _ in range(n_channels):
            channels.append(_integers(dump[at : at + 4 * n_slots]))
            at += 4 * n_slots
        tiles.append(Tile(tuple(origin), live, tuple(channels)))
    return tiles, len(dump) - at


def _integers(raw: bytes) -> array[int]:
    values = array("i")
    values.frombytes(raw)
    if struct.pack("=I", 1) != struct.pack("<I", 1):
        values.byteswap()
    return values


def _difference_of_tiles(tile: Tile, right: Tile) -> str:
    if tile.origin != right.origin:
        return f": origin {tile.origin}, not {right.origin}"
    if len(tile.live) != len(right.live):
        return f": {len(tile.live)} slots, not {len(right.live)}"
    for slot, (live, right_live) in enumerate(zip(tile.live, right.live, strict=True)):
        if live != right_live:
            return f", slot {slot}: the live byte is {live}, not {right_live}"
    for channel, (values, rights) in enumerate(zip(tile.channels, right.channels, strict=True)):
        if values != rights:
            pairs = enumerate(zip(values, rights, strict=True))
            slot, value, wanted = next((i, a, b) for i, (a, b) in pairs if a != b)
            name = f"channel {channel} {channel_name(channel)}"
            return f", slot {slot}, {name}: {value}, not {wanted}{_pattern(tile, right)}"
    return ""


def _pattern(tile: Tile, right: Tile) -> str:
    """What a whole tile of wrong integers looks like, if it is a usual mistake."""
    found = [value for channel in tile.channels for value in channel]
    wanted = [value for channel in right.channels for value in channel]
    n, d = len(right.live), len(right.channels)
    swapped = array("i", wanted)
    swapped.byteswap()
    if found == list(swapped):
        return " (all integers are big-endian)"
    if found == [wanted[c * n + s] for s in range(n) for c in range(d)]:
        return " (the integers stand slot by slot, not channel by channel)"
    if sorted(found) == sorted(wanted):
        return " (the right integers in another order)"
    n_wrong = sum(a != b for a, b in zip(found, wanted, strict=True))
    return f" ({n_wrong} of {len(wanted)} integers of the tile are wrong)"


def _difference_of_a_part(found: bytes, golden: bytes) -> str:
    """For a dump cut short whose bytes are right as far as they go."""
    if golden.startswith(found):
        return f"the dump ends early: {len(found)} bytes of {len(golden)}, right as far as they go"
    return ""


def _show(value: object) -> str:
    return value.hex(" ") if isinstance(value, bytes) else str(value)
