"""A kilometre of city, far from the origin, and an object of 5 cm in it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from evogs_codec import AccuracyWarning, decode, read_directory
from evogs_codec.jobs import Engine, JobOptions, encode_files
from evogs_codec.render.demo_scene import make_scene

pytest.importorskip("numba")

AT = np.array([1e6, 2e6, 300.0])
NAMES = [*"xyz", *(f"f_dc_{k}" for k in range(3)), "opacity"]
NAMES += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
COLUMNS = {"opacity": 10, **{f"f_dc_{k}": 11 + k for k in range(3)}}
COLUMNS |= {f"scale_{k}": 7 + k for k in range(3)} | {f"rot_{k}": 3 + k for k in range(4)}


def of_size(extent, splat, at):
    """Positions in binary64 and splats of a scene, so wide, with splats of so large a median."""
    scene = make_scene(3000)
    wide = np.ptp(np.percentile(scene.means, (1, 99), axis=0), axis=0).max()
    larger = np.log(splat) - np.median(scene.log_scales)
    logs = scene.log_scales + np.float32(larger)
    means = scene.means.astype(np.float64) * (extent / wide) + at
    return means, replace(scene, sh=scene.sh[:, :1], log_scales=logs)


def write_doubles(path, parts):
    kinds = np.dtype([(name, "<f8" if name in "xyz" else "<f4") for name in NAMES])
    rows = []
    for means, splats in parts:
        one, channels = np.zeros(len(means), kinds), splats.channels()
        for axis, name in enumerate("xyz"):
            one[name] = means[:, axis]
        for name, channel in COLUMNS.items():
            one[name] = channels[channel]
        rows.append(one)
    body = np.concatenate(rows)
    lines = [f"property {'double' if name in 'xyz' else 'float'} {name}\n" for name in NAMES]
    start = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(body)}\n"
    path.write_bytes((start + "".join(lines) + "end_header\n").encode() + body.tobytes())


def positions(data):
    """(N, 3) binary64: `leaves()` has binary32, which is 6 cm apart there."""
    decoded = decode(data)
    directory = decoded.directory
    found = []
    for tile, state in enumerate(decoded.tiles):
        n = state.n_slots
        x = state.x[0:3, :n][:, state.live[:n]].T + directory.tiles["origin"][tile]
        found.append(x * 2.0 ** -directory.grid_exponents[0])
    return np.concatenate(found)


def moved(data, part):
    """(N,) how far each splat of a part is from where it was, in its own size."""
    means, splats = part
    return cKDTree(positions(data)).query(means)[0] / np.exp(splats.log_scales.max(axis=1))


@pytest.mark.thorough
def test_an_object_of_5_cm_in_a_kilometre_is_as_exact_as_alone_for_few_more_bytes(tmp_path):
    city = of_size(1000, 1.0, AT)
    thing = of_size(0.05, 0.001, AT + np.array([40, 20, 1.5]))
    streams = {}
    for name, parts in (("both", [city, thing]), ("thing", [thing]), ("city", [city])):
        write_doubles(tmp_path / f"{name}.ply", parts)
        out = tmp_path / f"{name}.evogs"
        options = JobOptions(levels=2, per_tile=1000)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)  # a step is a quarter coarser
            encode_files([tmp_path / f"{name}.ply"], out, options, engine=Engine("serial"))
        streams[name] = out.read_bytes()
    for name, part in (("thing", thing), ("city", city)):
        alone, together = moved(streams[name], part), moved(streams["both"], part)
        assert np.percentile(alone, 99) < 0.3
        assert np.median(together) < 0.1
        assert np.percentile(together, 99) < 0.5
    # The tables are left out, and headers count: tiles have a hundred splats here, not 131,072.
    sizes = {name: len(data) - read_directory(data).data_offset for name, data in streams.items()}
    assert sizes["both"] < 1.25 * (sizes["thing"] + sizes["city"])
