"""`.tree.npz`: bad, forged and damaged files are refused."""

import contextlib
import io
import struct
import zipfile
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec.errors import InputError
from evogs_codec.io.tree_npz import read_tree
from tests.support.examples import examples
from tests.support.tree_files import RECORDS, REFINE, file_of, npz_bytes, read_back

GOOD = npz_bytes(file_of([1, 2, 3], RECORDS))


@pytest.fixture
def read(tmp_path):
    """Write arrays as a `.tree.npz`, and read it."""
    return lambda data: read_back(tmp_path, data)


# --- bad files ------------------------------------------------------------------------------------


def put(key, row, value):
    def change(data):
        data[key] = data[key].copy()
        data[key][row] = value

    return change


def swap(key, value):
    def change(data):
        data[key] = value

    return change


def remove(key):
    return lambda data: data.pop(key)


def rename_level(data):
    for key in [key for key in data if key.startswith("L2_")]:
        data["L4_" + key[3:]] = data.pop(key)


BAD = {
    "no format": (remove("format"), "format is missing"),
    "another format": (swap("format", np.array("evogs-tree 2")), "expected 'evogs-tree 1'"),
    "a number as format": (swap("format", np.array(1.0)), "format is float64 of shape ()"),
    "no roots": (remove("means"), "means is missing"),
    "no kind": (remove("L1_kind"), "L1_kind is missing"),
    "no psi": (remove("L2_psi_sh"), "L2_psi_sh is missing"),
    "a level missing": (rename_level, "L2_slot is missing, but there is a level 4"),
    "a huge level": (swap("L999999999999_slot", np.zeros(0)), "L3_slot is missing, but"),
    "a misspelt key": (remove("L1_slot"), "L1_slot is missing"),
    "roots of 2-D opacity": (swap("opacity_logits", np.zeros((3, 1))), "expected (3,)"),
    "scalar roots": (swap("means", np.array(1.0)), "means has shape (), expected (0, 3)"),
    "flat SH": (swap("sh", np.zeros((3, 3))), "sh has shape (3, 3), expected (N, K, 3)"),
    "five coefficients": (swap("sh", np.zeros((3, 5, 3))), "sh 5 SH coefficients are no degree"),
    "another degree": (swap("L1_psi_sh", np.zeros((4, 4, 3))), "expected (4, 1, 3)"),
    "too many psi": (swap("L1_psi_quats", np.zeros((5, 4))), "L1_psi_quats has shape (5, 4)"),
    "four alphas": (swap("L1_alpha", np.zeros((4, 4))), "L1_alpha has shape (4, 4), expected"),
    "scalar slot": (swap("L1_slot", np.array(3)), "L1_slot has shape (), expected (0,)"),
    "integer means": (swap("means", np.zeros((3, 3), int)), "means is int64, expected float32"),
    "float slots": (swap("L1_slot", np.zeros(4)), "L1_slot is float64, expected integers"),
    "text slots": (swap("L1_slot", np.array(list("abcd"))), "L1_slot is <U1, expected integers"),
    "objects": (swap("L1_slot", np.array([None] * 4)), "L1_slot holds Python objects"),
    "NaN root": (put("quats", 1, np.nan), "quats row 1 has a number that is not finite"),
    "NaN psi": (put("L1_psi_sh", 1, np.nan), "L1_psi_sh row 1 has a number"),
    "NaN add": (put("L1_psi_means", 3, np.inf), "L1_psi_means row 3 has a number"),
    "NaN alpha": (put("L1_alpha", 0, np.nan), "L1_alpha row 0 has a number"),
    "1e300": (swap("means", np.full((3, 3), 1e300)), "means row 0 has a number that is not"),
    "unknown kind": (put("L1_kind", 1, 4), "L1_kind row 1 is 4, expected 0 to 3"),
    "an add with a slot": (put("L1_slot", 3, 0), "L1_slot row 3 is 0, expected -1 for an add"),
    "a split of slot -1": (put("L1_slot", 0, -1), "L1_slot row 0 is -1, expected the slot of"),
    "slot -2": (put("L1_slot", 0, -2), "L1_slot row 0 is -2, expected -1 to"),
    "slot too high": (put("L1_slot", 0, 3), "L1_slot row 0 is 3, but before its generation"),
    "a huge slot": (swap("L1_slot", np.array([2**40, 1, 2, -1])), "row 0 is 1099511627776"),
    "uint64 slot": (swap("L1_slot", np.full(4, 2**64 - 1, np.uint64)), "row 0 is 184467440737"),
    "slot twice": (put("L1_slot", 1, 0), "L1_slot row 1 is 0, as an earlier row"),
    "dropped slot": (put("L2_slot", 0, 2), "L2_slot row 0 is 2, which was dropped earlier"),
    "quanta of two levels": (swap("quanta", np.ones((3, 5))), "quanta has shape (3, 5), expected"),
    "a quantum of 0": (swap("quanta", np.eye(4, 5)), "quanta row 0 has a number that is not"),
    "a negative generation": (swap("L1_generation", np.array([0, -1, 0, 0])), "row 1 is -1"),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD.keys())
def test_a_bad_file_is_refused_in_one_line_that_names_file_key_and_row(read, change, message):
    data = file_of([1, 2, 3], RECORDS, [(0, REFINE, 0, 1, 0)])
    assert read(data).n_leaves == 4
    change(data)
    with pytest.raises(InputError) as refused:
        read(data)
    text = str(refused.value)
    assert message in text
    assert "t.tree.npz: " in text
    assert "\n" not in text


@pytest.mark.parametrize("data", [b"", b"abcd", bytes(999), b"ply\n", GOOD[:-1], GOOD[:99]])
def test_a_file_that_is_no_npz_is_refused(tmp_path, data):
    path = tmp_path / "t.tree.npz"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"t\.tree\.npz: is not a \.npz or is cut short"):
        read_tree(path)


def test_a_folder_or_an_absent_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="is not a file"):
        read_tree(tmp_path)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_tree(tmp_path / "absent.tree.npz")


def test_a_level_of_5000_digits_is_refused(read):
    with pytest.raises(InputError, match="is a level of 5000 digits"):
        read(file_of([1]) | {f"L{'9' * 5000}_slot": np.zeros(0)})


# --- forged files ---------------------------------------------------------------------------------


def forged(header, body=b"", claimed=None):
    """A `.npz` whose `means` has this `.npy` header, and whose directory claims a size."""
    stream = io.BytesIO()
    np.savez(stream, **{k: v for k, v in file_of([1]).items() if k != "means"})
    head = header.encode() + b"\n"
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + body
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("means.npy", npy)
    data = bytearray(stream.getvalue())
    if claimed is not None:
        entry = data.rindex(b"PK\x01\x02", 0, data.rindex(b"means.npy"))
        data[entry + 24 : entry + 28] = struct.pack("<I", claimed)
    return bytes(data)


HUGE = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000, 3)}"


FORGED = {
    "a shape beyond its bytes": (forged(HUGE), "has shape (1000000000, 3) of float32, which its"),
    "a size beyond its bytes": (forged(HUGE, claimed=4_000_000_000), "claims to hold"),
    "negative sizes": (
        forged("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -3)}"),
        "a side below 0",
    ),
    "no dictionary": (forged("[" * 50), "means cannot be read"),
    "no Python": (forged("}{'"), "means cannot be read"),
    "a strange type": (forged("{'descr': 'q9', 'fortran_order': 0, 'shape': ()}"), "cannot be"),
    "a type that is no Python": (
        forged("{'descr': ',U12', 'fortran_order': False, 'shape': ()}"),
        "means cannot be read",
    ),
    "a number of 5000 digits": (
        forged(f"{{'descr': '<f4', 'fortran_order': False, 'shape': (0x{'f' * 5000},)}}"),
        "a side below 0 or above",
    ),
    "a deep header": (forged("-" * 9000 + "1"), "means cannot be read"),
    "a header of 60 kB": (forged(HUGE.ljust(60_000)), "means cannot be read"),
}


@pytest.mark.parametrize(("data", "message"), FORGED.values(), ids=FORGED.keys())
def test_a_forged_file_is_refused_before_its_arrays_are_made(tmp_path, data, message):
    path = tmp_path / "t.tree.npz"
    path.write_bytes(data)
    with pytest.raises(InputError) as refused:
        read_tree(path)
    assert message in str(refused.value)


def test_a_number_that_is_no_character_is_refused(tmp_path):
    data = file_of([1])
    data["format"] = np.array([0x7FFFFFFF] * 12, np.uint32).view("<U12")
    path = tmp_path / "t.tree.npz"
    np.savez(path, **data)
    with pytest.raises(InputError, match="format cannot be read"):
        read_tree(path)


# --- damaged files --------------------------------------------------------------------------------


def test_arrays_that_the_directory_skips_are_noticed(tmp_path):
    # The comment of an entry of the directory is said to be so long that it holds all others.
    data = bytearray(npz_bytes(file_of([1, 2, 3], RECORDS) | {"quanta": np.full((3, 5), 0.25)}))
    at = data.find(b"sh.npy", data.find(b"PK\x01\x02")) - 46
    assert data[at : at + 4] == b"PK\x01\x02"
    data[at + 33] = 0x7F
    path = tmp_path / "t.tree.npz"
    path.write_bytes(data)
    with pytest.raises(InputError, match="says that it holds 16 arrays, and does not"):
        read_tree(path)


def test_a_name_that_is_damaged_in_the_directory_is_noticed(tmp_path):
    data = bytearray(npz_bytes(file_of([1, 2, 3], RECORDS) | {"quanta": np.full((3, 5), 0.25)}))
    data[data.rfind(b"quanta")] ^= 1
    path = tmp_path / "t.tree.npz"
    path.write_bytes(data)
    with pytest.raises(InputError, match="puanta"):
        read_tree(path)


def repaired(data):
    """`data` with the CRC-32 of every stored entry recomputed, as far as that is possible."""
    out = bytearray(data)
    at = out.find(b"PK\x01\x02")
    while at >= 0:
        size, name_size = struct.unpack_from("<I4xH", out, at + 20)
        (local,) = struct.unpack_from("<I", out, at + 42)
        if local + 30 <= len(out):
            start = local + 30 + sum(struct.unpack_from("<HH", out, local + 26))
            struct.pack_into("<I", out, at + 16, zlib.crc32(out[start : start + size]))
        at = out.find(b"PK\x01\x02", at + 46 + name_size)
    return bytes(out)


@given(data=st.data())
@examples(300)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(tmp_path_factory, data):
    damaged = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.getbasetemp() / "damaged.tree.npz"
    path.write_bytes(repaired(damaged) if data.draw(st.booleans()) else damaged)
    with contextlib.suppress(InputError):
        assert read_tree(path).n_levels in range(3)
