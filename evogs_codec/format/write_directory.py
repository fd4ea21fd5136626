"""Header and chunks as bytes; the inverse of `directory` (spec 5.1 to 5.8)."""

from __future__ import annotations

import zlib
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from evogs_codec._generated.limits import LIMITS
from evogs_codec.format import layout
from evogs_codec.format.chunks import is_key
from evogs_codec.format.directory import FLAG_ANTIALIASED, Directory
from evogs_codec.format.packet_header import FLAG_PALETTE
from evogs_codec.model.arithmetic import AlphaTable, Quantiser
from evogs_codec.model.components import PALETTE
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.scene_info import SceneInfo

__all__ = ["MAX_LEVELS", "build_directory", "rebuild_directory"]

MAX_LEVELS = LIMITS["n_levels"][-1]  # of any tier


def build_directory(
    *,
    sh_degree: int,
    n_levels: int,
    grid_exponents: tuple[int, ...],
    info: SceneInfo,
    quantisers: tuple[tuple[Quantiser, ...], ...],
    alpha: Mapping[tuple[int, int], AlphaTable],
    tiles: npt.NDArray[np.void],
    packets: npt.NDArray[np.void],
    digests: Mapping[PacketId, bytes],
    has_palette: bool = False,
    copied_chunks: bytes = b"",
    version_minor: int = layout.VERSION[1],
    unused_flags: int = 0,
) -> bytes:
    """Header and chunks; the inverse of `read_directory`. The tier is the lowest that fits.

    Raises:
        ValueError: the scene exceeds the limits of tier 3, or a metadata key is not valid.
    """
    flat = [quantiser for row in quantisers for quantiser in row]
    bodies = {
        b"QUAN": b"".join(
            layout.build(layout.QUANTISER_ENTRY, mantissa=q.mantissa, shift=q.shift) for q in flat
        ),
        b"ALFA": b"".join(_alpha_bytes(*key, table) for key, table in sorted(alpha.items())),
        b"TILE": tiles.tobytes(),
        b"PACK": packets.tobytes(),
        b"dGST": b"".join(
            layout.build(
                layout.DIGEST_ENTRY, tile=tile, component=component, step=step, digest=digest
            )
            for (tile, component, step), digest in sorted(digests.items())
        ),
        b"mETa": _meta_bytes(info.text),
    }
    required = (b"QUAN", b"TILE", b"PACK")
    chunks = b"".join(_chunk(k, body) for k, body in bodies.items() if body or k in required)
    chunks += copied_chunks
    fields = {
        "signature": layout.SIGNATURE,
        "version_major": layout.VERSION[0],
        "version_minor": version_minor,
        "tier": _tier(n_levels, tiles, packets, len(chunks)),
        "sh_degree": sh_degree,
        "n_levels": n_levels,
        "grid_exponents": list(grid_exponents),
        "flags": unused_flags
        | (FLAG_ANTIALIASED if info.antialiased else 0)
        | (FLAG_PALETTE if has_palette else 0),
        "coordinate_system": info.coordinate_system,
        "up_axis": info.up_axis,
        "unit": info.unit,
        "colour_space": info.colour_space,
        "n_tiles": len(tiles),
        "n_packets": len(packets),
        "chunks_size": len(chunks),
        "data_size": int(packets["size"].astype(np.int64).sum()),
        "reserved": bytes(16),
    }
    head = layout.build(layout.FILE_HEADER, **fields, crc=0)[:-4]
    return head + zlib.crc32(head).to_bytes(4, "little") + chunks


def rebuild_directory(
    directory: Directory,
    tiles: npt.NDArray[np.void],
    packets: npt.NDArray[np.void],
    digests: Mapping[PacketId, bytes],
) -> bytes:
    """Header and chunks of the same scene with these tiles, packets and digests (R-10-1)."""
    return build_directory(
        sh_degree=directory.sh_degree,
        n_levels=directory.n_levels,
        grid_exponents=directory.grid_exponents,
        info=directory.info,
        quantisers=directory.quantisers,
        alpha=directory.alpha,
        tiles=tiles,
        packets=packets,
        digests=digests,
        has_palette=directory.has_palette,
        copied_chunks=directory.copied_chunks,
        version_minor=directory.version_minor,
        unused_flags=directory.unused_flags,
    )


def _chunk(kind: bytes, body: bytes) -> bytes:
    size = len(body).to_bytes(4, "little")
    crc = zlib.crc32(kind + size + body)
    return layout.build(layout.CHUNK_HEADER, type=kind, size=len(body), crc=crc) + body


def _alpha_bytes(level: int, group: int, table: AlphaTable) -> bytes:
    head = layout.build(
        layout.ALPHA_TABLE,
        level=level,
        group=group,
        shift=table.shift,
        last=len(table.entries) - 1,
    )
    return head + np.array(table.entries, "<i2").tobytes()


def _meta_bytes(text: Mapping[str, str]) -> bytes:
    out = b""
    for key, value in sorted(text.items()):
        encoded = value.encode("utf-8")
        if not is_key(key.encode("utf-8")):
            raise ValueError(f"metadata key {key!r}: use 1 to 255 of a-z 0-9 _ . -")
        if len(encoded) > 0xFFFF:
            raise ValueError(f"metadata value of {key} has more than 65535 bytes")
        head = layout.build(layout.META_ENTRY, key_size=len(key), value_size=len(encoded))
        out += head + key.encode("ascii") + encoded
    return out


def _tier(
    n_levels: int,
    tiles: npt.NDArray[np.void],
    packets: npt.NDArray[np.void],
    chunks_size: int,
) -> int:
    """The lowest tier whose limits the stream keeps (R-8.2-2)."""
    new = packets["n_adds"].astype(np.int64) + packets["n_splits"]
    tile = packets["tile"].astype(np.int64)
    is_palette = packets["component"] == PALETTE
    per_tile = np.bincount(np.where(is_palette, len(tiles), tile), weights=new, minlength=1)
    chains = tile * 256 + packets["component"]
    steps = np.unique(chains, return_counts=True)[1]
    counts = {
        "n_tiles": len(tiles),
        "n_packets": len(packets),
        "n_levels": n_levels,
        "chunks_size": chunks_size,
        "tile_steps": int(steps.max(initial=0)),
        "tile_slots": int(per_tile.max()),
        "slots": int(new.sum()),
    }
    for tier in (1, 2, 3):
        if all(value <= LIMITS[name][tier - 1] for name, value in counts.items()):
            return tier
    over = [name for name, value in counts.items() if value > LIMITS[name][2]]
    raise ValueError(f"the scene exceeds the limit of tier 3 of {', '.join(over)}: use more tiles")
