"""Damaged and hostile files of every format: one line each, and memory in proportion to the file.

For each format: files that are cut short, with bits changed, of zeros, with counts and sizes that
are not true, and bombs.
"""

import gzip
import json
import random
import struct
import tracemalloc
import warnings
import zipfile
import zlib
from functools import cache
from io import BytesIO

import numpy as np
import pytest
import zstandard
from hypothesis import settings
from plyfile import PlyData

from evogs_codec import InputError, read_scene, write_scene
from evogs_codec.io.interchange.bounded import FREE
from tests.support import damaged_files as damage
from tests.support.odd_scenes import odd_scene
from tests.support.peer_files import FOLDER
from tests.support.scene_files import gltf_of, ksplat, old_spz, refusal, sog_1, with_words, zipped

MAX_SAID = 1000  # characters of a message
PEERS = (
    "gaussian-splats-3d-0.4.7-sh2-level0.ksplat",
    "gaussian-splats-3d-0.4.7-sh2-level2.ksplat",
    "splat-transform-2.7.1-sh2.sog",
)
# The file that is damaged; a format of several files is read by another one (READ_BY).
KINDS = {
    "ply": "x.ply",
    "ascii ply": "x.ply",
    "big-endian ply": "x.ply",
    "compressed ply": "x.ply",
    "spz 1": "x.spz",
    "spz 2": "x.spz",
    "spz 3": "x.spz",
    "spz 4": "x.spz",
    "splat": "x.splat",
    "ksplat 0": "x.ksplat",
    "ksplat 1": "x.ksplat",
    "ksplat 2": "x.ksplat",
    "sog 1": "x.sog",
    "sog 2": "x.sog",
    "sog, meta.json of a folder": "meta.json",
    "sog, picture of a folder": "means_l.webp",
    "glb": "x.glb",
    "gltf": "x.gltf",
    "gltf beside a buffer": "x.gltf",
    "buffer of a gltf": "x.bin",
}
READ_BY = {"means_l.webp": "meta.json", "x.bin": "x.gltf"}
ALONE = [kind for kind, name in KINDS.items() if name not in READ_BY]
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*(infinite opacity|no SH above|band 4|float32 moves)"
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The files of an undamaged scene of each kind, by their names; 20 or 48 splats."""
    folder, scene = tmp_path_factory.mktemp("whole"), odd_scene(20, 1)
    made = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for kind in ("ply", "compressed.ply", "spz", "splat", "glb"):
            write_scene(folder / f"x.{kind}", scene)
            made[kind] = (folder / f"x.{kind}").read_bytes()
    for kind, order, text in (("ascii ply", "=", True), ("big-endian ply", ">", False)):
        rows = PlyData.read(folder / "x.ply")
        rows.byte_order, rows.text = order, text
        rows.write(folder / "other.ply")
        made[kind] = (folder / "other.ply").read_bytes()
    embedded = gltf_of(made["glb"])
    buffer = made["glb"][28 + struct.unpack_from("<I", made["glb"], 12)[0] :]
    beside = embedded | {"buffers": [{"byteLength": len(buffer), "uri": "x.bin"}]}
    peers = {name: (FOLDER / name).read_bytes() for name in PEERS}
    with zipfile.ZipFile(BytesIO(peers["splat-transform-2.7.1-sh2.sog"])) as archive:
        sog_2 = {name: archive.read(name) for name in archive.namelist()}
    files = {
        "compressed ply": {"x.ply": made["compressed.ply"]},
        "spz 4": {"x.spz": made["spz"]},
        "ksplat 0": {"x.ksplat": peers["gaussian-splats-3d-0.4.7-sh2-level0.ksplat"]},
        "ksplat 1": {"x.ksplat": ksplat(scene)},
        "ksplat 2": {"x.ksplat": peers["gaussian-splats-3d-0.4.7-sh2-level2.ksplat"]},
        "sog 1": {"x.sog": zipped(sog_1(scene))},
        "sog 2": {"x.sog": peers["splat-transform-2.7.1-sh2.sog"]},
        "sog, meta.json of a folder": sog_2,
        "sog, picture of a folder": sog_1(scene),
        "gltf": {"x.gltf": json.dumps(embedded).encode()},
        "gltf beside a buffer": {"x.gltf": json.dumps(beside).encode(), "x.bin": buffer},
        "buffer of a gltf": {"x.gltf": json.dumps(beside).encode(), "x.bin": buffer},
    }
    files |= {f"spz {version}": {"x.spz": old_spz(scene, version)} for version in (1, 2, 3)}
    return {kind: files.get(kind) or {KINDS[kind]: made[kind]} for kind in KINDS}


def written(folder, files):
    """The path by which the files are read, once they are in the folder."""
    for name, data in files.items():
        (folder / name).write_bytes(data)
    name = next(iter({*files} & {*KINDS.values()} - {*READ_BY}))
    return folder / name


def damaged(files, kind, random_, number):
    """The files of a kind, of which one is cut short or has bits changed."""
    change = damage.cut_short if number % 2 else damage.flipped
    return files | {KINDS[kind]: change(files[KINDS[kind]], random_)}


@pytest.mark.parametrize("kind", KINDS)
def test_the_files_are_read_where_they_are_not_damaged(kind, whole, tmp_path):
    found = read_scene(written(tmp_path, whole[kind])).splats
    assert len(found) in (20, 48)
    assert found.finite().all()


@pytest.mark.random
@pytest.mark.parametrize("kind", KINDS)
def test_files_that_are_cut_short_or_have_bits_changed_are_read_or_refused(kind, whole, tmp_path):
    seed = 1 if settings().derandomize else random.SystemRandom().randrange(1 << 32)
    print(f"seed {seed}")
    random_, refused = random.Random(seed), 0
    for number in range(120):
        path = written(tmp_path, damaged(whole[kind], kind, random_, number))
        try:
            with np.errstate(all="ignore"):
                read_scene(path)
        except InputError as error:
            refused += 1
            said = str(error).removeprefix(str(path))
            assert said.isprintable()
            assert len(said) < MAX_SAID, said
    assert refused > (5 if kind == "splat" else 30)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_a_command_says_a_line_of_each_of_20_damaged_files(kind, whole, evogs, tmp_path):
    """A line of what is wrong, or a scene and lines of what was odd; no traceback."""
    random_, refused = random.Random(2), 0
    for number in range(20):
        path = written(tmp_path, damaged(whole[kind], kind, random_, number))
        tracemalloc.start()
        code, _, err = evogs("convert", path, tmp_path / "out.ply", "--force")
        assert tracemalloc.get_traced_memory()[1] < FREE + (64 << 20)
        tracemalloc.stop()
        lines = err.splitlines()
        assert all(line.startswith("evogs: ") and line.isprintable() for line in lines), err
        assert code in (0, 1)
        assert sum(not line.startswith("evogs: warning: ") for line in lines) == code, err
        refused += code
    assert refused >= (1 if kind == "splat" else 4)


@pytest.mark.parametrize("kind", KINDS)
def test_every_prefix_of_a_file_is_refused(kind, whole, tmp_path):
    data = whole[kind][KINDS[kind]]
    n_needed = len(data.rstrip())  # a line break at the end of a text may be missing
    ends = {*range(0, 80, 5), *(n_needed * i // 20 for i in range(1, 20)), n_needed - 1}
    for end in sorted(ends):
        if kind == "splat" and end % 32 == 0 and end > 0:
            continue  # whole splats: nothing tells that there were more
        if kind == "ascii ply" and end == n_needed - 1:
            continue  # the last number may have had fewer digits
        refusal(written(tmp_path, whole[kind] | {KINDS[kind]: data[:end]}))


@pytest.mark.parametrize("kind", ALONE)
@pytest.mark.parametrize("size", [0, 1, 32, 5000, 100_000])
def test_a_file_of_zeros_is_refused(kind, size, tmp_path):
    path = written(tmp_path, {KINDS[kind]: bytes(size)})
    assert ("only zeros" if size else "is empty") in refusal(path)


def test_spz_files_whose_counts_are_not_true_are_refused(whole, tmp_path):
    path, data = tmp_path / "x.spz", whole["spz 4"]["x.spz"]
    toc = 32
    changes = {
        "version 5": with_words(data, at_4=5),
        "version 0": with_words(data, at_4=0),
        "version 3": with_words(data, at_4=3),
        "more than 50 times": with_words(data, at_8=0xFFFFFFFF),
        "part 0 has": with_words(data, at_8=21),
        "SH degree 9": data[:12] + b"\x09" + data[13:],
        "at most 31": data[:13] + b"\x40" + data[14:],
        "table of contents": with_words(data, at_16=1 << 31),
        "its table of contents is": with_words(data, at_16=0),
        "cut short: part 0": with_words(data, q_32=1 << 62),
        "part 1 has": with_words(data, q_56=1 << 62),
        "expected 180": with_words(data, q_40=1 << 40),
        "no SH, but says": data[:15] + b"\x05" + data[16:],
        "Zstandard data is damaged": data[: toc + 96] + b"\xff" * (len(data) - toc - 96),
        "coordinate system 99": with_words(
            data[:14] + b"\x02" + data[15:32] + struct.pack("<III", 0xADBE0003, 4, 99) + data[32:],
            at_16=44,
        ),
    }
    for said, changed in changes.items():
        path.write_bytes(changed)
        assert said in refusal(path, 4 << 20)
    for said, head in {
        "more than 50 times": (3, 0xFFFFFFF0, 3, 12, 0),
        "cut short: it has": (2, 5000, 3, 12, 0),
        ".spz version 4 ": (9, 5, 0, 12, 0),
    }.items():
        if head[0] == 9:
            continue
        path.write_bytes(gzip.compress(struct.pack("<4sIIBBBx", b"NGSP", *head)))
        assert said in refusal(path)


def test_bombs_are_refused_before_they_unfold(tmp_path):
    path = tmp_path / "x.spz"
    n = 400_000_000
    gzip_bomb = zlib.compressobj(1, wbits=31)
    head = struct.pack("<4sIIBBBx", b"NGSP", 3, n, 3, 12, 0)
    bomb = gzip_bomb.compress(head) + gzip_bomb.compress(bytes(200 << 20)) + gzip_bomb.flush()
    path.write_bytes(bomb)
    assert "more than 50 times" in refusal(path)
    # One whose count is small, but whose gzip data is large: only what is needed is unfolded.
    head = struct.pack("<4sIIBBBx", b"NGSP", 3, 10, 0, 12, 0)
    path.write_bytes(gzip.compress(head + bytes(200 << 20), 1))
    tracemalloc.start()
    assert len(read_scene(path).splats) == 10
    assert tracemalloc.get_traced_memory()[1] < 8 << 20
    tracemalloc.stop()
    # Zstandard frames that state more than the table of contents does, or nothing.
    frames = [zstandard.ZstdCompressor(write_content_size=known).compress(bytes(300 << 20))
              for known in (True, False)]  # fmt: skip
    for frame in frames:
        sizes = (90, 10, 30, 30, 40)
        table = b"".join(struct.pack("<QQ", len(frame), size) for size in sizes)
        head = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 10, 0, 12, 0, 5, 32)
        path.write_bytes(head + table + frame * 5)
        refusal(path, 8 << 20)


def test_sog_files_that_are_not_what_they_say_are_refused(tmp_path):
    path, files = tmp_path / "x.sog", sog_1(odd_scene(20, 1))
    meta = json.loads(files["meta.json"])

    def changed(**parts):
        return files | {"meta.json": json.dumps(meta | parts).encode()}

    means, rest = meta["means"], meta["shN"]
    cases = {
        "version 3": changed(version=3),
        "version '": changed(version="'\x1b[31m"),
        "is no JSON object": files | {"meta.json": b"[1]"},
        "is not JSON": files | {"meta.json": b"[" * 200_000},
        "meta.json is not": files | {"meta.json": b"\xff\xfe"},
        "no object 'means'": changed(means=5),
        "has no shape": changed(means=means | {"shape": 3}),
        "no number of splats": changed(means=means | {"shape": [1e9, 3]}),
        "'count' of": changed(version=2, count=-1),
        "more than 50 times": changed(means=means | {"shape": [4_000_000_000, 3]}),
        "expected about 3,000": changed(means=means | {"shape": [3000, 3]}),
        "does not name 2 files": changed(means=means | {"files": ["a"]}),
        "no member": changed(means=means | {"files": ["a", "b"]}),
        "is not 3 numbers": changed(means=means | {"mins": [0, 1]}),
        "'mins' of 'means'": changed(means=means | {"mins": ["x", 1, 2]}),
        "too large": changed(means=means | {"mins": [10**400, 1, 2]}),
        "columns": changed(shN=rest | {"files": ["means_l.webp", "labels.webp"]}),
        "no object 'shN'": changed(shN=[1]),
        "is no picture": files | {"quats.webp": b"RIFF____WEBP"},
        "quats.webp is no": files | {"quats.webp": files["quats.webp"][:40]},
        "has 16 x 4 pixels": changed(sh0=meta["sh0"] | {"files": ["many.webp"]}),
    }
    cases["has 16 x 4 pixels"]["many.webp"] = files["quats.webp"]
    del cases["has 16 x 4 pixels"]
    for said, case in cases.items():
        path.write_bytes(zipped(case))
        assert said in refusal(path)


@cache
def test_sogs_whose_names_of_files_are_no_text_are_refused(tmp_path):
    """`zipfile` decodes the name before a file if its flags say that it is UTF-8."""
    path = tmp_path / "x.sog"
    data = bytearray(zipped(sog_1(odd_scene(20, 1))))
    flags, name = 6, 30  # offsets in the header before a file
    data[flags + 1] |= 0x08
    data[name] = 0xB0
    path.write_bytes(data)
    assert "the zip is damaged: 'utf-8' codec can't decode" in refusal(path)


def large_picture():
    """The bytes of a WebP of 64,000,000 equal pixels."""
    from PIL import Image

    stream = BytesIO()
    Image.new("RGBA", (8000, 8000)).save(stream, "WEBP", lossless=True)
    return stream.getvalue()


@pytest.mark.thorough
def test_pictures_and_zips_that_unfold_far_are_refused(tmp_path):
    path, files = tmp_path / "x.sog", sog_1(odd_scene(20, 1))
    path.write_bytes(zipped(files | {"quats.webp": large_picture()}))
    assert "8000 x 8000 pixels" in refusal(path, 8 << 20)
    path.write_bytes(zipped(files | {"quats.webp": bytes(200 << 20)}, zipfile.ZIP_DEFLATED))
    assert "more than 50 times" in refusal(path, 8 << 20)
    path.write_bytes(zipped(files | {"meta.json": b" " * (20 << 20)}))
    assert "at most" in refusal(path)
    folder = tmp_path / "folder"
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    meta = json.loads(files["meta.json"])
    meta["quats"]["files"] = ["../x.sog"]
    (folder / "meta.json").write_text(json.dumps(meta))
    assert "no name of a file beside it" in refusal(folder)
    (folder / "meta.json").unlink()
    with pytest.raises(InputError, match="is not a file"):
        read_scene(folder)


def test_compressed_plys_whose_counts_are_not_true_are_refused(whole, tmp_path):
    path, data = tmp_path / "x.ply", whole["compressed ply"]["x.ply"]
    cases = {
        "cut short": data.replace(b"element vertex 20", b"element vertex 999999999999"),
        "has 1 chunks": data.replace(b"element chunk 1", b"element chunk 0"),
        "of 20 splats": data.replace(b"float min_x", b"float min_q"),
        "expected 0, 9, 24": data.replace(b"uchar f_rest_8", b"uchar rest_8"),
        "expected 0, 9": data.replace(b"uchar f_rest_0", b"uchar f_rest_99"),
        "is text": data.replace(b"binary_little_endian", b"ascii"),
        "has lists": data.replace(
            b"element chunk", b"element a 0\nproperty list uchar int b\nelement chunk"
        ),
        "not a byte": data.replace(b"uchar f_rest_3", b"char f_rest_3"),
        "element sh is not": data.replace(b"element sh 20", b"element sh 19"),
        "of chunk end": data.replace(b"element chunk 1", b"element chunk 88888888"),
    }  # fmt: skip
    for said, case in cases.items():
        assert case != data
        path.write_bytes(case)
        assert said in refusal(path, 4 << 20)


def test_ksplats_whose_counts_are_not_true_are_refused(whole, tmp_path):
    path, data = tmp_path / "x.ksplat", whole["ksplat 1"]["x.ksplat"]
    cases = {
        "section headers": with_words(data, at_4=0xFFFFFFFF),
        "other than": with_words(data, at_16=21),
        "compression level 7": data[:20] + b"\x07\x00" + data[22:],
        "section 0 ends": with_words(data, at_4096=0xFFFFFFF0),
        "section 0 has SH degree": data[:4136] + b"\x09\x00" + data[4138:],
        "buckets that do not": with_words(data, at_4108=0),
        "cut short: section": with_words(data, at_4108=0xFFFFFFFF),
        "do not fit together": with_words(data, at_4128=0xFFFFFFFF),
        "fewer splats": with_words(data, at_5120=1),
        "its numbers are not": b"\x01\x00" + data[2:],
    }
    for said, case in cases.items():
        path.write_bytes(case)
        assert said in refusal(path, 4 << 20)


def test_splats_whose_numbers_are_no_scene_are_refused(tmp_path):
    path, random_ = tmp_path / "x.splat", random.Random(3)
    for n in (32, 320, 32_000, 32_001, 50):
        path.write_bytes(random_.randbytes(n))
        assert "not those of one" in refusal(path)
    path.write_bytes(b"a text of some lines\n" * 320)
    assert "not those of one" in refusal(path)
    path.with_suffix(".other").write_bytes(random_.randbytes(320))
    assert "expected a 3DGS .ply" in refusal(path.with_suffix(".other"))


def test_small_pictures_of_very_many_splats_are_refused(tmp_path):
    files = {name: large_picture() for name in sog_1(odd_scene(20, 1))}
    meta = json.loads(sog_1(odd_scene(20, 1))["meta.json"])
    meta["means"]["shape"] = [64_000_000, 3]
    path = tmp_path / "x.sog"
    path.write_bytes(zipped(files | {"meta.json": json.dumps(meta).encode()}))
    assert path.stat().st_size < 100_000
    assert "more than 50 times" in refusal(path, 4 << 20)
