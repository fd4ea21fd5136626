"""Reading any 3DGS `.ply`, refusing everything else in one line, and writing atomically."""

import contextlib
import errno
import gzip
import os
import stat
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement

from evogs_codec.errors import InputError
from evogs_codec.format.layout import SIGNATURE
from evogs_codec.io.files import write_atomic
from evogs_codec.io.finite import OPAQUE, drop_non_finite, finite_opacities
from evogs_codec.io.ply import read_ply, write_ply
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.render.demo_scene import make_scene
from tests.support.examples import examples
from tests.support.strategies import splats

FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")


def scene_of(n, degree):
    """Splats whose every number is different."""
    d = n_channels(degree)
    return SplatParams.from_channels(np.arange(d * n, dtype=np.float32).reshape(d, n) / 7 - 3)


def columns_of(scene):
    """{property: (N,)} as the INRIA trainer names them, with its normals."""
    k = scene.sh.shape[1] - 1
    columns = {name: scene.means[:, i] for i, name in enumerate("xyz")}
    columns |= {name: np.zeros(len(scene)) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{c}": scene.sh[:, 0, c] for c in range(3)}
    columns |= {f"f_rest_{c * k + j}": scene.sh[:, 1 + j, c] for c in range(3) for j in range(k)}
    columns |= {"opacity": scene.opacity_logits}
    columns |= {f"scale_{i}": scene.log_scales[:, i] for i in range(3)}
    return columns | {f"rot_{i}": scene.quats[:, i] for i in range(4)}


def ply_bytes(columns, form="binary_little_endian", kind="float", before=b"", after=b"", **other):
    """A `.ply` made without the code under test; `other` gives header lines around the vertices."""
    n = len(next(iter(columns.values())))
    lines = ["ply", f"format {form} 1.0", *other.get("first", ()), f"element vertex {n}"]
    lines += [f"property {kind} {name}" for name in columns]
    lines += [*other.get("last", ()), "end_header", ""]
    newline = other.get("newline", "\n")
    table = np.array(list(columns.values()), np.float64).T
    if form == "ascii":
        rows = [" ".join(repr(float(x)) for x in row) for row in table]
        body = "".join(row + newline for row in rows).encode()
    else:
        order = "<" if form == "binary_little_endian" else ">"
        body = table.astype(order + ("f4" if kind == "float" else "f8")).tobytes()
    return newline.join(lines).encode() + before + body + after


def assert_same(one, other):
    np.testing.assert_array_equal(one.channels(), other.channels())
    assert one.sh_degree == other.sh_degree


@pytest.fixture
def read(tmp_path):
    def read_bytes(data):
        path = tmp_path / "scene.ply"
        path.write_bytes(data)
        return read_ply(path)

    return read_bytes


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["LF", "CRLF", "CR"])
@pytest.mark.parametrize("kind", ["float", "double"])
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("degree", range(4))
def test_every_degree_format_type_and_line_end_is_read(read, degree, form, kind, newline):
    scene = scene_of(5, degree)
    assert_same(read(ply_bytes(columns_of(scene), form, kind, newline=newline)), scene)


@given(scene=splats())
@examples(40)
def test_what_is_written_is_read_back_exactly(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("ply") / "scene.ply"
    write_ply(path, scene)
    assert_same(read_ply(path), scene)


def test_properties_in_any_order_and_unknown_ones_are_fine(read):
    scene = scene_of(4, 1)
    columns = dict(reversed(columns_of(scene).items())) | {"label": np.arange(4)}
    assert_same(read(ply_bytes(columns)), scene)


def test_more_splats_than_one_block_are_read(read):
    scene = make_scene(10_000)
    assert_same(read(ply_bytes(columns_of(scene))), scene)


@pytest.mark.parametrize("form", FORMATS)
def test_elements_before_and_after_the_vertices_are_ignored(read, form):
    scene = scene_of(3, 0)
    extra = b"1 2\n3 4\n" if form == "ascii" else bytes(4)
    chunk = ["element chunk 2", "property uchar a", "property uchar b"]
    face = ["element face 1", "property list uchar int vertex_indices"]
    data = ply_bytes(columns_of(scene), form, before=extra, first=chunk, last=face, after=b"\x00")
    assert_same(read(data), scene)


@pytest.mark.parametrize("form", FORMATS)
def test_lists_before_the_vertices_are_skipped(read, form):
    scene = scene_of(3, 0)
    lists = b"2 7 8\n0\n" if form == "ascii" else b"\x02\x07\x08\x00"
    face = ["element face 2", "property list uchar uchar vertex_indices"]
    assert_same(read(ply_bytes(columns_of(scene), form, before=lists, first=face)), scene)


def test_comments_of_any_bytes_are_ignored(read):
    scene = scene_of(2, 0)
    data = ply_bytes(
        columns_of(scene), first=["comment element vertex 99", "obj_info é", "comment"]
    )
    assert_same(read(data), scene)


@pytest.mark.parametrize("form", FORMATS)
def test_a_file_of_no_vertices_has_no_splats(read, form):
    scene = scene_of(0, 2)
    assert_same(read(ply_bytes(columns_of(scene), form)), scene)


@pytest.mark.parametrize("form", FORMATS)
def test_numbers_that_are_not_finite_come_as_they_are_and_can_be_dropped(read, form):
    scene = scene_of(5, 1)
    columns = {name: column.copy() for name, column in columns_of(scene).items()}
    columns["x"][1], columns["f_rest_8"][3], columns["opacity"][4] = np.nan, np.inf, np.nan
    found = read(ply_bytes(columns, form))
    assert found.finite().tolist() == [True, False, True, False, False]
    kept, n_dropped = drop_non_finite(found)
    assert n_dropped == 3
    assert_same(kept, scene.take(np.array([0, 2])))
    assert drop_non_finite(scene) == (scene, 0)


@pytest.mark.parametrize("form", FORMATS)
def test_infinite_opacities_become_finite_and_are_counted(read, form):
    scene = scene_of(6, 1)
    columns = columns_of(scene) | {"opacity": np.array([1, np.inf, -np.inf, 40, np.nan, -2])}
    with pytest.warns(UserWarning, match=r"scene\.ply: 2 of 6 splats have an infinite opacity"):
        found = read(ply_bytes(columns, form))
    np.testing.assert_array_equal(found.opacity_logits, [1, OPAQUE, -OPAQUE, 40, np.nan, -2])
    assert_same(replace(found, opacity_logits=scene.opacity_logits), scene)


def test_a_finite_opacity_for_infinity_is_all_or_nothing_in_float32():
    scene = replace(scene_of(3, 0), opacity_logits=np.array([np.inf, -np.inf, 3], np.float32))
    found, n = finite_opacities(scene)
    x = found.opacity_logits
    assert (n, x[2]) == (2, 3)
    rounded = x[0] - np.float32(2.5)  # as a quantiser may
    assert 1 / (1 + np.exp(-x[0])) == 1 / (1 + np.exp(-rounded)) == np.float32(1)
    assert 1 / (1 + np.exp(-(x[1] + np.float32(2.5)))) < 1 / 255 / 1000
    assert finite_opacities(found) == (found, 0)


def test_a_double_beyond_float32_becomes_infinite(read):
    columns = columns_of(scene_of(2, 0)) | {"x": np.array([1e300, 1])}
    assert read(ply_bytes(columns, kind="double")).finite().tolist() == [False, True]


def zip_of(name):
    """A zip with one file."""
    data = BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr(name, b"x")
    return data.getvalue()


GOOD = ply_bytes(columns_of(scene_of(3, 1)))
GOOD_TEXT = ply_bytes(columns_of(scene_of(3, 1)), "ascii")
POINTS = ply_bytes({name: np.zeros(2) for name in ("x", "y", "z", "red", "green", "blue")})
NO_ROT = {name: c for name, c in columns_of(scene_of(2, 0)).items() if name != "rot_3"}
NO_DEPTH = {name: c for name, c in columns_of(scene_of(2, 0)).items() if name != "scale_2"}
EIGHT_REST = {name: c for name, c in columns_of(scene_of(2, 1)).items() if name != "f_rest_8"}
RENAMED = {("f_rest_9" if k == "f_rest_4" else k): c for k, c in columns_of(scene_of(2, 1)).items()}
TWELVE = columns_of(scene_of(2, 1)) | {f"f_rest_{i}": np.zeros(2) for i in (9, 10, 11)}
PACKED = {"packed_position": np.zeros(2), "packed_rotation": np.zeros(2)}
LIST = ["property list uchar float w"]
BAD = {
    "empty": (b"", "is empty; expected a 3DGS .ply"),
    "four bytes": (b"abcd", "does not start with the line 'ply'"),
    "zeros": (bytes(1000), "has only zeros, as of an interrupted copy or download: get the file"),
    "spz 4": (b"NGSP\4\0\0\0", "is an .spz: `read_scene` reads it"),
    "spz 1 to 3": (gzip.compress(b"NGSP\3\0\0\0" + bytes(90)), "is an .spz: `read_scene`"),
    "gzip": (gzip.compress(b"ply\n"), "is compressed with gzip: unpack it first"),
    "cut gzip": (b"\x1f\x8b\x08", "is compressed with gzip: unpack it first"),
    "no gzip": (b"\x1f\x8b" + bytes(range(200)), "is compressed with gzip: unpack it first"),
    "glb": (b"glTF\2\0\0\0", "is a .glb: `read_scene` reads it"),
    "stream": (SIGNATURE, "is an EvoGS stream: `evogs decode"),
    "sog": (zip_of("meta.json"), "is a .sog: `read_scene` reads it"),
    "zip of a ply": (zip_of("a/Scene.PLY"), "is a zip with a .ply in it: unpack it first"),
    "zip": (zip_of("x"), "is a zip, not a scene: give a 3DGS .ply"),
    "cut zip": (zip_of("meta.json")[:20], "is a zip, not a scene: give a 3DGS .ply"),
    "png": (b"\x89PNG\r\n\x1a\n", "is a PNG, not a scene: give a 3DGS .ply"),
    "jpeg": (b"\xff\xd8\xff\xe0", "is a JPEG, not a scene: give a 3DGS .ply"),
    "page": (b"\n<!DOCTYPE html><html>", "is a web page, as where a download needs a login"),
    "LFS": (b"version https://git-lfs.github.com/spec/v1\n", "is a pointer of Git LFS"),
    "plywood": (b"plywood", "does not start"),
    "only ply": (b"ply\n", "no line 'end_header'"),
    "endless header": (b"ply\n" + b"comment x\n" * 200_000, "no line 'end_header'"),
    "header cut": (GOOD[:300], "no line 'end_header'; is the file cut short"),
    "no format": (GOOD.replace(b"format binary_little_endian 1.0\n", b""), "the header is not"),
    "strange format": (GOOD.replace(b"binary_little", b"binary_middle"), "the header is not"),
    "strange type": (GOOD.replace(b"float x", b"quad x"), "the header is not"),
    "strange count": (GOOD.replace(b"vertex 3", b"vertex three"), "expected 'element NAME COUNT'"),
    "negative count": (GOOD.replace(b"vertex 3", b"vertex -3"), "expected 'element NAME COUNT'"),
    "count of 20 digits": (GOOD.replace(b"vertex 3", b"vertex " + b"9" * 20), "element NAME COUNT"),
    "underscores": (GOOD.replace(b"vertex 3", b"vertex 1_000_000_000_000"), "NAME COUNT"),
    "vertices twice": (
        GOOD.replace(b"end_h", b"element vertex 1\nend_h"),
        "two elements with same",
    ),
    "property twice": (GOOD.replace(b"float nx", b"float x"), "two properties with same name"),
    "no vertices": (GOOD.replace(b"element vertex", b"element point"), "no element 'vertex' (elem"),
    "a point cloud": (POINTS, "no vertex property f_dc_0, f_dc_1, f_dc_2, opacity"),
    "a cloud by its name": (POINTS, "rot_3; this is a point cloud or a mesh, without splats"),
    "2DGS": (ply_bytes(NO_DEPTH), "no vertex property scale_2; flat splats of 2DGS"),
    "compressed": (ply_bytes(PACKED), "`evogs convert` makes a plain one"),
    "a property missing": (ply_bytes(NO_ROT), "no vertex property rot_3; expected a 3DGS .ply"),
    "eight f_rest": (ply_bytes(EIGHT_REST), "8 properties f_rest_*; expected 0, 9, 24 or 45"),
    "twelve f_rest": (ply_bytes(TWELVE), "12 properties f_rest_*; expected 0, 9, 24 or 45"),
    "a gap in f_rest": (ply_bytes(RENAMED), "no vertex property f_rest_4; expected f_rest_0 to"),
    "a list": (ply_bytes(columns_of(scene_of(1, 0)), last=LIST), "'w' is a list; expected only"),
    "last byte cut": (GOOD[:-1], "cut short: 3 vertices need 312 bytes, there are 311"),
    "body cut": (GOOD[:-200], "cut short"),
    "2**40 vertices": (GOOD.replace(b"vertex 3", b"vertex 1099511627776"), "cut short"),
    "2**40 ASCII": (GOOD_TEXT.replace(b"vertex 3", b"vertex 1099511627776"), "cut short"),
    "ASCII row cut": (GOOD_TEXT[:-150], "a vertex row is not 26 numbers"),
    "ASCII rows missing": (GOOD_TEXT.replace(b"vertex 3", b"vertex 4"), "the header says 4"),
    "ASCII word": (GOOD_TEXT[:-6] + b"x\n", "a vertex row is not 26 numbers"),
    "ASCII of wide rows": (GOOD_TEXT.replace(b"property float nx\n", b""), "have 26 numbers"),
    "list body cut": (
        ply_bytes(columns_of(scene_of(3, 0)), first=["element f 1", "property list uchar int i"]),
        "the body does not fit its header",
    ),
}


@pytest.mark.parametrize(("data", "message"), BAD.values(), ids=BAD.keys())
def test_a_bad_file_is_refused_in_one_line_that_names_it(read, data, message):
    with pytest.raises(InputError) as refused:
        read(data)
    text = str(refused.value)
    assert message in text
    assert "scene.ply: " in text
    assert "\n" not in text


@pytest.mark.parametrize("name", ["a.splat", "a.KSPLAT"])
def test_what_has_no_magic_is_told_by_its_name(tmp_path, name):
    (tmp_path / name).write_bytes(bytes(range(1, 65)))
    with pytest.raises(InputError, match=rf"seems to be a {name[1:].lower()}: `read_scene`"):
        read_ply(tmp_path / name)


def test_a_folder_or_an_absent_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"is not a file; expected a 3DGS \.ply"):
        read_ply(tmp_path)
    with pytest.raises(InputError, match=r"absent\.ply: cannot be read: No such file"):
        read_ply(tmp_path / "absent.ply")


@given(cut=st.integers(0, len(GOOD) - 1))
@examples(60)
def test_every_prefix_is_refused(tmp_path_factory, cut):
    path = tmp_path_factory.getbasetemp() / "prefix.ply"
    path.write_bytes(GOOD[:cut])
    with pytest.raises(InputError):
        read_ply(path)


@given(data=st.data())
@examples(150)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(tmp_path_factory, data):
    damaged = bytearray(data.draw(st.sampled_from([GOOD, GOOD_TEXT])))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged.ply"
    path.write_bytes(damaged)
    with contextlib.suppress(InputError):
        assert read_ply(path).sh_degree in range(4)


def test_comments_are_written_and_the_header_is_that_of_the_inria_layout(tmp_path):
    path = tmp_path / "scene.ply"
    write_ply(path, scene_of(1, 1), ["made by a test"])
    header = path.read_bytes().split(b"end_header\n")[0].decode().splitlines()
    assert header[:4] == [
        "ply",
        "format binary_little_endian 1.0",
        "comment made by a test",
        "element vertex 1",
    ]
    names = [line.split()[-1] for line in header[4:]]
    expected = [name for name in columns_of(scene_of(1, 1)) if name not in ("nx", "ny", "nz")]
    assert names == expected
    with pytest.raises(ValueError, match="newline"):
        write_ply(path, scene_of(1, 0), ["two\nlines"])
    assert [file.name for file in tmp_path.iterdir()] == ["scene.ply"]


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "out.bin"
    path.write_bytes(b"old")

    def fail(stream):
        stream.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left") as full:
        write_atomic(path, fail)
    assert full.value.filename == str(path)
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["out.bin"]


def test_a_write_replaces_the_file_with_the_usual_permissions(tmp_path):
    path = tmp_path / "out.bin"
    usual = tmp_path / "usual"
    usual.write_bytes(b"")
    write_atomic(path, b"one")
    write_atomic(str(path), lambda stream: stream.write(b"two"))
    assert path.read_bytes() == b"two"
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(usual.stat().st_mode)


def test_a_write_through_a_link_keeps_the_link_and_devices_stay_devices(tmp_path):
    real, link = tmp_path / "real", tmp_path / "link"
    real.write_bytes(b"old")
    link.symlink_to(real)
    write_atomic(link, b"new")
    assert link.is_symlink()
    assert real.read_bytes() == b"new"
    write_atomic(os.devnull, b"gone")
    assert Path(os.devnull).is_char_device()


def test_an_output_that_cannot_be_made_is_named_in_the_error(tmp_path):
    with pytest.raises(IsADirectoryError) as folder:
        write_atomic(tmp_path, b"")
    assert folder.value.filename == str(tmp_path)
    with pytest.raises(FileNotFoundError) as absent:
        write_atomic(tmp_path / "no" / "out", b"")
    assert absent.value.filename == str(tmp_path / "no" / "out")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into any folder")
def test_a_read_only_folder_is_named_in_the_error(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError) as refused:
        write_atomic(tmp_path / "out", b"")
    assert refused.value.filename == str(tmp_path / "out")


def test_the_real_half_million_splats_are_read(shared):
    scene = read_ply(shared / "data" / "playbot" / "playbot.ply")
    assert (len(scene), scene.sh_degree) == (500_000, 2)
    assert scene.finite().all()


def test_a_warning_counts_the_splats_that_float32_moves(tmp_path):
    scene = make_scene(50)
    columns = {name: np.array(values, np.float64) for name, values in columns_of(scene).items()}
    columns["x"][:20] += 5e6
    columns["x"][20:] += 1e-9  # less than float32 tells, and nothing to see
    rows = np.zeros(50, [(name, "<f8") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    PlyData([PlyElement.describe(rows, "vertex")]).write(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match="float32 moves .* splats by more than a tenth") as said:
        read_ply(tmp_path / "a.ply")
    assert 10 <= int(str(said[0].message).split("moves ")[1].split()[0]) <= 20
