"""Arrays of `.tree.npz` files, record by record."""

import io

import numpy as np

from evogs_codec.io.tree_npz import read_tree
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import Kind

REFINE, SPLIT, DROP, ADD = Kind
FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
RECORDS = [(0, SPLIT, 0, 1, 1), (1, REFINE, 0, 1, 0), (2, DROP, 0, 0, 0), (-1, ADD, 0, 9, 0)]


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


def npz_bytes(data, save=np.savez):
    stream = io.BytesIO()
    save(stream, **data)
    return stream.getvalue()


def read_back(folder, data):
    """The tree of the arrays `data`, written to `t.tree.npz` in a folder and read."""
    path = folder / "t.tree.npz"
    np.savez(path, **data)
    return read_tree(path)
