"""Small streams to damage, and ways of damaging them."""

import struct
import zlib
from dataclasses import replace
from functools import cache

import numpy as np

from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.settings import PRESETS
from evogs_codec.model.channels import n_channels
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.tree import EvolutionTree, Kind, Step

HEADER_SIZE, CHUNK_HEADER_SIZE, PACKET_ROW = 64, 12, 36
ROW_SIZE, ROW_CRC = 8, 32  # offsets in a row of PACK

# Arguments of `stream`: two tiles with an SH band; and a tile with all kinds and alpha tables.
SMALL = (
    {"n_roots": 6, "n_levels": 1, "degree": 1, "n_tiles": 2},
    {"n_roots": 4, "n_levels": 2, "degree": 0, "n_tiles": 1},
)


def random_tree(n_roots, n_levels, degree, seed=0):
    """Roots, then per level two steps of splits, refines, a drop and an add."""
    rng = np.random.default_rng(seed)
    d = n_channels(degree)

    def numbers(n, spread):
        return (spread * rng.standard_normal((d, n))).astype(np.float32)

    steps, live = [Step.of_adds(0, numbers(n_roots, 1.0))], np.ones(n_roots, bool)
    for level in range(1, n_levels):
        for _ in range(2):
            slots = np.flatnonzero(live)
            slots = np.sort(rng.permutation(slots)[: max(1, len(slots) * 3 // 4)])
            kinds = rng.choice([Kind.SPLIT, Kind.SPLIT, Kind.REFINE], len(slots)).astype(np.uint8)
            kinds[0] = Kind.DROP if live.sum() > 2 else Kind.SPLIT
            n_splits = int((kinds == Kind.SPLIT).sum())
            step = Step(
                level,
                slots.astype(np.int32),
                kinds,
                numbers(int((kinds != Kind.DROP).sum()), 0.1),
                rng.choice([0.5, 1.0, 1.5], (5, n_splits)).astype(np.float32),
                numbers(1, 1.0),
            )
            live[slots[kinds == Kind.DROP]] = False
            live = np.concatenate([live, np.ones(step.n_new, bool)])
            steps.append(step)
    return EvolutionTree(degree, tuple(steps))


@cache
def stream(n_roots=8, n_levels=2, degree=1, n_tiles=2, seed=0):
    """An encoded `random_tree`, with metadata, alpha tables and digests."""
    info = SceneInfo(up_axis=5, text={"title": "small"})
    tree = random_tree(n_roots, n_levels, degree, seed)
    return encode(tree, replace(PRESETS["trained"], zstd_level=1), n_tiles=n_tiles, info=info)


def flipped(data, bit):
    """`data` with one bit changed."""
    out = bytearray(data)
    out[bit >> 3] ^= 1 << (bit & 7)
    return bytes(out)


def chunk(kind, body):
    """A chunk with its header."""
    head = kind + struct.pack("<I", len(body))
    return head + struct.pack("<I", zlib.crc32(body, zlib.crc32(head))) + body


def chunks_of(data):
    """[(offset, type, body size)] of the chunks that fit."""
    (chunks_size,) = struct.unpack_from("<I", data, 32)
    found, at, end = [], HEADER_SIZE, min(HEADER_SIZE + chunks_size, len(data))
    while end - at >= CHUNK_HEADER_SIZE:
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        if size > end - at - CHUNK_HEADER_SIZE:
            break
        found.append((at, bytes(data[at : at + 4]), size))
        at += CHUNK_HEADER_SIZE + size
    return found


def repaired(data: bytes) -> bytes:
    """`data` with every CRC-32 right, as far as its structure can be made out."""
    out = bytearray(data)
    if len(out) < HEADER_SIZE:
        return bytes(out)
    for at, kind, size in chunks_of(out):
        begin = at + CHUNK_HEADER_SIZE
        if kind == b"PACK":
            offset = HEADER_SIZE + int.from_bytes(out[32:36], "little")
            for row in range(begin, begin + size - PACKET_ROW + 1, PACKET_ROW):
                (n,) = struct.unpack_from("<I", out, row + ROW_SIZE)
                struct.pack_into("<I", out, row + ROW_CRC, zlib.crc32(out[offset : offset + n]))
                offset += n
        crc = zlib.crc32(out[begin : begin + size], zlib.crc32(out[at : at + 8]))
        struct.pack_into("<I", out, at + 8, crc)
    struct.pack_into("<I", out, 60, zlib.crc32(out[:60]))
    return bytes(out)


def rebuilt(data, *, header=None, chunks=None, packets=None):
    """`data` with header fields {offset: (format, value)}, chunk bodies or packets replaced.

    A chunk body of None leaves the chunk out; new types are put after the others.
    """
    head, end = bytearray(data[:HEADER_SIZE]), HEADER_SIZE + int.from_bytes(data[32:36], "little")
    bodies = [
        (kind, data[at + CHUNK_HEADER_SIZE : at + CHUNK_HEADER_SIZE + size])
        for at, kind, size in chunks_of(data)
    ]
    new = dict(chunks or {})
    area = b""
    for kind, body in bodies:
        body = new.pop(kind, body)
        area += b"" if body is None else chunk(kind, body)
    area += b"".join(chunk(kind, body) for kind, body in new.items() if body is not None)
    payload = data[end:] if packets is None else packets
    struct.pack_into("<I", head, 32, len(area))
    struct.pack_into("<Q", head, 36, len(payload))
    for offset, (form, value) in (header or {}).items():
        struct.pack_into(form, head, offset, value)
    struct.pack_into("<I", head, 60, zlib.crc32(head[:60]))
    return bytes(head) + area + payload


N_CORE_CODINGS = 35  # slots, kinds, five alphas, 14 psi, 14 adds
FIRST_ADD = 21
LOW_8_HIGH_2 = 0x28


def row(tile=0, size=0, n_adds=0, body=b"", **fields):
    """A row of PACK."""
    return struct.pack(
        "<IBBHIIIIIII",
        tile,
        fields.get("component", 0),
        fields.get("level", 0),
        0,
        size or len(body),
        n_adds,
        fields.get("n_splits", 0),
        fields.get("n_refines", 0),
        fields.get("n_drops", 0),
        0xFFFFFFFF,
        zlib.crc32(body),
    )


def add_packet(frames, n_planes=3, n_coded=1):
    """A core packet of adds, 24 bits coded for the first channels, with these frames."""
    codings = bytearray(N_CORE_CODINGS)
    for channel in range(n_coded):
        codings[FIRST_ADD + channel] = LOW_8_HIGH_2
    entries = b"".join(struct.pack("<BI", n_planes, len(frame)) for frame in frames)
    return bytes([0, len(frames)]) + bytes(codings) + entries + b"".join(frames)


def frame(content_size, blocks, *, width=4, magic=b"\x28\xb5\x2f\xfd", descriptor=0x20):
    """A Zstandard frame by hand; blocks are (type, Block_Size, bytes), the last marked as such."""
    code = {1: 0, 2: 1, 4: 2, 8: 3}[width]
    stored = content_size - 256 if width == 2 else content_size
    out = magic + bytes([descriptor | code << 6]) + stored.to_bytes(width, "little")
    for k, (kind, size, content) in enumerate(blocks):
        last = k == len(blocks) - 1
        out += (last | kind << 1 | size << 3).to_bytes(3, "little") + content
    return out


def run_of_zeros(size):
    """A frame of `size` zeros in run-length blocks: 4 bytes for every 128 KiB."""
    blocks = [(1, min(1 << 17, size - at), b"\0") for at in range(0, size, 1 << 17)]
    return frame(size, blocks)


@cache
def _one_tile():
    return stream(n_roots=4, n_levels=1, degree=0, n_tiles=1)


def stream_of(rows, packets=b"", *, n_tiles=1, degree=0, n_levels=1, header=None, chunks=None):
    """A stream of a hand-made packet table in tiles of one box."""
    at, _, size = next(entry for entry in chunks_of(_one_tile()) if entry[1] == b"TILE")
    tile = _one_tile()[at + CHUNK_HEADER_SIZE : at + CHUNK_HEADER_SIZE + size]
    tables = {
        b"QUAN": b"\x01\0\0" * (1 + n_levels) * (5 + degree),
        b"TILE": tile * n_tiles,
        b"PACK": b"".join(rows),
        b"dGST": None,
        b"mETa": None,
    }
    size = sum(struct.unpack_from("<I", entry, ROW_SIZE)[0] for entry in rows)
    fields = {
        10: ("<B", 3),
        11: ("<B", degree),
        12: ("<B", n_levels),
        24: ("<I", n_tiles),
        28: ("<I", len(rows)),
        36: ("<Q", size),
    }
    return rebuilt(
        _one_tile(),
        header=fields | (header or {}),
        chunks=tables | (chunks or {}),
        packets=packets,
    )
