"""`.tree.npz`: what is written reads back, row order is honoured, bad files are refused."""

import contextlib
import io
import struct
import zipfile
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evogs_codec.errors import InputError
from evogs_codec.io.tree_npz import read_tree, write_tree
from evogs_codec.model.channels import GROUP_CHANNELS, n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step
from tests.support.strategies import trees

REFINE, SPLIT, DROP, ADD = Kind
FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")


def arrays_of(values, degree=0, prefix=""):
    """Keys of splats whose every channel is the splat's one value."""
    channels = np.tile(np.array(values, np.float32), (n_channels(degree), 1))
    splats = SplatParams.from_channels(channels)
    return {prefix + name: np.array(getattr(splats, name)) for name in FIELDS}


def level_of(i, records, degree=0):
    """Keys of level `i`; a record is (slot, kind, generation, psi, alpha)."""
    slot, kind, generation, psi, alpha = zip(*records, strict=True) if records else ([],) * 5
    return {
        f"L{i}_slot": np.array(slot, np.int32),
        f"L{i}_kind": np.array(kind, np.uint8),
        f"L{i}_generation": np.array(generation, np.uint8),
        **arrays_of(psi, degree, f"L{i}_psi_"),
        f"L{i}_alpha": np.tile(np.array(alpha, np.float32)[:, None], (1, 5)),
    }


def file_of(roots, *levels, degree=0):
    data = {"format": np.array("evogs-tree 1")} | arrays_of(roots, degree)
    for i, records in enumerate(levels, 1):
        data |= level_of(i, records, degree)
    return data


def replay(data, level):
    """Leaves of a file by the letter of design.md, one record at a time: {slot: (D,)}."""

    def column(prefix, row):
        return np.concatenate([np.ravel(data[prefix + name][row]) for name in FIELDS]).astype(float)

    slots = {row: column("", row) for row in range(len(data["means"]))}
    n = len(slots)
    for i in range(1, level + 1):
        generations = data[f"L{i}_generation"].tolist()
        for row in sorted(range(len(generations)), key=lambda r: (generations[r], r)):
            slot, kind = int(data[f"L{i}_slot"][row]), data[f"L{i}_kind"][row]
            psi = column(f"L{i}_psi_", row)
            if kind == ADD:
                slots[n] = psi
                n += 1
                continue
            parent = slots.pop(slot)
            if kind == SPLIT:
                alpha = np.empty(len(psi))
                for group, channels in enumerate(GROUP_CHANNELS):
                    alpha[channels] = data[f"L{i}_alpha"][row, group]
                slots[n] = parent - alpha * psi
                n += 1
            if kind != DROP:
                slots[slot] = parent + psi
    return slots


def same_splats(leaves, slots):
    """The leaves are the splats of `slots`, in some order."""
    found = leaves.channels().T
    expected = np.array(list(slots.values()), np.float32).reshape(len(slots), found.shape[1])
    np.testing.assert_array_equal(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)])


@pytest.fixture
def read(tmp_path):
    def read_arrays(data):
        path = tmp_path / "t.tree.npz"
        np.savez(path, **data)
        return read_tree(path)

    return read_arrays


@given(tree=trees())
@settings(max_examples=80)
def test_a_written_tree_reads_back_with_the_same_leaves_at_every_level(tmp_path_factory, tree):
    path = tmp_path_factory.getbasetemp() / "t.tree.npz"
    write_tree(path, tree)
    again = read_tree(path)
    assert again.n_levels == tree.n_levels
    for level in range(tree.n_levels):
        expected = tree.leaves(level).channels()
        np.testing.assert_array_equal(again.leaves(level).channels(), expected)


@st.composite
def files(draw):
    """Arrays of a valid file, its records in any row order."""
    degree = draw(st.integers(0, 1))
    numbers = st.integers(-4, 4)
    roots = draw(st.lists(numbers, max_size=5))
    live, n, levels = list(range(len(roots))), len(roots), []
    for _ in range(draw(st.integers(0, 3))):
        records = []
        for generation in draw(st.lists(st.integers(0, 9), max_size=3, unique=True).map(sorted)):
            named = draw(st.lists(st.sampled_from(live), unique=True)) if live else []
            kinds = [draw(st.sampled_from([REFINE, SPLIT, DROP])) for _ in named]
            rows = list(zip(named, kinds, strict=True)) + [(-1, ADD)] * draw(st.integers(0, 2))
            rows = draw(st.permutations(rows))
            records += [(s, k, generation, draw(numbers), draw(numbers)) for s, k in rows]
            live = [slot for slot in live if (slot, DROP) not in rows]
            n_new = sum(kind in (SPLIT, ADD) for _, kind in rows)
            live += range(n, n + n_new)
            n += n_new
        levels.append(records)
    return file_of(roots, *levels, degree=degree)


@given(data=files())
@settings(max_examples=150)
def test_leaves_agree_with_a_replay_record_by_record_in_row_order(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "t.tree.npz"
    np.savez(path, **data)
    tree = read_tree(path)
    assert tree.n_levels == 1 + sum(key.endswith("_slot") for key in data)
    for level in range(tree.n_levels):
        same_splats(tree.leaves(level), replay(data, level))


def test_new_slots_are_numbered_in_row_order_and_named_by_later_generations(read):
    # Rows make slots 2 (add), 3 (C2 of 1) and 4 (C2 of 0); the tree has them as 4, 3 and 2.
    first = [(-1, ADD, 0, 100, 0), (1, SPLIT, 0, 1, 1), (0, SPLIT, 0, 2, 1)]
    later = [(4, REFINE, 1, 0.5, 0), (3, DROP, 1, 0, 0), (2, REFINE, 2, 7, 0)]
    tree = read(file_of([10, 20], first + later))
    assert [step.slots.tolist() for step in tree.steps] == [[], [0, 1], [2, 3], [4]]
    assert tree.leaves().opacity_logits.tolist() == [12, 21, 8.5, 107]


def test_generations_may_come_in_any_row_order_and_skip_numbers(read):
    rows = [(0, REFINE, 200, 1, 0), (1, REFINE, 3, 5, 0), (0, SPLIT, 3, 2, 1)]
    tree = read(file_of([0, 0], rows))
    assert len(tree.steps) == 3
    assert tree.leaves().opacity_logits.tolist() == [3, 5, -2]


def test_levels_without_records_are_kept(read):
    tree = read(file_of([1], [], [(0, REFINE, 0, 1, 0)], []))
    assert [step.level for step in tree.steps] == [0, 1, 2, 3]
    assert [tree.leaves(i).opacity_logits.tolist() for i in range(4)] == [[1], [1], [2], [2]]


def test_a_file_of_roots_only_is_a_tree_of_one_level(read):
    assert read(file_of([1, 2, 3])).n_levels == 1
    assert read(file_of([], degree=3)).n_leaves == 0


def test_other_number_types_and_unused_numbers_are_accepted(read):
    data = file_of([1.0, 2.0], [(0, DROP, 0, 0, 0), (1, REFINE, 0, 1, 0)], [])
    for key in ("L1_slot", "L1_kind", "L1_generation"):
        data[key] = data[key].astype(np.int64)
    data["L2_slot"] = np.zeros(0)  # what np.array([]) is
    data["means"] = data["means"].astype(np.float64)
    data["L1_psi_sh"] = data["L1_psi_sh"].astype(np.float16)
    data["L1_psi_means"][0] = np.nan  # of a drop
    data["L1_alpha"][:] = np.inf  # of no split
    data["author"] = np.array("somebody")
    data["means"] = np.asfortranarray(data["means"])
    assert read(data).leaves().opacity_logits.tolist() == [3]


def test_a_chain_of_64_generations_and_300_in_one_level_are_kept(tmp_path):
    d = n_channels(0)
    one = np.ones((d, 1), np.float32)
    for n in (64, 300):
        refine = Step(1, np.zeros(1, np.int32), np.zeros(1, np.uint8), one, one[:5, :0], one[:, :0])
        tree = EvolutionTree(0, (Step.of_adds(0, one), *[refine] * n))
        write_tree(tmp_path / "chain.tree.npz", tree)
        again = read_tree(tmp_path / "chain.tree.npz")
        assert len(again.steps) == n + 1
        assert again.leaves().opacity_logits.tolist() == [n + 1]


def test_quanta_are_kept(read):
    data = file_of([1.0, 2.0], [(0, SPLIT, 0, 0.5, 1.0)]) | {"quanta": np.full((3, 5), 0.25)}
    assert read(data).quanta == ((0.25,) * 5,) * 3


def test_writing_twice_gives_the_same_bytes(tmp_path):
    tree = EvolutionTree(0, (Step.of_adds(0, np.ones((n_channels(0), 2), np.float32)),))
    for name in ("a", "b"):
        write_tree(tmp_path / name, tree)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


RECORDS = [(0, SPLIT, 0, 1, 1), (1, REFINE, 0, 1, 0), (2, DROP, 0, 0, 0), (-1, ADD, 0, 9, 0)]


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


def npz_bytes(data, save=np.savez):
    stream = io.BytesIO()
    save(stream, **data)
    return stream.getvalue()


GOOD = npz_bytes(file_of([1, 2, 3], RECORDS))


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


def test_a_compressed_file_is_read(tmp_path):
    path = tmp_path / "t.tree.npz"
    path.write_bytes(npz_bytes(file_of([1, 2, 3], RECORDS), np.savez_compressed))
    assert read_tree(path).n_leaves == 4


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


def test_a_text_of_either_byte_order_is_read(read):
    for kind in ("<U13", ">U13", "S13"):
        assert read(file_of([1]) | {"format": np.array("evogs-tree 1", kind)}).n_leaves == 1


def test_a_level_of_5000_digits_is_refused(read):
    with pytest.raises(InputError, match="is a level of 5000 digits"):
        read(file_of([1]) | {f"L{'9' * 5000}_slot": np.zeros(0)})


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
@settings(max_examples=300)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(tmp_path_factory, data):
    damaged = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.getbasetemp() / "damaged.tree.npz"
    path.write_bytes(repaired(damaged) if data.draw(st.booleans()) else damaged)
    with contextlib.suppress(InputError):
        assert read_tree(path).n_levels in range(3)


def test_the_trained_tree_is_read_and_survives_a_round_trip(shared, tmp_path):
    tree = read_tree(shared / "data" / "trees" / "lego400.tree.npz")
    assert (tree.n_levels, tree.n_leaves, tree.sh_degree) == (4, 99_909, 2)
    assert len(tree.leaves(0)) == 1973
    write_tree(tmp_path / "t.tree.npz", tree)
    again = read_tree(tmp_path / "t.tree.npz")
    np.testing.assert_array_equal(again.leaves().channels(), tree.leaves().channels())


def test_the_trained_tree_agrees_with_a_replay_of_its_first_level(shared):
    path = shared / "data" / "trees" / "lego400.tree.npz"
    with np.load(path) as data:
        slots = replay(dict(data), 1)
    same_splats(read_tree(path).leaves(1), slots)
