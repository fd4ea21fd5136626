"""The second worked example of Annex A: what the first one has no place for.

Two tiles, a palette, picks that come late, a packet of size 0, several frames, and frames of raw
and of run-length blocks. The builder of the vectors writes it, so its bytes depend on no library.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

from conformance.decoders import oracle
from conformance.generator.builder import (
    DELTA,
    DROP,
    PALETTE,
    PICKS,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    build,
    raw,
    runs,
)
from conformance.harness.reporting.anatomy import anatomy
from conformance.harness.reporting.pieces import Piece

__all__ = ["annex", "stream"]

SCALES = (7, 8, 9)  # channels
GROUPS = {
    "position": slice(0, 3),
    "rotation": slice(3, 7),
    "scale": slice(7, 10),
    "opacity": slice(10, 11),
    "SH 0": slice(11, 14),
    "SH 1": slice(14, 23),
}


def stream() -> bytes:
    """Seven packets of two tiles and the palette; the picks of the last step of tile 0 are late."""
    adds: dict[int, Sequence[int] | int] = {
        **{0: [-40, 75, 600], 1: [12, 0, -9], 2: [3, 3, -130], 3: 64},
        **{channel: [-61, -58, -40] for channel in SCALES},
        **{10: [9, 20, -3], 11: [27, 6, -9], 12: [6, -4, 0], 13: [1, -1, -1]},
    }
    roots = Packet(
        adds=adds,
        flags=2,
        frames=[5, 5, 3],
        style=_smaller,
    )
    entries = Packet(
        component=PALETTE,
        adds={0: [40, -12, 7], 1: 8, 2: 8, 3: [0, 0, -3], 8: [5, 6, 8]},
        codings={"adds 8": DELTA | 4},
        flags=2,
        style=_smaller,
    )
    adds = {0: [5, -5], 3: 64, 7: -50, 8: -50, 9: -50, 10: [30, 31], 12: [100, -100]}
    other = Packet(
        tile=1,
        adds=adds,
        frames=[2, 3, 2],
        style=_smaller,
    )
    changes = Packet(
        level=1,
        records={0: SPLIT, 1: REFINE, 2: DROP},
        psi={0: [7, -4], 1: [-5, 0], 7: [-6, 0], 10: [-2, 5], 11: [1, -3]},
        adds={0: [90], 3: [64], 7: [-70], 8: [-70], 9: [-70], 10: [12]},
        alpha={0: [1]},
        style=_smaller,
    )
    return build(
        Stream(
            [
                roots,
                entries,
                Packet(component=PICKS, picks=[2, 0, 3], style=_smaller),
                other,
                Packet(tile=1, component=PICKS),  # of size 0: both picks are 0
                Packet(component=PALETTE, level=1, adds={4: [-20]}, style=_smaller),
                changes,
            ],
            degree=1,
            has_palette=True,
            n_levels=2,
            grid=(10, 6, 5, 5, 7),
            tiles=(
                Tile((10240, 0, -5), (-1000, -200, -2700), (12000, 300, 100)),
                Tile((0, 4096, 0), (-200, -200, -200), (200, 200, 200)),
            ),
            quantisers={(0, 0): (5, 2), (0, 4): (2, 1), (0, 5): (3, 0), (1, 0): (3, 0)}
            | {(2, 0): (3, 0), (2, 4): (3, 0)},
            alphas={(1, 0): (2, [5, -2])},
            digests={(0, PICKS, 0): None, (0, PALETTE, 1): None},
        )
    )


def _smaller(content: bytes) -> bytes:
    """A frame of one raw block, or of run-length blocks if that is smaller."""
    return min(raw(content), runs(content), key=len)


def annex(data: bytes) -> str:
    """The text of the annex between its marks."""
    scene = oracle.decode(data, check_digests=True)
    dump = scene.dump()
    parts = [
        f"The {len(data)} bytes of `spec/example-2.evogs`.",
        _table(("Offset", "Bytes", "Field", "Value"), map(_row, anatomy(data))),
        "The entries of the palette, and their numbers on the grid of SH:",
        _table(
            ("Entry", "SH 1"),
            [
                (str(1 + k), ", ".join(map(str, entry)))
                for k, entry in enumerate(zip(*scene.palette, strict=True))
            ],
        ),
    ]
    for number, tile in enumerate(scene.tiles):
        parts += [f"X of tile {number}, as shown:", _state(tile)]
    parts += [
        "Slot 3 of tile 0 was split from slot 0 in a step whose picks have not come: it shows the"
        " SH of slot 0. Slot 4 was added in that step: its SH are 0 (7.5).",
        f"The dump of the whole file has {len(dump)} bytes and the SHA-256"
        f" `{hashlib.sha256(dump).hexdigest()}`:",
        "\n".join(["```", *_hex(dump), "```"]),
    ]
    return "\n\n".join(parts)


def _row(piece: Piece) -> tuple[str, str, str, str]:
    return str(piece.at), f"`{piece.raw.hex(' ').upper()}`", piece.name, piece.value


def _state(tile: oracle.Tile) -> str:
    """The slots after the last step."""
    rows = []
    for slot in range(tile.n_slots):
        x = [channel[slot] for channel in tile.channels]
        born = tile.born_from[slot]
        cells = [str(slot), "yes" if tile.live[slot] else "no", str(-1 if born is None else born)]
        rows.append((*cells, *(", ".join(map(str, x[part])) for part in GROUPS.values())))
    return _table(("Slot", "Live", "`born_from`", *GROUPS), rows)


def _hex(data: bytes) -> list[str]:
    """Lines of an offset and up to 16 bytes."""
    return [f"{at:04X}  {data[at : at + 16].hex(' ').upper()}" for at in range(0, len(data), 16)]


def _table(header: Sequence[str], body: Iterable[Iterable[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cells) + " |" for cells in body]
    return "\n".join(lines)
