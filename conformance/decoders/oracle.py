"""A second decoder of EvoGS streams, written from spec/evogs.md alone, slow and plain.

It reads top to bottom in the order of the text, with Python integers, and imports nothing of the
codec; it is one file, however long, so that it can be carried off and read on its own. The detail
of a fault is the requirement broken. A comment that starts with "Assumed:" marks what the text left
open.
"""

import hashlib
import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import accumulate

import zstandard

# ---- 9 Faults ----

CODES = """TRUNCATED SIGNATURE VERSION CRC RESERVED HEADER TIER CHUNK UNSUPPORTED STEP ALPHA TILE
CHAIN COUNT AMPLIFICATION META TRAILING PACKET FRAME ZSTD SLOT KIND INDEX RANGE DIGEST LIMIT"""


class FaultError(Exception):
    """The stream is refused: code, offset of the structure at fault, requirement."""

    def __init__(self, code: str, detail: str, offset: int = -1) -> None:
        super().__init__(code, detail, offset)
        assert code[2:] in CODES.split()
        self.code, self.detail, self.offset = code, detail, offset


@contextmanager
def structure_at(offset: int) -> Iterator[None]:
    """Faults found inside belong to the structure that begins at `offset`."""
    try:
        yield
    except FaultError as fault:
        fault.offset = offset if fault.offset < 0 else fault.offset
        raise


def require(condition: bool, code: str, detail: str) -> None:
    """Refuse the stream unless the condition holds."""
    if not condition:
        raise FaultError(code, detail)


# ---- 3 Model, 8.2 limits ----

REFINE, SPLIT, DROP = range(3)  # 3.3
N_GROUPS = 5  # 3.1: position, rotation, scale, opacity, SH
PICKS, PALETTE = 4, 5  # 12: components; 3.5: 0 is core, 1 to 3 are SH bands
OF_CHANGED = 4  # 5.9: flag of a packet of picks
N_CORE = 14  # 7.4: the first channel above SH band 0
LIMITS = {  # 8.2: tiers 1, 2, 3
    "n_tiles": (64, 4096, 65536),
    "n_packets": (16384, 262144, 4194304),
    "n_levels": (64, 64, 64),
    "chunks_size": (1048576, 33554432, 536870912),
    "tile_steps": (1024, 4096, 65535),
    "tile_slots": (1048576, 4194304, 16777216),
    "slots": (2097152, 33554432, 2147483647),
}


def group_of(channel: int) -> int:
    """3.1, 3.2: position x y z, rotation w x y z, scale x y z, opacity, then SH."""
    return (0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3)[channel] if channel < 11 else 4


def class_of(channel: int) -> int:
    """3.2: classes 0..3 are the first groups, 4 + b is SH band b."""
    return group_of(channel) if channel < 11 else 4 + math.isqrt((channel - 11) // 3)


def channels_of(component: int) -> range:
    """3.5: core, or the coefficients b*b .. (b+1)*(b+1)-1 of band b, each R G B."""
    first = 11 + 3 * component**2 if component > 0 else 0
    return range(first, 11 + 3 * (component + 1) ** 2)


# ---- 5 Syntax: the structures, in the order of the tables ----

SIGNATURE = bytes.fromhex("89 45 56 47 0D 0A 1A 0A")
HEADER = struct.Struct("<8s5B5bH4B3IQ16sI")
CHUNK_HEADER = struct.Struct("<4sII")
QUANTISER_ENTRY = struct.Struct("<HB")
ALPHA_TABLE = struct.Struct("<4B")
TILE_ENTRY = struct.Struct("<3q3i3i")
PACKET_ENTRY = struct.Struct("<IBBHIIIIIII")
DIGEST_ENTRY = struct.Struct("<IBI32s")
META_ENTRY = struct.Struct("<BH")
FRAME_ENTRY = struct.Struct("<BI")
assert (HEADER.size, TILE_ENTRY.size) == (64, 48)
assert (PACKET_ENTRY.size, DIGEST_ENTRY.size) == (36, 41)


@dataclass
class Header:
    """5.1: the file header."""

    signature: bytes
    version_major: int
    version_minor: int
    tier: int
    sh_degree: int
    n_levels: int
    grid_exponents: tuple[int, ...]
    flags: int
    coordinate_system: int
    up_axis: int
    unit: int
    colour_space: int
    n_tiles: int
    n_packets: int
    chunks_size: int
    data_size: int
    reserved: bytes
    crc: int

    @property
    def has_palette(self) -> bool:
        """12."""
        return self.flags >> 8 & 1 == 1

    @property
    def components(self) -> tuple[int, ...]:
        """3.5, 12: the numbers of the components that the stream may have."""
        return (0, PICKS, PALETTE) if self.has_palette else tuple(range(self.sh_degree + 1))

    @property
    def above_core(self) -> range:
        """12: the channels of picks and of entries."""
        return range(N_CORE, 11 + 3 * (self.sh_degree + 1) ** 2)


@dataclass
class Packet:
    """5.6: a row of the packet table, and what its place implies."""

    tile: int
    component: int
    level: int
    reserved: int
    size: int
    n_adds: int
    n_splits: int
    n_refines: int
    n_drops: int
    error: int
    crc: int
    step: int = 0
    start: int = 0
    label: int = 0  # 12: of picks, that of the step (3.4)
    n_before: int = 0  # 12.2: packets of the palette that stand before it

    @property
    def n_psi(self) -> int:
        """5.9: records with a psi."""
        return self.n_splits + self.n_refines

    @property
    def n_records(self) -> int:
        """5.9: records that name a slot."""
        return self.n_splits + self.n_refines + self.n_drops


@dataclass
class Step:
    """What a core packet says about the slots; the packets of the bands need it again."""

    core: Packet
    slots: list[int]
    kinds: list[int]
    alpha: list[list[tuple[int, int]]]  # [group][split] = (a, K)


@dataclass
class Tile:
    """7: the state of a tile."""

    origin: tuple[int, ...]
    box_min: tuple[int, ...]
    box_max: tuple[int, ...]
    x: list[list[int]]  # by channel; those of a late band have fewer slots (7.4)
    cut: list[int]  # applied steps of each component; of the palette, in tile 0
    n_slots: int = 0
    live: list[bool] = field(default_factory=list)
    born_from: list[int | None] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)  # applied steps of core
    channels: list[list[int]] = field(default_factory=list)  # as shown (7.5), at the end


@dataclass
class Scene:
    """Header, tables and tiles."""

    header: Header
    chunk_offsets: dict[bytes, int]
    quantisers: list[list[tuple[int, int]]] = field(default_factory=list)  # [0 or 1 + level][class]
    alphas: dict[tuple[int, int], tuple[int, list[int]]] = field(default_factory=dict)  # K, a
    tiles: list[Tile] = field(default_factory=list)
    palette: list[list[int]] = field(default_factory=list)  # 7.4: entries of channels from 14 on
    packets: list[Packet] = field(default_factory=list)
    palette_packets: list[Packet] = field(default_factory=list)
    digests: dict[tuple[int, int, int], bytes] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    faults: list[FaultError] = field(default_factory=list)  # 6.4: those found, in the order of 6.1

    def palette_up_to(self, level: int, n: int | None = None) -> list[Packet]:
        """12.2: of the first n packets of the palette, or of all, those up to a level."""
        return [p for p in self.palette_packets[:n] if p.level <= level]

    def dump(self) -> bytes:
        """7.7: the dump of the cut."""
        h = self.header
        out = struct.pack("<4sBB5bBI", b"EVGD", 1, h.sh_degree, *h.grid_exponents, 0, h.n_tiles)
        for tile in self.tiles:
            out += struct.pack("<3qI", *tile.origin, tile.n_slots) + bytes(tile.live)
            out += numbers(tile.channels)
        return out

    def state_digest(self, tile: int, component: int) -> bytes:
        """7.7. Assumed: before the first step the state is that of no slots."""
        return hashlib.sha256(state_bytes(self, tile, component)).digest()

    def float_view(self) -> list[tuple[float, ...]]:
        """7.6: the live splats in order of tile and slot, D numbers each."""
        grid, splats = self.header.grid_exponents, []
        for tile in self.tiles:
            origins = list(tile.origin) + [0] * (len(tile.channels) - 3)
            for slot in filter(tile.live.__getitem__, range(tile.n_slots)):
                xs = enumerate(tile.channels)
                splat = (binary32(origins[c] + x[slot], grid[group_of(c)]) for c, x in xs)
                splats.append(tuple(splat))
        return splats


def check_limit(name: str, count: int, tier: int, own: dict[str, int]) -> None:
    """R-8.2-1, then R-8.3-1."""
    require(count <= LIMITS[name][tier - 1], "E_TIER", name)
    require(name not in own or count <= own[name], "E_LIMIT", name)


def read_header(data: bytes, own: dict[str, int]) -> Header:
    """5.1, 6.1 step 1."""
    require(data[:8] == SIGNATURE[: len(data)], "E_SIGNATURE", "R-5.1-1")
    require(len(data) >= HEADER.size, "E_TRUNCATED", "R-6.2-2")
    fields = HEADER.unpack_from(data)
    h = Header(*[*fields[:6], fields[6:11], *fields[11:]])
    require(h.version_major == 1, "E_VERSION", "R-5.1-2")
    require(h.crc == zlib.crc32(data[:60]), "E_CRC", "R-6.3-1")
    require(h.flags >> 9 == 0 and not any(h.reserved), "E_RESERVED", "R-4.4-1")
    require(1 <= h.tier <= 3, "E_HEADER", "R-5.1-4")
    require(h.sh_degree <= 3, "E_HEADER", "R-5.1-5")
    require(h.n_levels >= 1, "E_HEADER", "R-5.1-6")
    require(all(-16 <= g <= 40 for g in h.grid_exponents), "E_HEADER", "R-5.1-7")
    require(h.sh_degree > 0 or not h.has_palette, "E_HEADER", "R-5.1-9")
    for name in ("n_levels", "n_tiles", "n_packets", "chunks_size"):
        check_limit(name, getattr(h, name), h.tier, own)
    registries = {"coordinate_system": 5, "up_axis": 6, "unit": 5, "colour_space": 2}  # 8.4
    for name, last in registries.items():
        if getattr(h, name) > last:
            setattr(h, name, 0)
    return h


# ---- 6.1 step 2: chunks (5.2) ----

CRITICAL = (b"QUAN", b"ALFA", b"TILE", b"PACK")
ANCILLARY = (b"dGST", b"mETa")


def read_chunks(data: bytes, end: int) -> dict[bytes, tuple[int, bytes]]:
    """Offset and body of each known chunk."""
    at, chunks = HEADER.size, dict[bytes, tuple[int, bytes]]()
    with structure_at(at):
        require(len(data) >= end, "E_TRUNCATED", "R-6.2-2")
    place = -1  # in CRITICAL, of the last critical chunk
    while at < end:
        with structure_at(at):
            require(end - at >= CHUNK_HEADER.size, "E_CHUNK", "R-5.2-1")
            kind, size, crc = CHUNK_HEADER.unpack_from(data, at)
            start = at + CHUNK_HEADER.size
            require(size <= end - start, "E_CHUNK", "R-5.2-1")
            body = data[start : start + size]
            require(crc == zlib.crc32(data[at : at + 8] + body), "E_CRC", "R-6.3-1")
            require(kind.isalpha() and kind[2:3].isupper(), "E_CHUNK", "R-5.2-2")
            if kind in CRITICAL:
                # Assumed: only what came before counts; PACK before TILE is a fault of TILE.
                require(CRITICAL.index(kind) > place, "E_CHUNK", "R-5.2-3")
                place = CRITICAL.index(kind)
            elif kind in ANCILLARY:
                require(kind not in chunks, "E_CHUNK", "R-5.2-4")
            else:
                require(kind[0] >= 97, "E_UNSUPPORTED", "R-8.1-1")
            chunks[kind] = (at, body)
            at = start + size
    with structure_at(HEADER.size):  # Assumed: what is missing is missing from all of the chunks.
        require(all(k in chunks for k in (b"QUAN", b"TILE", b"PACK")), "E_CHUNK", "R-5.2-3")
    return {kind: chunks[kind] for kind in CRITICAL + ANCILLARY if kind in chunks}  # R-8.1-2


# ---- 6.1 step 3: bodies (5.3 to 5.8) ----


def read_quantisers(scene: Scene, body: bytes) -> None:
    """5.3."""
    n_rows, n_classes = 1 + scene.header.n_levels, 5 + scene.header.sh_degree
    require(len(body) == n_rows * n_classes * QUANTISER_ENTRY.size, "E_CHUNK", "R-5.2-5")
    entries = list(QUANTISER_ENTRY.iter_unpack(body))
    for m, e in entries:
        require(m >= 1, "E_STEP", "R-5.3-1")
        require(e <= 24, "E_STEP", "R-5.3-2")
    scene.quantisers = [entries[row * n_classes : (row + 1) * n_classes] for row in range(n_rows)]


def read_alphas(scene: Scene, body: bytes) -> None:
    """Assumed: R-5.4-3 comes first for a table header, after R-5.4-2 for its entries."""
    at, before = 0, (-1, -1)
    while at < len(body):
        require(len(body) - at >= ALPHA_TABLE.size, "E_CHUNK", "R-5.4-3")
        level, group, k, last = ALPHA_TABLE.unpack_from(body, at)
        at += ALPHA_TABLE.size
        inside = level < scene.header.n_levels and group < N_GROUPS and k <= 12
        require(inside, "E_ALPHA", "R-5.4-1")
        require((level, group) > before, "E_ALPHA", "R-5.4-2")
        require(len(body) - at >= 2 * (last + 1), "E_CHUNK", "R-5.4-3")
        scene.alphas[level, group] = (k, list(struct.unpack_from(f"<{last + 1}h", body, at)))
        at, before = at + 2 * (last + 1), (level, group)


def read_tiles(scene: Scene, body: bytes) -> None:
    """Assumed: a stream of no tiles is legal."""
    require(len(body) == scene.header.n_tiles * TILE_ENTRY.size, "E_CHUNK", "R-5.2-5")
    bound, degree = (1 << 30) - 1, scene.header.sh_degree
    for row in TILE_ENTRY.iter_unpack(body):
        origin, low, high = row[0:3], row[3:6], row[6:9]
        require(all(abs(o) <= 1 << 52 for o in origin), "E_TILE", "R-5.5-1")
        ordered = all(-bound <= low[axis] <= high[axis] <= bound for axis in range(3))
        require(ordered, "E_TILE", "R-5.5-2")
        x: list[list[int]] = [[] for _ in range(channels_of(degree).stop)]
        cut = [0] * (scene.header.components[-1] + 1)
        scene.tiles.append(Tile(origin, low, high, x, cut))


def read_packets(scene: Scene, body: bytes, own: dict[str, int]) -> None:
    """5.6, 8.2."""
    h = scene.header
    require(len(body) == h.n_packets * PACKET_ENTRY.size, "E_CHUNK", "R-5.2-5")
    rows = [[0] * (h.components[-1] + 1) for _ in range(h.n_tiles)]  # so far
    labels = [list[int]() for _ in range(h.n_tiles)]  # of the steps of core so far
    live = [0] * h.n_tiles
    level, slots = ([0] * (h.n_tiles + 1) for _ in range(2))  # of each tile, then of the palette
    data_size, all_slots = 0, 0
    for row in PACKET_ENTRY.iter_unpack(body):
        p, t = Packet(*row), row[0]
        n_new, no_counts = p.n_adds + p.n_splits, p.n_adds + p.n_records == 0
        is_picks, is_palette = (p.component == c for c in (PICKS, PALETTE))
        of = h.n_tiles if is_palette else t
        require(p.reserved == 0, "E_RESERVED", "R-4.4-1")
        require(t < h.n_tiles and p.component in h.components, "E_CHAIN", "R-5.6-1")
        if p.component > 0 and not is_palette:
            require(rows[t][0] > rows[t][p.component], "E_CHAIN", "R-5.6-2")
            require(p.level == 0 and no_counts, "E_COUNT", "R-5.6-4")
        else:
            require(level[of] <= p.level < h.n_levels, "E_CHAIN", "R-5.6-3")
            level[of] = p.level
        if is_palette:
            require(p.n_records == 0, "E_COUNT", "R-5.6-4")
        if p.component == 0 or is_palette:
            require((p.size == 0) == no_counts, "E_COUNT", "R-5.6-5")
        require(p.n_records <= live[t], "E_COUNT", "R-5.6-6")
        require(p.n_adds + p.n_records <= 16 * p.size, "E_AMPLIFICATION", "R-5.6-7")
        require(p.size > 0 or p.crc == 0, "E_CRC", "R-5.6-8")
        require(not is_palette or t == 0, "E_CHAIN", "R-5.6-10")
        p.step, p.start = rows[t][p.component], HEADER.size + h.chunks_size + data_size
        scene.packets.append(p)
        rows[t][p.component] += 1
        if is_palette:
            scene.palette_packets.append(p)
        else:
            live[t] += n_new - p.n_drops
        if p.component == 0:
            labels[t].append(p.level)
        if is_picks:
            p.label, p.n_before = labels[t][p.step], len(scene.palette_packets)
        slots[of], all_slots = slots[of] + n_new, all_slots + n_new
        data_size += p.size
        check_limit("tile_steps", rows[t][p.component], h.tier, own)
        check_limit("tile_slots", slots[of], h.tier, own)
        check_limit("slots", all_slots, h.tier, own)
    with structure_at(0):  # Assumed: a fault of the header, though found here.
        require(h.data_size == data_size, "E_HEADER", "R-5.1-8")


def read_digests(scene: Scene, body: bytes) -> None:
    """5.7."""
    require(len(body) % DIGEST_ENTRY.size == 0, "E_CHUNK", "R-5.2-5")
    named, before, n_bytes = state_sizes(scene), (-1, -1, -1), 0
    size = HEADER.size + scene.header.chunks_size + scene.header.data_size
    for *key, digest in DIGEST_ENTRY.iter_unpack(body):
        tile, component, step = key
        require((tile, component, step) > before, "E_CHUNK", "R-5.7-1")
        require((tile, component, step) in named, "E_CHUNK", "R-5.7-2")
        before = (tile, component, step)
        n_bytes += named[before]
        require(n_bytes <= 4096 * size, "E_AMPLIFICATION", "R-5.7-5")
        scene.digests[before] = digest


def state_sizes(scene: Scene) -> dict[tuple[int, int, int], int]:
    """5.7: bytes of the state of a component of a tile after a step (7.7)."""
    n_above = len(scene.header.above_core)
    slots, n_entries, sizes = [list[int]() for _ in scene.tiles], 0, {}
    for p in scene.packets:
        key = (p.tile, p.component, p.step)
        if p.component == 0:
            before = slots[p.tile][-1] if slots[p.tile] else 0
            slots[p.tile].append(before + p.n_adds + p.n_splits)
            sizes[key] = 4 + 61 * slots[p.tile][-1]
        elif p.component == PALETTE:
            n_entries += p.n_adds
            sizes[key] = 4 + 4 * n_above * n_entries
        else:
            n_channels = n_above if p.component == PICKS else 3 * (2 * p.component + 1)
            sizes[key] = 4 + 4 * n_channels * slots[p.tile][p.step]
    return sizes


def read_metadata(scene: Scene, body: bytes) -> None:
    """5.8."""
    at, before, alphabet = 0, b"", b"abcdefghijklmnopqrstuvwxyz0123456789_.-"
    while at < len(body):
        require(len(body) - at >= META_ENTRY.size, "E_META", "R-5.8-1")
        key_size, value_size = META_ENTRY.unpack_from(body, at)
        at += META_ENTRY.size
        require(len(body) - at >= key_size + value_size, "E_META", "R-5.8-1")
        key, value = body[at : at + key_size], body[at + key_size : at + key_size + value_size]
        require(key_size > 0 and all(c in alphabet for c in key), "E_META", "R-5.8-2")
        require(key > before, "E_META", "R-5.8-3")
        try:
            scene.metadata[key.decode("ascii")] = value.decode("utf-8")
        except UnicodeDecodeError:
            raise FaultError("E_META", "R-5.8-4") from None
        at, before = at + key_size + value_size, key


def read_tables(data: bytes, own: dict[str, int]) -> Scene:
    """6.1, steps 1 to 3."""
    with structure_at(0):
        header = read_header(data, own)
    chunks = read_chunks(data, HEADER.size + header.chunks_size)
    scene = Scene(header, {kind: at for kind, (at, _) in chunks.items()})
    readers: dict[bytes, Callable[[Scene, bytes], None]] = {
        b"QUAN": read_quantisers,
        b"ALFA": read_alphas,
        b"TILE": read_tiles,
        b"PACK": lambda scene, body: read_packets(scene, body, own),
        b"dGST": read_digests,
        b"mETa": read_metadata,
    }
    for kind, (at, body) in chunks.items():
        with structure_at(at):
            readers[kind](scene, body)
    scene.palette = [[] for _ in header.above_core]
    return scene


# ---- 6.1 step 4: packets (5.9) ----


@dataclass
class Payload:
    """The integers of a packet as they are stored, before the transforms of 7.1."""

    gaps: list[int]
    kinds: list[int]  # empty: not stored
    indices: list[list[int]]  # by group
    psi: list[list[int]]  # by channel of the component
    adds: list[list[int]]
    codings: bytes  # of psi, then of adds
    flags: int
    first_sh: int  # first channel of an SH triple

    def transformed(
        self, slots: list[int], born_from: list[int | None]
    ) -> tuple[list[list[int]], list[list[int]]]:
        """The integers q of psi and of adds (7.1), by the slots of the records and their births.

        undelta and add_siblings may refuse.
        """
        psi = [[unzigzag(z) for z in stored] for stored in self.psi]
        adds = []
        for coding, stored in zip(self.codings[len(psi) :], self.adds, strict=True):
            q = [unzigzag(z) for z in stored]
            adds.append(undelta(q) if coding & 64 else q)
        for flag, q_sh in ((1, psi[self.first_sh :]), (2, adds[self.first_sh :])):
            if self.flags & flag:
                for c in range(0, len(q_sh), 3):
                    invert_ycocg(*q_sh[c : c + 3])
        for coding, q in zip(self.codings[: len(psi)], psi, strict=True):
            if coding & 64:
                add_siblings(q, slots, born_from)
        return psi, adds


def plane_sizes(coding: int, n: int) -> list[int]:
    """5.9: bytes of each plane of a list."""
    low, high = coding & 15, coding >> 4 & 3
    lows = [] if low == 0 else [(n * low + 7) >> 3 if low in (1, 2, 4) else n]
    return lows + [n] * high


def read_payload(packet: Packet, core: Packet, body: bytes) -> Payload:
    """A packet of size above 0. The counts are those of `core`."""
    is_core, n_channels = packet.component == 0, len(channels_of(packet.component))
    kinds_stored = [core.n_splits, core.n_refines, core.n_drops].count(0) < 2
    lengths = [core.n_psi] * n_channels + [core.n_adds] * n_channels
    if is_core:
        n_kinds = core.n_records if kinds_stored else 0
        lengths = [core.n_records, n_kinds] + [core.n_splits] * N_GROUPS + lengths
    first_psi, only_refines = len(lengths) - 2 * n_channels, core.n_splits == core.n_drops == 0
    first_delta = first_psi if only_refines else first_psi + n_channels
    flags, codings, lists = read_lists(body, lengths, first_delta)
    sides = lists[:first_psi]
    return Payload(
        gaps=sides[0] if is_core else [],
        kinds=sides[1] if is_core else [],
        indices=sides[2:],
        psi=lists[first_psi : first_psi + n_channels],
        adds=lists[first_psi + n_channels :],
        codings=codings[first_psi:],
        flags=flags,
        first_sh=11 if is_core else 0,
    )


def read_lists(
    body: bytes, lengths: list[int], first_delta: int, n_flags: int = 2
) -> tuple[int, bytes, list[list[int]]]:
    """A packet of size above 0: its flags, coding bytes and stored integers.

    Lists from number `first_delta` on may be of differences; flags from `n_flags` on are reserved.
    """
    entries_at = 2 + len(lengths)
    require(len(body) >= entries_at, "E_PACKET", "R-5.9-1")
    flags, n_frames, codings = body[0], body[1], body[2:entries_at]
    reserved = flags >> n_flags or any(c >> 7 for c in codings)
    require(not reserved, "E_RESERVED", "R-4.4-1")
    legal = all(c & 15 <= 8 and c >> 4 & 3 <= 2 and c != 64 for c in codings)
    require(legal, "E_PACKET", "R-5.9-2")
    require(not any(c & 64 for c in codings[:first_delta]), "E_PACKET", "R-5.9-3")
    unused = any(c != 0 and n == 0 for c, n in zip(codings, lengths, strict=True))
    require(not unused, "E_PACKET", "R-5.9-4")
    frames_at = entries_at + n_frames * FRAME_ENTRY.size
    require(len(body) >= frames_at, "E_PACKET", "R-5.9-1")
    frames = list(FRAME_ENTRY.iter_unpack(body[entries_at:frames_at]))

    sizes = [size for c, n in zip(codings, lengths, strict=True) for size in plane_sizes(c, n)]
    require(all(n >= 1 for n, _ in frames), "E_PACKET", "R-5.9-7")
    require(sum(n for n, _ in frames) == len(sizes), "E_PACKET", "R-5.9-7")
    require(sum(size for _, size in frames) == len(body) - frames_at, "E_PACKET", "R-5.9-8")

    planes, at = list[bytes](), frames_at
    for n, size in frames:
        group = sizes[len(planes) : len(planes) + n]
        content = read_frame(body[at : at + size], sum(group))
        for plane_size in group:
            planes.append(content[:plane_size])
            content = content[plane_size:]
        at += size

    rest = iter(planes)
    lists = []
    for coding, n in zip(codings, lengths, strict=True):
        own = [next(rest) for _ in plane_sizes(coding, n)]
        check_low_plane(coding, own, n)
        lists.append(unpack(coding, own, n))
    return flags, codings, lists


def check_low_plane(coding: int, planes: list[bytes], n: int) -> None:
    """R-5.9-9: bits that belong to no value are 0."""
    low = coding & 15
    if low in (1, 2, 4):
        used = n * low & 7
        require(used == 0 or planes[0][-1] >> used == 0, "E_PACKET", "R-5.9-9")
    elif low:
        require(all(byte >> low == 0 for byte in planes[0]), "E_PACKET", "R-5.9-9")


def read_frame(frame: bytes, content_size: int) -> bytes:
    """5.10: the frame's own headers first (RFC 8878, 3.1.1), then the library."""
    require(frame[:4] == bytes.fromhex("28 B5 2F FD"), "E_FRAME", "R-5.10-1")
    require(len(frame) >= 5, "E_FRAME", "R-5.10-2")
    descriptor = frame[4]
    require(descriptor & 0b00111111 == 0b00100000, "E_FRAME", "R-5.10-2")
    width = (1, 2, 4, 8)[descriptor >> 6]
    at = 5 + width
    require(len(frame) >= at, "E_FRAME", "R-5.10-3")
    stated = int.from_bytes(frame[5:at], "little") + (256 if width == 2 else 0)
    require(stated == content_size, "E_FRAME", "R-5.10-3")
    require(stated <= 16 << 20, "E_FRAME", "R-5.10-4")
    last = 0
    while not last:
        require(len(frame) - at >= 3, "E_FRAME", "R-5.10-5")
        block = int.from_bytes(frame[at : at + 3], "little")
        last, kind, size = block & 1, block >> 1 & 3, block >> 3
        require(kind != 3 and size <= min(128 << 10, stated), "E_FRAME", "R-5.10-5")
        require(size > 0 or (kind == 0 and last == 1), "E_FRAME", "R-5.10-5")
        at += 3 + (1 if kind == 1 else size)  # an RLE block stores a byte
    require(at == len(frame), "E_FRAME", "R-5.10-5")
    try:
        # As a stream: in one call libzstd takes blocks that regenerate more than 128 KiB.
        content = zstandard.ZstdDecompressor().decompressobj().decompress(frame)
    except zstandard.ZstdError:
        raise FaultError("E_ZSTD", "R-5.10-6") from None
    require(len(content) == content_size, "E_ZSTD", "R-5.10-6")
    check_literals(frame[5 + width :])
    return content


def check_literals(blocks: bytes) -> None:
    """5.10: Huffman-coded literals of blocks that the library took, which checks less of them."""
    lengths, at, last = list[int](), 0, 0
    while not last:
        block = int.from_bytes(blocks[at : at + 3], "little")
        last, kind, size = block & 1, block >> 1 & 3, block >> 3
        begin, at = at + 3, at + 3 + (1 if kind == 1 else size)
        if kind == 2 and blocks[begin] & 2:  # else its literals are raw or a run
            lengths = check_section(blocks[begin:at], lengths)


def check_section(section: bytes, lengths: list[int]) -> list[int]:
    """RFC 8878, 3.1.1.3.1: the literals of a block, by its own tree or by that of the one before.

    A tree is the code length of each index of log bits. The tree is returned.
    """
    n_streams = 4 if section[0] & 12 else 1
    width, streams_at = ((10, 3), (10, 3), (14, 4), (18, 5))[section[0] >> 2 & 3]
    sizes = int.from_bytes(section[:streams_at], "little") >> 4
    n_literals, n_bytes = sizes & (1 << width) - 1, sizes >> width
    streams = section[streams_at : streams_at + n_bytes]
    if section[0] & 1 == 0:
        lengths, size = read_tree(streams)
        streams = streams[size:]
    if n_streams == 1:
        check_stream(streams, n_literals, lengths)
        return lengths
    ends = [*accumulate(struct.unpack("<3H", streams[:6]), initial=6), len(streams)]
    each = (n_literals + 3) // 4
    counts = [each, each, each, n_literals - 3 * each]
    for begin, end, count in zip(ends[:-1], ends[1:], counts, strict=True):
        check_stream(streams[begin:end], count, lengths)
    return lengths


def check_stream(stream: bytes, n_literals: int, lengths: list[int]) -> None:
    """RFC 8878, 4.2.2: the codes use up the bits below the end mark, from the last one down."""
    require(stream[-1:] > bytes(1), "E_ZSTD", "R-5.10-12")
    text = f"{int.from_bytes(stream, 'little'):b}"[1:]
    log = len(lengths).bit_length() - 1
    at = 0
    for _ in range(n_literals):
        at += lengths[int(text[at : at + log].ljust(log, "0"), 2)]
    require(at == len(text), "E_ZSTD", "R-5.10-12")


def read_tree(data: bytes) -> tuple[list[int], int]:
    """RFC 8878, 4.2.1: a tree, and the size of its description."""
    if data[0] < 128:
        size = 1 + data[0]
        weights = read_weights(data[1:size])
    else:
        size = 1 + (data[0] - 126) // 2
        weights = [nibble for byte in data[1:size] for nibble in (byte >> 4, byte & 15)]
        weights = weights[: data[0] - 127]
    total = sum(1 << weight - 1 for weight in weights if weight)
    log = total.bit_length()
    require(log <= 11, "E_ZSTD", "R-5.10-13")
    weights.append(((1 << log) - total).bit_length())
    require(weights.count(1) >= 2, "E_ZSTD", "R-5.10-14")
    runs = [[log + 1 - w] * (weights.count(w) << w - 1) for w in range(1, log + 1)]
    return [length for run in runs for length in run], size


def read_weights(data: bytes) -> list[int]:
    """RFC 8878, 4.2.1.2: FSE-coded weights, of two states that take turns."""
    cells, size = read_distribution(data)
    text = f"{int.from_bytes(data[size:], 'little'):b}"[1:]
    log = len(cells).bit_length() - 1
    now, other, at = int(text[:log], 2), int(text[log : 2 * log], 2), 2 * log
    weights = list[int]()
    while True:
        weight, n_bits, base = cells[now]
        weights.append(weight)
        if at + n_bits > len(text):  # R-5.10-15: all of them lack, or some
            return [*weights, cells[other][0]]
        now, at = base + int("0" + text[at : at + n_bits], 2), at + n_bits
        now, other = other, now


def read_distribution(data: bytes) -> tuple[list[tuple[int, int, int]], int]:
    """RFC 8878, 4.1.1: an FSE table, a row of weight, bits and base for each state; its size."""
    bits, at = int.from_bytes(data, "little"), 4
    log = 5 + (bits & 15)
    left, counts = 1 << log, list[int]()
    while left > 0:
        width = (left + 1).bit_length()
        value, n_short = bits >> at & (1 << width) - 1, (1 << width) - 2 - left
        if value % (1 << width - 1) < n_short:
            value, width = value % (1 << width - 1), width - 1
        elif value >> width - 1:
            value -= n_short
        at += width
        counts.append(value - 1)
        left -= abs(value - 1)
        repeat = 3 if value == 1 else 0
        while repeat == 3:
            repeat = bits >> at & 3
            counts += [0] * repeat
            at += 2
    rare = [weight for weight, count in enumerate(counts) if count < 0]
    cells, position = [0] * (1 << log), 0
    n_often = len(cells) - len(rare)
    cells[n_often:] = rare[::-1]
    for weight, count in enumerate(counts):
        for _ in range(count):
            cells[position] = weight
            position = next_position(position, len(cells))
            while position >= n_often:
                position = next_position(position, len(cells))
    seen, rows = [abs(count) for count in counts], list[tuple[int, int, int]]()
    for weight in cells:
        n_bits = log + 1 - seen[weight].bit_length()
        rows.append((weight, n_bits, (seen[weight] << n_bits) - len(cells)))
        seen[weight] += 1
    return rows, (at + 7) // 8


def next_position(position: int, size: int) -> int:
    """RFC 8878, 4.1.1: where the next state of a weight is."""
    return (position + (size >> 1) + (size >> 3) + 3) % size


# ---- 7.1 From planes to integers, 7.2 slots, 7.3 arithmetic, 7.4 a step ----


def unpack(coding: int, planes: list[bytes], n: int) -> list[int]:
    """7.1: the stored integers of a list."""
    low = coding & 15
    if low in (1, 2, 4):
        bits = int.from_bytes(planes[0], "little")
        lows = [bits >> (i * low) & ((1 << low) - 1) for i in range(n)]
    else:
        lows = list(planes[0]) if low else [0] * n
    highs = planes[1:] if low else planes
    above = [sum(plane[i] << (8 * k) for k, plane in enumerate(highs)) for i in range(n)]
    return [(above[i] << low) + lows[i] for i in range(n)]


def unzigzag(z: int) -> int:
    """7.1."""
    return z >> 1 if z % 2 == 0 else -((z + 1) >> 1)


def undelta(differences: list[int]) -> list[int]:
    """7.1."""
    values = list(accumulate(differences))
    require(all(abs(total) <= 1 << 28 for total in values), "E_RANGE", "R-7.1-1")
    return values


def invert_ycocg(first: list[int], second: list[int], third: list[int]) -> None:
    """Y Co Cg become R G B in place."""
    for i, (y, co, cg) in enumerate(zip(first, second, third, strict=True)):
        t = y - (cg >> 1)
        g = cg + t
        b = t - (co >> 1)
        first[i], second[i], third[i] = b + co, g, b


def add_siblings(q: list[int], slots: list[int], born_from: list[int | None]) -> None:
    """Sibling differences become psi in place; q[i] is that of slots[i]."""
    place = dict[int | None, int]()
    for i, slot in enumerate(slots):
        place[slot] = i
        first = place.get(born_from[slot])
        if first is not None:
            shared, difference = q[first], q[i]
            q[i] = within_sum(shared - difference)
            q[first] = within_sum(shared + difference)


def within_sum(value: int) -> int:
    """7.1: a psi on its way."""
    require(abs(value) <= 1 << 28, "E_RANGE", "R-7.1-2")
    return value


def read_step(scene: Scene, core: Packet, payload: Payload) -> Step:
    """7.2."""
    tile = scene.tiles[core.tile]
    slots, at = list[int](), -1
    for gap in payload.gaps:
        at += gap + 1
        require(at < tile.n_slots and tile.live[at], "E_SLOT", "R-7.2-1")
        slots.append(at)
    counts = {REFINE: core.n_refines, SPLIT: core.n_splits, DROP: core.n_drops}
    kinds = [kind for kind in counts for _ in range(counts[kind])]  # if only one count is not 0
    if payload.kinds:
        kinds = payload.kinds
        require(all(kinds.count(kind) == counts[kind] for kind in counts), "E_KIND", "R-7.2-2")
    alpha = []
    for group in range(N_GROUPS):
        k, table = scene.alphas.get((core.level, group), (0, [1]))  # 5.4: without a table
        indices = payload.indices[group]
        require(all(index < len(table) for index in indices), "E_INDEX", "R-7.2-3")
        alpha.append([(table[index], k) for index in indices])
    return Step(core, slots, kinds, alpha)


def round_shift(v: int, n: int) -> int:
    """4.2."""
    return v if n == 0 else (v + (1 << (n - 1))) >> n


def delta_of(q: int, m: int, e: int) -> int:
    """7.3."""
    require(abs(q) <= ((1 << 28) >> e) // m, "E_RANGE", "R-7.3-1")
    return (q * m) << e


def in_range(x: int) -> int:
    """7.3."""
    require(abs(x) <= (1 << 30) - 1, "E_RANGE", "R-7.3-3")
    return x


def second_child(p: int, delta: int, a: int, k: int) -> int:
    """7.3."""
    require(abs(a * delta) + ((1 << k) >> 1) <= 1 << 30, "E_RANGE", "R-7.3-2")
    return in_range(p - round_shift(a * delta, k))


def apply_packet(scene: Scene, packet: Packet, body: bytes) -> None:
    """6.1 step 4, for a packet all of whose bytes are there."""
    require(zlib.crc32(body) == packet.crc, "E_CRC", "R-6.3-1")
    tile, component = scene.tiles[packet.tile], packet.component
    if component in (PICKS, PALETTE):
        apply = append_entries if component == PALETTE else apply_picks
        apply(scene, packet, body)
        tile.cut[component] += 1
        return
    core = packet if component == 0 else tile.steps[packet.step].core
    channels = channels_of(component)
    if packet.size == 0:  # 5.6: all psi and all adds are 0
        n, codings = len(channels), bytes(2 * len(channels))
        zero_psi, zero_adds = [[0] * core.n_psi] * n, [[0] * core.n_adds] * n
        payload = Payload([], [], [[]] * N_GROUPS, zero_psi, zero_adds, codings, 0, 0)
    else:
        payload = read_payload(packet, core, body)
    step = read_step(scene, core, payload) if component == 0 else tile.steps[packet.step]
    psi, adds = payload.transformed(step.slots, tile.born_from)
    for i, channel in enumerate(channels):
        psi_mantissa_shift = scene.quantisers[1 + core.level][class_of(channel)]
        add_mantissa_shift = scene.quantisers[0][class_of(channel)]
        deltas = [delta_of(q, *psi_mantissa_shift) for q in psi[i]]
        new = [delta_of(q, *add_mantissa_shift) for q in adds[i]]
        apply_channel(tile.x[channel], step, step.alpha[group_of(channel)], deltas, new)
    if component == 0:
        finish_core_step(tile, step)
    tile.cut[component] += 1


def apply_whole(scene: Scene, packet: Packet, body: bytes) -> None:
    """R-6.4-5: a packet is applied whole, or what it changed is put back."""
    tile, palette = scene.tiles[packet.tile], [entries[:] for entries in scene.palette]
    before = replace(
        tile,
        x=[x[:] for x in tile.x],
        cut=tile.cut[:],
        live=tile.live[:],
        born_from=tile.born_from[:],
        steps=tile.steps[:],
    )
    try:
        apply_packet(scene, packet, body)
    except FaultError:
        scene.tiles[packet.tile], scene.palette = before, palette
        raise


def apply_channel(
    x: list[int], step: Step, alpha: list[tuple[int, int]], psi: list[int], adds: list[int]
) -> None:
    """7.4: one channel, in place."""
    seconds, deltas, alphas = list[int](), iter(psi), iter(alpha)
    for slot, kind in zip(step.slots, step.kinds, strict=True):
        if kind == DROP:
            x[slot] = 0
            continue
        p, delta = x[slot], next(deltas)
        x[slot] = in_range(p + delta)
        if kind == SPLIT:
            seconds.append(second_child(p, delta, *next(alphas)))
    x.extend(seconds)
    x.extend(in_range(delta) for delta in adds)


def finish_core_step(tile: Tile, step: Step) -> None:
    """7.4: liveness and boxes, after all channels."""
    changed = list(range(tile.n_slots, tile.n_slots + step.core.n_splits + step.core.n_adds))
    for slot, kind in zip(step.slots, step.kinds, strict=True):
        if kind == DROP:
            tile.live[slot] = False
        else:
            changed.append(slot)
        if kind == SPLIT:
            tile.born_from.append(slot)
    tile.born_from += [None] * step.core.n_adds
    for slot in changed:
        for axis in range(3):
            x = tile.x[axis][slot]
            require(tile.box_min[axis] <= x <= tile.box_max[axis], "E_RANGE", "R-7.3-4")
    tile.n_slots = len(tile.born_from)
    tile.live += [True] * (tile.n_slots - len(tile.live))
    tile.steps.append(step)


def append_entries(scene: Scene, packet: Packet, body: bytes) -> None:
    """7.4: a packet of the palette."""
    if packet.size == 0:  # R-5.6-5: without entries
        return
    channels = scene.header.above_core
    flags, codings, lists = read_lists(body, [packet.n_adds] * len(channels), first_delta=0)
    _, entries = Payload([], [], [], [], lists, codings, flags, 0).transformed([], [])
    for channel, own, qs in zip(channels, scene.palette, entries, strict=True):
        own += [in_range(delta_of(q, *scene.quantisers[0][class_of(channel)])) for q in qs]


def apply_picks(scene: Scene, packet: Packet, body: bytes) -> None:
    """7.4: new slots get the entries that their picks number from 1; changed ones may, too."""
    tile = scene.tiles[packet.tile]
    step = tile.steps[packet.step]
    changed = list[int]()  # slots of before that get new picks
    if packet.size > 0 and body[0] & OF_CHANGED:
        kinds = zip(step.slots, step.kinds, strict=True)
        changed = [slot for slot, kind in kinds if kind != DROP]
    n_new = step.core.n_splits + step.core.n_adds
    picks = [0] * n_new  # of a packet of no bytes until below
    if packet.size > 0:
        _, _, (picks,) = read_lists(body, [len(changed) + n_new], first_delta=1, n_flags=3)
    n_entries = sum(p.n_adds for p in scene.palette_up_to(packet.label, packet.n_before))
    require(all(pick <= n_entries for pick in picks), "E_INDEX", "R-7.2-4")
    repicks, picks = picks[: len(changed)], picks[len(changed) :]
    for channel, entries in zip(scene.header.above_core, scene.palette, strict=True):
        x = tile.x[channel]
        for slot, pick in zip(changed, repicks, strict=True):
            x[slot] = entries[pick - 1] if pick > 0 else 0
        for slot, kind in zip(step.slots, step.kinds, strict=True):
            if kind == DROP:
                x[slot] = 0
        x.extend(entries[pick - 1] if pick > 0 else 0 for pick in picks)
    if packet.size == 0:  # 12.4: C2 has the pick of P, which keeps it
        parents = [s for s, kind in zip(step.slots, step.kinds, strict=True) if kind == SPLIT]
        for channel in scene.header.above_core:
            x = tile.x[channel]
            begin = len(x) - n_new
            x[begin : begin + len(parents)] = [x[slot] for slot in parents]


# ---- 7.5 SH that comes late, 7.6 float view, 7.7 states ----


def shown(tile: Tile, x: list[int], slot: int) -> int:
    """7.5: what a slot shows of a channel; empty slots show 0 (7.7)."""
    u: int | None = slot if tile.live[slot] else None
    while u is not None and u >= len(x):
        u = tile.born_from[u]
    return 0 if u is None else x[u]


def binary32(n: int, g: int) -> float:
    """7.6: n * 2^-g, |n| < 2^53, g in -16..40, rounded once, ties to even. Assumed: zero is +0."""
    shift = max(0, abs(n).bit_length() - 24)
    kept, left = abs(n) >> shift, abs(n) & ((1 << shift) - 1)
    if 2 * left > 1 << shift or (2 * left == 1 << shift and kept % 2 == 1):
        kept += 1
    value = math.ldexp(float(kept), shift - g)  # exact, and never subnormal
    return -value if n < 0 else value


def numbers(channels: list[list[int]]) -> bytes:
    """7.7: s32 of each slot, channel by channel."""
    return b"".join(struct.pack(f"<{len(x)}i", *x) for x in channels)


def state_bytes(scene: Scene, number: int, component: int) -> bytes:
    """7.7: the state of a component of tile `number` after its last applied step."""
    tile, channels = scene.tiles[number], scene.palette
    if component == PICKS:
        channels = [tile.x[c] for c in scene.header.above_core]
    elif component != PALETTE:
        channels = [tile.x[c] for c in channels_of(component)]
    n_slots, slots = len(channels[0]), b""
    if component == 0:
        born_from = [-1 if slot is None else slot for slot in tile.born_from]
        slots = bytes(tile.live) + numbers([born_from])
    return struct.pack("<I", n_slots) + slots + numbers(channels)


# ---- 3.6 cuts, 6.2 whole files, 6.4 progressive decoding ----

Trace = Callable[[int, int, int, bytes], None]
Ranges = list[tuple[int, int]]  # begin and end of the bytes that are there


def cut_by_level(scene: Scene, level: int) -> list[list[int]]:
    """3.6: core packets with labels of at most `level`; of bands what is there, not more.

    A cut says in tile 0 how many steps of the palette it takes: here, those of the levels.
    """
    cut = [[0] * (scene.header.components[-1] + 1) for _ in scene.tiles]
    for p in scene.packets:
        cut[p.tile][0] += p.component == 0 and p.level <= level
    for p in scene.packets:
        steps = cut[p.tile]
        steps[p.component] += p.component > 0 and steps[p.component] < steps[0]
    if scene.header.has_palette and cut:
        cut[0][PALETTE] = len(scene.palette_up_to(level))
    return cut


def check_cut(scene: Scene, cut: list[list[int]]) -> None:
    """3.6: a wrong cut is a mistake of the caller, not a fault of the stream."""
    most = cut_by_level(scene, scene.header.n_levels)
    valid = [len(steps) for steps in cut] == [len(steps) for steps in most]
    for steps, limits in zip(cut, most, strict=False):
        valid &= all(0 <= n <= m for n, m in zip(steps, limits, strict=False))
        valid &= all(n <= steps[0] for n in steps[:PALETTE])
    if valid and scene.header.has_palette:
        picks = (p for p in scene.packets if p.component == PICKS)
        taken = [p for p in picks if p.step < cut[p.tile][PICKS]]
        required = (len(scene.palette_up_to(p.label, p.n_before)) for p in taken)
        valid = not taken or cut[0][PALETTE] >= max(required)
    if not valid:
        raise ValueError("the cut is not valid")


def is_there(pieces: Ranges, packet: Packet) -> bool:
    """Assumed: a packet of no bytes is never missing, even behind the end of the data."""
    end = packet.start + packet.size
    return packet.size == 0 or any(a <= packet.start and end <= b for a, b in pieces)


def digest_differs(scene: Scene, p: Packet) -> bool:
    """R-5.7-3 of the packet applied last, if it has a digest."""
    digest = scene.digests.get((p.tile, p.component, p.step))
    return digest is not None and scene.state_digest(p.tile, p.component) != digest


def finish(scene: Scene, pieces: Ranges, wrong: set[tuple[int, int, int]]) -> Scene:
    """7.5, then 6.1 step 5 (assumed: the offset is where the packets end) and step 6.

    `wrong` are the packets whose digests differ. Assumed: a fault of dGST; a digest of a packet
    outside the cut is not checked.
    """
    for tile in scene.tiles:
        tile.channels = [[shown(tile, x, u) for u in range(tile.n_slots)] for x in tile.x]
    end = HEADER.size + scene.header.chunks_size + scene.header.data_size
    with structure_at(end):
        require(all(b <= end for _, b in pieces), "E_TRAILING", "R-6.2-1")
    with structure_at(scene.chunk_offsets.get(b"dGST", 0)):
        require(not wrong, "E_DIGEST", "R-5.7-3")
    return scene


def decode(
    data: bytes,
    *,
    level: int | None = None,
    cut: list[list[int]] | None = None,
    check_digests: bool = False,
    limits: dict[str, int] | None = None,
    trace: Trace | None = None,
) -> Scene:
    """Decode the cut of a whole file, by level or as cut[tile][component] = steps, or all of it.

    `trace` gets tile, step, component and the state (7.7) after each packet.
    """
    scene = read_tables(data, limits or {})
    if cut is None:
        cut = cut_by_level(scene, scene.header.n_levels if level is None else level)
    check_cut(scene, cut)
    wrong = set[tuple[int, int, int]]()
    for p in scene.packets:
        if p.step >= cut[p.tile][p.component]:
            continue  # R-6.2-3
        with structure_at(p.start):
            require(is_there([(0, len(data))], p), "E_TRUNCATED", "R-6.2-2")
            apply_packet(scene, p, data[p.start : p.start + p.size])
        if check_digests and digest_differs(scene, p):
            wrong.add((p.tile, p.component, p.step))
        if trace is not None:
            trace(p.tile, p.step, p.component, state_bytes(scene, p.tile, p.component))
    return finish(scene, [(0, len(data))], wrong)


def decode_prefix(data: bytes, *, limits: dict[str, int] | None = None) -> Scene:
    """6.4: the largest cut whose packets are complete; missing packets are no fault."""
    return decode_pieces(data, [(0, len(data))], limits=limits)


def decode_pieces(
    data: bytes, arrival: list[tuple[int, int]], *, limits: dict[str, int] | None = None
) -> Scene:
    """The same where only some bytes of `data` came: (offset, size) of each piece, in any order."""
    scene = decode_what_came(data, arrival, limits=limits)
    for fault in scene.faults:
        raise fault
    return scene


def decode_what_came(
    data: bytes,
    arrival: list[tuple[int, int]],
    *,
    check_digests: bool = False,
    limits: dict[str, int] | None = None,
) -> Scene:
    """The same; faults but those of header and chunks are kept beside the state (R-6.4-5)."""
    pieces = Ranges()
    for begin, size in sorted(arrival):
        end = min(begin + size, len(data))
        if pieces and begin <= pieces[-1][1]:
            begin, end = pieces[-1][0], max(end, pieces.pop()[1])
        if begin < end:
            pieces.append((begin, end))
    head = data[: pieces[0][1]] if pieces and pieces[0][0] == 0 else b""
    scene, wrong = read_tables(head, limits or {}), set[tuple[int, int, int]]()
    for p in scene.packets:
        steps = scene.tiles[p.tile].cut
        required = p.step == steps[p.component] and (p.component == 0 or p.step < steps[0])  # 3.5
        if p.component == PALETTE:  # 12
            required = p.step == steps[PALETTE]
        elif p.component == PICKS:
            required &= scene.tiles[0].cut[PALETTE] >= len(scene.palette_up_to(p.label, p.n_before))
        if not required or not is_there(pieces, p):
            continue
        try:
            with structure_at(p.start):
                apply_whole(scene, p, data[p.start : p.start + p.size])
        except FaultError as fault:
            scene.faults.append(fault)
            continue
        if check_digests and digest_differs(scene, p):
            wrong.add((p.tile, p.component, p.step))
    try:
        finish(scene, pieces, wrong)
    except FaultError as fault:
        scene.faults.append(fault)
    return scene
