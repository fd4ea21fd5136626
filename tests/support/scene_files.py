"""Files of scenes as other programs write them, and how a file is refused."""

import gzip
import json
import struct
import tracemalloc
import zipfile
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from evogs_codec import InputError, read_scene
from evogs_codec.io.interchange.bounded import FREE
from evogs_codec.io.interchange.values import largest_and_rest, unit
from tests.support.odd_scenes import opacities

MAX_SAID = 1000  # characters of a message


def zipped(files, how=zipfile.ZIP_STORED):
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", how) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return stream.getvalue()


def ksplat(scene, level=1):
    """A `.ksplat` of one section and two buckets."""
    n = len(scene)
    head = bytearray(4096)
    head[:2] = 0, 1
    struct.pack_into("<IIIIH", head, 4, 1, 1, n, n, level)
    section = bytearray(1024)
    # splats, room, splats of a bucket, buckets, block, bytes of a bucket, range, -, full, partial
    struct.pack_into("<IIIIfHxxIIIIH", section, 0, n, n, 12, 2, 12.0, 12, 32767, 0, 1, 1, 0)
    centres = np.array([[1.3, -0.7, 2.1]] * 2, "<f4")
    positions = np.rint((scene.means - centres[0]) / 6 * 32767 + 32767).astype("<u2")
    rows = [
        positions.view(np.uint8).reshape(n, 6),
        np.exp(scene.log_scales).astype("<f2").view(np.uint8).reshape(n, 6),
        scene.quats.astype("<f2").view(np.uint8).reshape(n, 8),
        np.full((n, 4), 200, np.uint8),
    ]
    body = struct.pack("<I", n - 12) + centres.tobytes() + np.concatenate(rows, axis=1).tobytes()
    return bytes(head + section) + body


def gltf_of(glb):
    """The JSON of a `.glb`, with its bytes as a data URI."""
    n_json = struct.unpack_from("<I", glb, 12)[0]
    root = json.loads(glb[20 : 20 + n_json])
    payload = glb[28 + n_json :]
    uri = "data:application/octet-stream;base64," + __import__("base64").b64encode(payload).decode()
    root["buffers"] = [{"byteLength": len(payload), "uri": uri}]
    return root


def glb_of(root, payload=b""):
    text = json.dumps(root).encode() if isinstance(root, dict) else root
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(payload), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(payload), 0x004E4942) + payload


def refusal(path, peak=FREE + (64 << 20)):
    """The line with which a file is refused; less than `peak` bytes are allocated on the way."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as refused:
            read_scene(path)
        assert tracemalloc.get_traced_memory()[1] < peak
    finally:
        tracemalloc.stop()
    said = str(refused.value).removeprefix(str(path))
    assert said != str(refused.value)  # it names the file
    assert said.isprintable()
    assert len(said) < MAX_SAID
    return said


def old_spz(scene, version):
    """An `.spz` of version 1 to 3, of a scene in its own axes."""
    n = len(scene)
    if version == 1:
        positions = scene.means.astype("<f2").tobytes()
    else:
        fixed = np.rint(scene.means * 4096.0).astype("<i4")
        positions = fixed.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    xyzw = np.roll(unit(scene.quats), -1, axis=1)
    if version < 3:
        xyz = xyzw[:, :3] * np.where(xyzw[:, 3:] < 0, -1, 1)
        rotations = np.rint(xyz * 127.5 + 127.5).clip(0, 255).astype(np.uint8).tobytes()
    else:
        largest, rest = largest_and_rest(xyzw)
        words = largest.astype("<u4") << 30
        for i, at in enumerate((20, 10, 0)):
            part = rest[:, i]
            step = np.rint(np.abs(part) * 511 * 2**0.5).astype("<u4")
            words |= (step | (part < 0).astype("<u4") << 9) << at
        rotations = words.tobytes()
    head = struct.pack("<4sIIBBBB", b"NGSP", version, n, scene.sh_degree, 12, 1, 0)
    as_bytes = [
        opacities(scene) * 255,
        (scene.sh[:, 0] * 0.15 + 0.5) * 255,
        (scene.log_scales + 10) * 16,
    ]
    alphas, colours, scales = (
        np.rint(part).clip(0, 255).astype(np.uint8).tobytes() for part in as_bytes
    )
    sh = (np.rint(scene.sh[:, 1:] * 128) + 128).clip(0, 255).astype(np.uint8).tobytes()
    return gzip.compress(head + positions + alphas + colours + scales + rotations + sh)


def webp(values, width=16):
    """A picture that has these bytes, (N, 1 to 4), as its first pixels."""
    height = -(-len(values) // width)
    pixels = np.zeros((width * height, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(values), : values.shape[1]] = values
    stream = BytesIO()
    image = Image.fromarray(pixels.reshape(height, width, 4), "RGBA")
    image.save(stream, "WEBP", lossless=True, exact=True)
    return stream.getvalue()


def sog_1(scene):
    """The files of a `.sog` of version 1, which has ranges and no codebooks."""
    logs = np.sign(scene.means) * np.log1p(np.abs(scene.means))
    low, high = logs.min(0), logs.max(0)
    steps = np.rint((logs - low) / (high - low) * 65535).astype(np.uint16)
    largest, rest = largest_and_rest(unit(scene.quats))
    three = np.rint((rest * 2**0.5 + 1) * 127.5).clip(0, 255)
    colours = np.concatenate([scene.sh[:, 0], scene.opacity_logits[:, None]], axis=1)

    def in_bytes(values):
        least, most = values.min(0), values.max(0)
        part = np.rint((values - least) / (most - least) * 255).astype(np.uint8)
        return part, {"mins": least.tolist(), "maxs": most.tolist()}

    scale_bytes, scale_range = in_bytes(scene.log_scales)
    colour_bytes, colour_range = in_bytes(colours)
    k = scene.sh.shape[1] - 1
    palette, (rest_low, rest_high) = scene.sh[:, 1:], (scene.sh.min(), scene.sh.max())
    entries = np.zeros((64, k, 3), np.uint8)
    entries[: len(scene)] = np.rint((palette - rest_low) / (rest_high - rest_low) * 255)
    n = len(scene)
    labels = np.arange(n, dtype=np.uint8)[:, None] * [1, 0]
    meta = {
        "means": {
            "shape": [n, 3], "mins": low.tolist(), "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {**scale_range, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {**colour_range, "files": ["sh0.webp"]},
        "shN": {
            "mins": float(rest_low), "maxs": float(rest_high),
            "files": ["centroids.webp", "labels.webp"],
        },
    }  # fmt: skip
    if not k:
        del meta["shN"]
    return {
        "meta.json": json.dumps(meta).encode(),
        "means_l.webp": webp(steps & 255),
        "means_u.webp": webp(steps >> 8),
        "scales.webp": webp(scale_bytes),
        "quats.webp": webp(np.concatenate([three, largest[:, None] + 252], axis=1)),
        "sh0.webp": webp(colour_bytes),
        "centroids.webp": webp(entries.reshape(-1, 3), 64 * k) if k else b"",
        "labels.webp": webp(labels),
    }


def with_words(data, **words):
    """The data with little-endian words at offsets: `at_8=1`."""
    out = bytearray(data)
    for name, value in words.items():
        size = 8 if name.startswith("q") else 4
        at = int(name.split("_")[1])
        out[at : at + size] = value.to_bytes(size, "little")
    return bytes(out)
