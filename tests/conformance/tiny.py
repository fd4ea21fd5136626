"""A small suite made of the worked example of the spec, for tests of the harness."""

import hashlib
import json
import struct
import zlib
from pathlib import Path

from conformance.decoders import oracle, reference
from conformance.decoders.outcomes import Run

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = (ROOT / "spec" / "example.evogs").read_bytes()
CHUNKS_AT = 64
BESIDE = [{"mode": "progressive", "dump_on_fault": True}]
PLAIN = {"mode": "file", "level": None, "limits": None, "verify": False, "arrival": None}


def write_suite(folder):
    """Manifest, files and goldens; returns the folder."""
    broken = EXAMPLE[:-1] + bytes([EXAMPLE[-1] ^ 1])
    entries = [
        _vector(
            folder,
            "core-example",
            EXAMPLE,
            [
                {},
                {"level": 0},
                {"level": 1, "verify": True},
                {"mode": "progressive"},
                {"mode": "progressive", "arrival": [[457, 62], [0, 400], [400, 57]]},
                {"mode": "progressive", "arrival": [[300, 219]]},
                {"mode": "progressive", "arrival": [[0, 500]]},
                {"limits": {"slots": 3}},
            ],
            ["R-4.1-2", "R-6.4-1", "R-8.3-1"],
        ),
        _vector(folder, "crc-of-a-packet", broken, [{}, {"level": 0}], ["R-6.3-1"]),
        _vector(folder, "fault-beside-a-level", broken, BESIDE, ["R-6.4-5"]),
        _vector(folder, "signature-of-another", b"x" + EXAMPLE[1:], [{}], ["R-5.1-1"]),
        _vector(folder, "trailing-byte", EXAMPLE + b"\0", [{}], ["R-6.2-1"]),
        _vector(folder, "digest-of-another", _with_wrong_digest(), [{"verify": True}], ["R-5.7-3"]),
        _vector(folder, "critical-chunk", _with_chunk(b"ABCD"), [{}], ["R-8.1-1"]),
    ]
    dumps = [_golden(folder, _prefix_dump(size)) for size in (371, 457, 519)]
    of = {"of": "core-example", "tests": "t", "faulty": "f", "requirements": ["R-6.2-2"]}
    families = [
        {"name": "prefix-example", "rule": "every-prefix", "dumps": dumps, **of},
        {"name": "flip-example", "rule": "every-bit-flip", "exceptions": [], **of},
    ]
    write_manifest(folder, entries, families)
    return folder


def write_manifest(folder, entries, families=()):
    head = {"suite": "evogs-conformance", "version": "0", "spec": "1.0-draft 5", "zstd": "?"}
    manifest = head | {"families": list(families), "vectors": entries}
    (folder / "manifest.json").write_text(json.dumps(manifest))


def read_manifest(folder):
    return json.loads((folder / "manifest.json").read_text())


def _vector(folder, name, data, runs, requirements):
    family = name.partition("-")[0]
    (folder / family).mkdir(parents=True, exist_ok=True)
    (folder / family / f"{name}.evogs").write_bytes(data)
    return {
        "id": name,
        "file": f"{family}/{name}.evogs",
        "sha256": hashlib.sha256(data).hexdigest(),
        "size": len(data),
        "family": family,
        "tests": f"tests {name}",
        "faulty": f"does {name} wrong",
        "requirements": requirements,
        "sections": [],
        "tier": 1,
        "sh_degree": 0,
        "near_miss_of": None,
        "runs": [_expected(folder, data, PLAIN | run) for run in runs],
        "provenance": "tests",
        "kills": [],
    }


def _expected(folder, data, run):
    """The run with the answer of the reference decoder."""
    came = reference.by_codec(data, Run(**run))
    dump = None if came.dump is None else _golden(folder, came.dump)
    return run | {"exit": came.exit, "code": came.code, "offset": came.offset, "dump": dump}


def _golden(folder, dump):
    digest = hashlib.sha256(dump).hexdigest()
    (folder / "goldens").mkdir(exist_ok=True)
    (folder / "goldens" / f"{digest[:16]}.z").write_bytes(zlib.compress(dump, 9))
    return digest


def _prefix_dump(size):
    return oracle.decode_prefix(EXAMPLE[:size]).dump()


def _with_wrong_digest():
    data = bytearray(EXAMPLE)
    at = data.index(b"dGST")
    data[at + 12 + 9] ^= 1
    struct.pack_into(
        "<I", data, at + 8, zlib.crc32(data[at + 12 : at + 53], zlib.crc32(data[at : at + 8]))
    )
    return bytes(data)


def _with_chunk(kind):
    header = bytearray(EXAMPLE[:CHUNKS_AT])
    chunk = kind + bytes(4) + struct.pack("<I", zlib.crc32(kind + bytes(4)))
    struct.pack_into("<I", header, 32, struct.unpack_from("<I", header, 32)[0] + len(chunk))
    struct.pack_into("<I", header, 60, zlib.crc32(header[:60]))
    return bytes(header) + chunk + EXAMPLE[CHUNKS_AT:]
