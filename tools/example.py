"""The worked example of Annex A: a small stream, every byte of it, and what it decodes to.

`stream()` makes it; `annex()` takes it apart with the declarations that the codec parses with, so
that the annex cannot say anything else than the bytes do.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.decoding.tile_state import TileState
from evogs_codec.encoding.write import write
from evogs_codec.format import frames, layout
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.format.packet_header import PacketHeader, read_packet_header
from evogs_codec.format.planes import ABSENT, join_planes, undelta, unzigzag
from evogs_codec.model.arithmetic import AlphaTable, Quantiser
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS, N_GROUPS
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.tree import Kind

__all__ = ["annex", "stream"]

EFFORT = 19
CHANNELS = (
    *("position x", "position y", "position z"),
    *("rotation w", "rotation x", "rotation y", "rotation z"),
    *("scale x", "scale y", "scale z", "opacity", "SH 0 R", "SH 0 G", "SH 0 B"),
)
LISTS = (
    *("gaps", "kinds", *(f"alpha {group}" for group in GROUPS)),
    *(f"psi {channel}" for channel in CHANNELS),
    *(f"adds {channel}" for channel in CHANNELS),
)
N_SIDES = 2 + N_GROUPS


def stream() -> bytes:
    """Three adds; then, a level up, one of them is split, one refined, one dropped."""
    adds = np.zeros((14, 3), np.int32)
    adds[0:3] = [[-40, 75, 600], [12, 0, -9], [3, 3, -130]]
    adds[3] = 64
    adds[7:10] = [[-61, -50, -44], [-61, -58, -40], [-70, -58, -41]]
    adds[10] = [9, 20, -3]
    adds[11:14] = [[30, 5, -8], [28, 6, -9], [24, 9, -8]]
    roots = _step(0, [], [], np.zeros((N_GROUPS, 0)), np.zeros((14, 0)), adds)
    psi = np.zeros((14, 2), np.int32)
    psi[0:3] = [[7, -4], [-5, 0], [0, 2]]
    psi[7:10] = [[-6, 0], [-3, 0], [-6, 0]]
    psi[10] = [-2, 5]
    psi[11:14] = [[1, -3], [1, -2], [1, -3]]
    alpha = np.array([[1], [0], [0], [0], [0]])
    kinds = [Kind.SPLIT, Kind.REFINE, Kind.DROP]
    changes = _step(1, [0, 1, 2], kinds, alpha, psi, np.zeros((14, 0)))
    of_adds = tuple(Quantiser(*pair) for pair in ((5, 2), (1, 0), (3, 0), (1, 3), (2, 1)))
    of_psi = tuple(Quantiser(*pair) for pair in ((3, 0), (1, 0), (1, 1), (1, 2), (3, 0)))
    tile = CodedTile((10240, 0, -5), (-1000, -200, -2700), (12000, 300, 100), (roots, changes))
    tree = CodedTree(
        sh_degree=0,
        n_levels=2,
        grid_exponents=(10, 6, 5, 5, 7),
        quantisers=(of_adds, of_psi, of_psi),
        # alpha 5/4 or -1/2 for positions, -1 for scales (both children shrink), 1 for the others
        alpha={(1, 0): AlphaTable(2, (5, -2)), (1, 2): AlphaTable(0, (-1,))},
        tiles=(tile,),
        info=SceneInfo(coordinate_system=1, colour_space=1, text={"title": "Annex A"}),
    )
    return write(tree, zstd_level=EFFORT)


def _step(
    level: int,
    slots: list[int],
    kinds: list[Kind],
    alpha: np.ndarray,
    psi: np.ndarray,
    adds: np.ndarray,
) -> CodedStep:
    return CodedStep(
        level,
        np.array(slots, np.int32),
        np.array(kinds, np.uint8),
        alpha.astype(np.uint8),
        psi.astype(np.int32),
        adds.astype(np.int32),
    )


def annex(data: bytes) -> str:
    """The text of the annex between its marks."""
    rows = list(_rows(data))
    if b"".join(row.raw for row in rows if row.at >= 0) != data:
        raise ValueError("the annex does not show every byte once")
    directory = read_directory(data)
    parts = [
        f"The {len(data)} bytes of `spec/example.evogs`. Rows without an offset show the content of"
        " the frame above them, plane by plane, and the integers it holds.",
        _table(("Offset", "Bytes", "Field", "Value"), [row.cells() for row in rows]),
    ]
    n_steps = len(directory.packets)
    for n in range(1, n_steps + 1):
        decoded = decode(data, Cut(np.array([[n]])), verify=True)
        parts.append(_state(n - 1, decoded.tiles[0]))
    splat = decoded.leaves().channels()[:, -1]
    slot = int(np.flatnonzero(decoded.tiles[0].live)[-1])
    parts += [
        f"The float view of slot {slot}, `(O + X) · 2^\u2212G`:",
        _table(
            ("Group", "G", "Values"),
            [
                (group, str(exponent), ", ".join(repr(float(v)) for v in splat[part]))
                for group, exponent, part in zip(
                    GROUPS, directory.grid_exponents, GROUP_CHANNELS, strict=True
                )
            ],
        ),
        f"The digest of core after step {n_steps - 1}, as in `dGST`:"
        f" `{decoded.tiles[0].digest(0).hex()}`.",
        f"The dump of the whole file has {len(decoded.dump())} bytes and the SHA-256"
        f" `{hashlib.sha256(decoded.dump()).hexdigest()}`.",
        "`evogs conformance explain` shows any vector of the suite like this one: with SH bands,"
        " late SH, packets of size 0, several frames and tiles.",
    ]
    return "\n\n".join(parts)


@dataclass(frozen=True)
class Row:
    """Bytes of the stream, or of a plane (`at` is -1), and what they mean."""

    at: int
    raw: bytes
    field: str
    value: str

    def cells(self) -> tuple[str, str, str, str]:
        offset = str(self.at) if self.at >= 0 else ""
        return offset, f"`{self.raw.hex(' ').upper()}`" if self.raw else "", self.field, self.value


def _rows(data: bytes) -> Iterator[Row]:
    view = memoryview(data)
    directory = read_directory(view)
    yield from _fields(layout.FILE_HEADER, data, 0)
    at = layout.size_of(layout.FILE_HEADER)
    while at < directory.data_offset:
        head = layout.parse(layout.CHUNK_HEADER, view[at:], at)
        yield from _fields(layout.CHUNK_HEADER, data, at)
        at += layout.size_of(layout.CHUNK_HEADER)
        yield from _body(head["type"], data, at, at + head["size"])
        at += head["size"]
    for packet in range(len(directory.packets)):
        yield from _packet(directory, data, packet)


def _fields(struct: layout.Struct, data: bytes, at: int, prefix: str = "") -> Iterator[Row]:
    """A row per field of a structure at `at`."""
    values = layout.parse(struct, memoryview(data)[at:], at)
    table = layout.describe(struct)
    ends = [offset for offset, *_ in table[1:]] + [layout.size_of(struct)]
    for (offset, name, _, _), end in zip(table, ends, strict=True):
        raw = data[at + offset : at + end]
        yield Row(at + offset, raw, f"{prefix}`{name}`", _show(values[name]))


def _show(value: object) -> str:
    if isinstance(value, bytes):
        return f"`{value.decode('ascii')}`" if value.isalpha() else ""
    if isinstance(value, int):
        return str(value)
    return ", ".join(str(v) for v in value) if isinstance(value, Iterable) else str(value)


TABLES = {
    b"QUAN": layout.QUANTISER_ENTRY,
    b"TILE": layout.TILE_ENTRY,
    b"PACK": layout.PACKET_ENTRY,
    b"dGST": layout.DIGEST_ENTRY,
}


def _body(kind: bytes, data: bytes, at: int, end: int) -> Iterator[Row]:
    """The rows of a chunk's body."""
    number = 0
    while at < end:
        if kind in TABLES:
            struct = TABLES[kind]
            if kind == b"QUAN":
                yield _quantiser(number, data, at)
            else:
                yield from _fields(struct, data, at, f"{kind.decode()} {number}: ")
            at += layout.size_of(struct)
        elif kind == b"ALFA":
            n = 2 * (data[at + 3] + 1)
            yield from _fields(layout.ALPHA_TABLE, data, at)
            at += 4
            entries, k = np.frombuffer(data[at : at + n], "<i2").tolist(), data[at - 2]
            yield Row(at, data[at : at + n], "`a`", ", ".join(f"{a} / 2^{k}" for a in entries))
            at += n
        else:
            fields = layout.parse(layout.META_ENTRY, memoryview(data)[at:], at)
            yield from _fields(layout.META_ENTRY, data, at)
            at += layout.size_of(layout.META_ENTRY)
            for name in ("key", "value"):
                text = data[at : at + fields[f"{name}_size"]]
                yield Row(at, text, name, text.decode("utf-8"))
                at += len(text)
        number += 1


def _quantiser(number: int, data: bytes, at: int) -> Row:
    """A `QUAN` entry on one row: there are many."""
    fields = layout.parse(layout.QUANTISER_ENTRY, memoryview(data)[at:], at)
    row, kind = divmod(number, 5)
    name = f"{f'psi of level {row - 1}' if row else 'adds'}, class {kind}: `mantissa`, `shift`"
    return Row(at, data[at : at + 3], name, f"{fields['mantissa']}, {fields['shift']}")


def _packet(directory: Directory, data: bytes, packet: int) -> Iterator[Row]:
    """Header, coding bytes, frame entries, and each frame with its planes."""
    at, size = int(directory.offsets[packet]), int(directory.packets["size"][packet])
    head = read_packet_header(memoryview(data)[at : at + size], 0, directory.counts(packet), at)
    yield from _fields(layout.PACKET_HEADER, data, at, f"packet {packet}: ")
    begin = at + layout.size_of(layout.PACKET_HEADER)
    for name, first, last in (
        ("gaps, kinds, alpha", 0, N_SIDES),
        ("psi", N_SIDES, N_SIDES + 14),
        ("adds", N_SIDES + 14, N_SIDES + 28),
    ):
        raw = data[begin + first : begin + last]
        yield Row(begin + first, raw, f"coding bytes of {name}", "")
    at += head.size
    entry = layout.size_of(layout.FRAME_ENTRY)
    for k in range(len(head.frames)):
        yield from _fields(
            layout.FRAME_ENTRY, data, at - entry * (len(head.frames) - k), f"frame {k}: "
        )
    planes: list[bytes] = []
    shown = 0
    sizes = head.plane_sizes
    for k, (n_planes, frame_size) in enumerate(head.frames):
        raw = data[at : at + frame_size]
        yield Row(at, raw, f"frame {k}", f"{n_planes} planes")
        content = sizes[len(planes) : len(planes) + n_planes]
        plain = frames.decompress(memoryview(raw), sum(content), at)
        for length in content:
            planes.append(plain[:length])
            plain = plain[length:]
        rows = list(_lists(head, planes))
        yield from rows[shown:]
        shown = len(rows)
        at += frame_size


def _lists(head: PacketHeader, planes: list[bytes]) -> Iterator[Row]:
    """A row per list whose planes are all there."""
    used = 0
    for name, coding, n in zip(LISTS, head.codings, head.lengths, strict=True):
        own = planes[used : used + coding.n_planes]
        used += coding.n_planes
        if coding == ABSENT or used > len(planes):
            continue
        values = join_planes([np.frombuffer(plane, np.uint8) for plane in own], coding, n)
        shape = f"low {coding.low}, high {coding.high}{', delta' if coding.delta else ''}"
        stored = f"{shape}: {_show(values.tolist())}"
        if name.startswith(("psi", "adds")):
            q = unzigzag(values)
            q = undelta(q, 0) if coding.delta else q
            in_ycocg = "SH" in name and head.flags >> name.startswith("adds") & 1
            stored += f"; {'YCoCg' if in_ycocg else 'q'} {_show(q.tolist())}"
        yield Row(-1, b"".join(own), name, stored)


def _state(step: int, tile: TileState) -> str:
    """The slots after a step."""
    rows = []
    for slot in range(tile.n_slots):
        x = tile.x[:14, slot].tolist()
        born = int(tile.born_from[slot])
        cells = [str(slot), "yes" if tile.live[slot] else "no", str(born)]
        rows.append((*cells, *(", ".join(str(v) for v in x[part]) for part in GROUP_CHANNELS)))
    titles = ("Slot", "Live", "`born_from`", *GROUPS)
    return f"X after step {step}:\n\n{_table(titles, rows)}"


def _table(header: Iterable[str], body: Iterable[Iterable[str]]) -> str:
    titles = list(header)
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    lines += ["| " + " | ".join(cells) + " |" for cells in body]
    return "\n".join(lines)
