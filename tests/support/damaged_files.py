"""Files damaged in every way that readers were seen to break on; seeded, one damage per call."""

import io
import json
import random
import zipfile

# What takes the place of a piece of a text: tokens of Python, of dtypes, of JSON, and no text.
PIECES = [
    *("", "'", '"', "(", ")", "[", "]", "{", "}", ",", ":", "\\", "\n", "\r", "\0", "\x1b[31m"),
    *("True", "None", "1L", "-1", "0x10", "1e999", "9" * 20, "9" * 5000, "0x" + "f" * 5000),
    *("<U12", ",U12", "<f4", ">f4", "<f8", "|O", "V4", "<U99999999999", "(3,)<f4", "<m8[s]"),
    *("NaN", "-Infinity", "null", "{}", "[]", "\u202e", "\udcff", "é", "-" * 3000, "(" * 300),
]


def flipped(data: bytes, random_: random.Random) -> bytes:
    """1 to 3 bits changed."""
    out = bytearray(data)
    for _ in range(random_.randint(1, 3)):
        out[random_.randrange(len(out))] ^= 1 << random_.randrange(8)
    return bytes(out)


def cut_short(data: bytes, random_: random.Random) -> bytes:
    """The end missing, or a piece in the middle."""
    start = random_.randrange(len(data))
    stop = len(data) if random_.random() < 0.5 else min(start + random_.randint(1, 99), len(data))
    return data[:start] + data[stop:]


def edited(text: str, random_: random.Random) -> str:
    """1 or 2 pieces of up to 4 characters replaced, removed or put in, or two swapped."""
    for _ in range(random_.randint(1, 2)):
        at = random_.randint(0, len(text))
        if random_.random() < 0.2 and at + 2 <= len(text):
            text = text[:at] + text[at + 1] + text[at] + text[at + 2 :]
        else:
            text = text[:at] + random_.choice(PIECES) + text[at + random_.randint(0, 4) :]
    return text


# --- .npz ----------------------------------------------------------------------------------------


def with_edited_header(npz: bytes, random_: random.Random) -> bytes:
    """The header text of one array edited; sizes and checksums are right again."""
    entries = _entries(npz)
    name = random_.choice(sorted(entries))
    npy = entries[name]
    size = int.from_bytes(npy[8:10], "little")
    header = edited(npy[10 : 10 + size].decode("latin-1"), random_)
    head = header.encode("utf-8", "surrogatepass")[:65535]
    entries[name] = npy[:8] + len(head).to_bytes(2, "little") + head + npy[10 + size :]
    return _zipped(entries)


def with_flipped_arrays(npz: bytes, random_: random.Random) -> bytes:
    """Bits of one array changed, its header included; checksums are right again."""
    entries = _entries(npz)
    name = random_.choice(sorted(entries))
    entries[name] = flipped(entries[name], random_)
    return _zipped(entries)


def with_edited_names(npz: bytes, random_: random.Random) -> bytes:
    """The name of one array edited."""
    entries = _entries(npz)
    name = random_.choice(sorted(entries))
    stem = edited(name.removesuffix(".npy"), random_).encode("utf-8", "replace")[:60_000]
    entries[stem.decode("utf-8", "ignore").replace("\0", "") + ".npy"] = entries.pop(name)
    return _zipped(entries)


def with_flipped_structure(npz: bytes, random_: random.Random) -> bytes:
    """A byte changed in the directory, in its end, or in a local header."""
    places = [
        start + offset
        for mark, size in ((b"PK\x01\x02", 110), (b"PK\x05\x06", 22), (b"PK\x03\x04", 60))
        for start in _finds(npz, mark)
        for offset in range(size)
        if start + offset < len(npz)
    ]
    out = bytearray(npz)
    for _ in range(random_.randint(1, 2)):
        out[random_.choice(places)] = random_.choice((0, 1, 0x7F, 0xFF, random_.randrange(256)))
    return bytes(out)


def _entries(npz: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(npz)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _zipped(entries: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in entries.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return stream.getvalue()


def _finds(data: bytes, mark: bytes) -> list[int]:
    places, at = [], data.find(mark)
    while at >= 0:
        places.append(at)
        at = data.find(mark, at + 1)
    return places


# --- .ply ----------------------------------------------------------------------------------------


def with_edited_ply_header(ply: bytes, random_: random.Random) -> bytes:
    """A line of the header edited, removed, or doubled."""
    end = ply.index(b"end_header")
    lines = ply[:end].decode("latin-1").split("\n")
    at = random_.randrange(len(lines))
    doubled = [lines[at], lines[at]]
    lines[at : at + 1] = random_.choice([[], doubled, *[[edited(lines[at], random_)]] * 8])
    return "\n".join(lines).encode("utf-8", "surrogatepass") + ply[end:]


# --- JSON ----------------------------------------------------------------------------------------

VALUES: list[object] = [
    *(None, True, -1, 0, 1.5, 10**400, 1e308, -1e200, float("nan"), float("inf"), "1", "", {}, []),
    *([1.0, 2.0], [[1.0, 2.0], [3.0]], {"a": 1}, [[[[]]]], "\ud800", "x" * 9999, [10**400] * 3),
]


def with_another_value(text: bytes, random_: random.Random) -> bytes:
    """A value anywhere in the tree replaced, a key renamed, or an entry removed."""
    top = json.loads(text)
    places = list(_places(top))
    holder, key = random_.choice(places)
    what = random_.random()
    if what < 0.8:
        holder[key] = random_.choice(VALUES)
    elif what < 0.9 or isinstance(holder, list):
        del holder[key]
    else:
        holder[random_.choice(["", "\x1b[2J", "self", "width "])] = holder.pop(key)
    return json.dumps(top).encode()


def with_deep_nesting(text: bytes, random_: random.Random) -> bytes:
    """A value behind thousands of brackets."""
    depth = random_.choice([300, 5000, 200_000])
    opening, closing = random_.choice([("[", "]"), ('{"a":', "}")])
    start = random_.randrange(len(text))
    return text[:start] + (opening * depth + "1" + closing * depth).encode() + text[start:]


def with_edited_text(text: bytes, random_: random.Random) -> bytes:
    """Pieces of the text edited."""
    return edited(text.decode("latin-1"), random_).encode("utf-8", "surrogatepass")


def _places(value):
    """(holder, key) of every value below the top."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, below in list(items):
        yield value, key
        if isinstance(below, dict | list):
            yield from _places(below)
