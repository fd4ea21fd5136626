"""The tables in the bodies of chunks, each checked as it is read (spec 5.3 to 5.5, 5.7, 5.8).

The packet table has a module of its own, `packet_table`.
"""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import layout
from evogs_codec.model.arithmetic import MAX_X, AlphaTable, Quantiser
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I64

__all__ = [
    "is_key",
    "read_alpha_tables",
    "read_digests",
    "read_metadata",
    "read_quantisers",
    "read_rows",
    "read_tiles",
]

MAX_ORIGIN = 1 << 52  # R-5.5-1
_KEY = re.compile(rb"[a-z0-9_.-]{1,255}\Z")


def read_rows(
    struct: layout.Struct, body: memoryview, offset: int, n: int | None
) -> npt.NDArray[np.void]:
    """The rows of a chunk; their number follows from the size if `n` is None (R-5.2-5)."""
    size = layout.size_of(struct)
    if len(body) % size if n is None else len(body) != n * size:
        raise StreamError(
            Fault.E_CHUNK, f"{len(body)} bytes do not make the rows of {size} bytes", offset
        )
    return layout.read_table(struct, body)


def read_quantisers(
    body: memoryview, offset: int, n_levels: int, classes: int
) -> tuple[tuple[Quantiser, ...], ...]:
    """[0] of adds, [1 + level] of psi: a quantiser per class (spec 5.3)."""
    rows = read_rows(layout.QUANTISER_ENTRY, body, offset, (1 + n_levels) * classes)
    if rows.size and (rows["mantissa"].min() < 1 or rows["shift"].max() > 24):
        raise StreamError(Fault.E_STEP, "a mantissa is 0 or a shift exceeds 24", offset)
    flat = [Quantiser(int(row["mantissa"]), int(row["shift"])) for row in rows]
    return tuple(tuple(flat[k : k + classes]) for k in range(0, len(flat), classes))


def read_alpha_tables(
    body: memoryview, offset: int, n_levels: int
) -> dict[tuple[int, int], AlphaTable]:
    """{(level, group): table} (spec 5.4)."""
    tables: dict[tuple[int, int], AlphaTable] = {}
    fixed = layout.size_of(layout.ALPHA_TABLE)
    at, last = 0, (-1, -1)
    while at < len(body):
        if len(body) - at < fixed:
            raise StreamError(Fault.E_CHUNK, "an alpha table is cut short", offset)
        fields = layout.parse(layout.ALPHA_TABLE, body[at:], offset)
        key = (fields["level"], fields["group"])
        if key[0] >= n_levels or key[1] >= N_GROUPS or fields["shift"] > 12 or key <= last:
            raise StreamError(Fault.E_ALPHA, f"alpha table of (level, group) {key}", offset)
        at += fixed
        size = 2 * (fields["last"] + 1)
        if len(body) - at < size:
            raise StreamError(Fault.E_CHUNK, "an alpha table is cut short", offset)
        entries = np.frombuffer(body[at : at + size], "<i2")
        tables[key] = AlphaTable(fields["shift"], tuple(int(a) for a in entries))
        at, last = at + size, key
    return tables


def read_tiles(body: memoryview, offset: int, n_tiles: int) -> npt.NDArray[np.void]:
    """Rows of the tile table (spec 5.5)."""
    tiles = read_rows(layout.TILE_ENTRY, body, offset, n_tiles)
    low, high = tiles["box_min"], tiles["box_max"]
    bad = (tiles["origin"] < -MAX_ORIGIN) | (tiles["origin"] > MAX_ORIGIN)
    bad |= (low < -MAX_X) | (high > MAX_X) | (low > high)
    if bad.any():
        row = int(np.flatnonzero(bad.any(1))[0])
        raise StreamError(Fault.E_TILE, f"origin or box of tile {row}", offset)
    return tiles


def read_digests(
    body: memoryview, offset: int, packets: npt.NDArray[np.void], steps: I64, sizes: I64, most: int
) -> dict[PacketId, bytes]:
    """{(tile, component, step): SHA-256} (spec 5.7).

    Args:
        body: of the chunk.
        offset: of the chunk in the file.
        packets: rows of the packet table.
        steps: (n,) of these.
        sizes: (n,) bytes of the state after each.
        most: bytes of all states that rows may name.
    """
    rows = read_rows(layout.DIGEST_ENTRY, body, offset, None)
    keys = zip(packets["tile"].tolist(), packets["component"].tolist(), steps.tolist(), strict=True)
    size_of_state = dict(zip(map(PacketId._make, keys), sizes.tolist(), strict=True))
    digests: dict[PacketId, bytes] = {}
    last, n_bytes = PacketId(-1, -1, -1), 0
    for row in rows:
        key = PacketId(int(row["tile"]), int(row["component"]), int(row["step"]))
        if key <= last or key not in size_of_state:  # R-5.7-1, R-5.7-2
            raise StreamError(Fault.E_CHUNK, f"digest of (tile, component, step) {key}", offset)
        n_bytes += size_of_state[key]
        if n_bytes > most:  # R-5.7-5
            detail = f"digests name more than {most} bytes of state"
            raise StreamError(Fault.E_AMPLIFICATION, detail, offset, section="5.7")
        digests[key] = row["digest"].tobytes()
        last = key
    return digests


def read_metadata(body: memoryview, offset: int) -> dict[str, str]:
    """{key: value} (spec 5.8)."""
    text: dict[str, str] = {}
    fixed = layout.size_of(layout.META_ENTRY)
    at, last = 0, b""
    while at < len(body):
        if len(body) - at < fixed:
            raise StreamError(Fault.E_META, "an entry reaches past the chunk", offset)
        fields = layout.parse(layout.META_ENTRY, body[at:], offset)
        split = at + fixed + fields["key_size"]
        end = split + fields["value_size"]
        if end > len(body):
            raise StreamError(Fault.E_META, "an entry reaches past the chunk", offset)
        key = bytes(body[at + fixed : split])
        if not is_key(key) or key <= last:
            raise StreamError(Fault.E_META, "a key is not valid or out of order", offset)
        try:
            text[key.decode("ascii")] = bytes(body[split:end]).decode("utf-8")
        except UnicodeDecodeError:
            raise StreamError(
                Fault.E_META, f"the value of {key.decode('ascii')} is not UTF-8", offset
            ) from None
        at, last = end, key
    return text


def is_key(key: bytes) -> bool:
    """A metadata key is 1 to 255 of a..z 0..9 _ . - (R-5.8-2)."""
    return _KEY.match(key) is not None
