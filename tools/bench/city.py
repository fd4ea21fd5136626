"""City: an object of 5 cm in a kilometre of city, far from the origin, tile by tile."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from evogs_codec import AccuracyWarning, SplatParams, decode
from evogs_codec.jobs import Engine, JobOptions, encode_files
from evogs_codec.model.channels import channel_class, group_of_class
from evogs_codec.model.splats import F64
from evogs_codec.render import Views
from evogs_codec.render.demo_scene import make_scene
from tools.bench.page import Rows

__all__ = ["Part", "city", "city_and_object", "encoded"]

N_SPLATS = (3_000, 60_000)  # of the city, and of the object
SEEDS = (6, 7, 8)  # two other scenes and seeds 0 and 3 to 5 were looked at when it was built
SPLAT_SIZES = (0.001, None)  # m, of the median splat of the object; None: as of the city
CITY, OBJECT = 1000.0, 0.05  # m wide
CITY_AT, OBJECT_AT = np.array([1e6, 2e6, 300.0]), np.array([1e6 + 40, 2e6 + 20, 301.5])
NEAR = 5 * OBJECT  # m: splats that are nearer to the middle of the object are its own
N_TILES = 3  # of each, about
UP = "z"

NAMES = [*"xyz", *(f"f_dc_{k}" for k in range(3)), "opacity"]
NAMES += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
CHANNELS = dict(zip(NAMES[3:], (11, 12, 13, 10, 7, 8, 9, 3, 4, 5, 6), strict=True))


@dataclass(frozen=True, eq=False)
class Part:
    """A city or an object.

    Attributes:
        positions: (N, 3) binary64, of which binary32 would lose 6 cm.
        splats: of SH degree 0, their positions from `at`.
        at: (3,) its middle.
    """

    positions: F64
    splats: SplatParams
    at: F64

    @staticmethod
    def of(n: int, seed: int, wide: float, at: F64, splat: float | None) -> Part:
        """A procedural scene so wide; with a median splat of a size, or as large as in it."""
        scene = make_scene(n, seed)
        percentiles = np.percentile(scene.means, (1, 99), axis=0)
        times = wide / float(np.ptp(percentiles, axis=0).max())
        logs = np.log(splat) - np.median(scene.log_scales) if splat else np.log(times)
        away = scene.means.astype(np.float64) * times
        splats = replace(
            scene,
            means=away.astype(np.float32),
            sh=scene.sh[:, :1],
            log_scales=scene.log_scales + np.float32(logs),
        )
        return Part(at + away, splats, at)


class Tiles(NamedTuple):
    """What a stream of an object, a city or both holds.

    Attributes:
        positions: per tile (n, 3), binary64.
        channels: per tile (D, n), positions from the origin of the tile.
        n_bytes: (T,) of its packets.
    """

    positions: list[F64]
    channels: list[F64]
    n_bytes: F64

    @staticmethod
    def of(data: bytes) -> Tiles:
        """Those of a stream. Tables are left out, which small tiles make large."""
        decoded = decode(data)
        directory = decoded.directory
        units = [2.0**-exponent for exponent in directory.grid_exponents]
        positions, channels = [], []
        for tile, state in enumerate(decoded.tiles):
            x = state.x[:, : state.n_slots][:, state.live[: state.n_slots]]
            positions.append(units[0] * (x[0:3].T + directory.tiles["origin"][tile]))
            scale = [units[group_of_class(channel_class(c))] for c in range(len(x))]
            channels.append(x * np.array(scale)[:, None])
        packets = directory.packets
        sizes: F64 = np.bincount(packets["tile"], packets["size"], len(positions)).astype(
            np.float64
        )
        return Tiles(positions, channels, sizes)

    def is_of_object(self, tile: int) -> bool:
        """Whether most splats of the tile are those of the object."""
        away = np.abs(self.positions[tile] - OBJECT_AT).max(axis=1)
        return float(np.median(away)) < NEAR

    def moved(self, part: Part) -> F64:
        """(N,) how far the nearest splat is from each one of a part, in the size of that one.

        A splat is moved by at least as much.
        """
        away, _ = cKDTree(np.concatenate(self.positions)).query(part.positions)
        found: F64 = away / np.exp(part.splats.log_scales.max(axis=1))
        return found

    def psnr(self, part: Part, of_object: bool) -> float:
        """Of a part, in 24 views of it alone, dB; drawn as wide as a city is."""
        positions, channels = np.concatenate(self.positions), np.concatenate(self.channels, axis=1)
        is_near = np.abs(positions - OBJECT_AT).max(axis=1) < NEAR
        own = is_near == of_object
        decoded = channels[:, own].astype(np.float32)
        decoded[0:3] = (positions[own] - part.at).T
        times = CITY / OBJECT if of_object else 1.0
        shown, right = (
            replace(
                splats,
                means=splats.means * np.float32(times),
                log_scales=splats.log_scales + np.float32(np.log(times)),
            )
            for splats in (SplatParams.from_channels(decoded), part.splats)
        )
        return Views.of(right, up=UP).psnr(shown)


def city_and_object(n: int, seed: int, splat: float | None) -> dict[str, Part]:
    """Both, of so many splats each; those of the object have this median size, in metres."""
    of_city = 1.0 if splat else None
    return {
        "city": Part.of(n, seed, CITY, CITY_AT, of_city),
        "object": Part.of(n, seed, OBJECT, OBJECT_AT, splat),
    }


def encoded(parts: Iterable[Part], folder: Path, engine: Engine | None = None) -> bytes:
    """The stream of parts as one scene, in tiles of a third of a part; serial by default."""
    path, out = folder / "scene.ply", folder / "scene.evogs"
    rows = []
    for part in parts:
        own = np.zeros(len(part.positions), [(n, "<f8" if n in "xyz" else "<f4") for n in NAMES])
        channels = part.splats.channels()
        for axis, name in enumerate("xyz"):
            own[name] = part.positions[:, axis]
        for name, channel in CHANNELS.items():
            own[name] = channels[channel]
        rows.append(own)
    body = np.concatenate(rows)
    lines = [f"property {'double' if name in 'xyz' else 'float'} {name}\n" for name in NAMES]
    start = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(body)}\n"
    path.write_bytes((start + "".join(lines) + "end_header\n").encode() + body.tobytes())
    options = JobOptions(levels=2, per_tile=len(rows[0]) // N_TILES, up=UP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)  # `moved` says how far splats are moved
        encode_files([path], out, options, engine=engine or Engine("serial"))
    return out.read_bytes()


def city(folder: Path) -> Rows:
    """A city and an object of so many splats each, in one stream and each in its own.

    They are procedural scenes of SH degree 0, a kilometre and 5 cm wide, 2,000 km from the origin.
    Bytes are those of packets: of the tiles of the object, and of the whole, to those of streams of
    their own. Splats of the object are moved by so many of their own sizes, as far as the nearest
    decoded splat tells, in the median and in 99 of 100. PSNR is that of each part in 24 views of it
    alone, in both streams.
    """
    rows: Rows = []
    for n in N_SPLATS:
        for splat in SPLAT_SIZES:
            for seed in SEEDS:
                parts = city_and_object(n, seed, splat)
                own = {name: Tiles.of(encoded([part], folder)) for name, part in parts.items()}
                both = Tiles.of(encoded(parts.values(), folder))
                near = [both.is_of_object(tile) for tile in range(len(both.n_bytes))]
                n_near = sum(len(p) for p, k in zip(both.positions, near, strict=True) if k)
                alone = {name: float(tiles.n_bytes.sum()) for name, tiles in own.items()}
                moved = np.percentile(both.moved(parts["object"]), (50, 99))
                size = np.exp(np.median(parts["object"].splats.log_scales))
                decibels = {
                    name: [t.psnr(part, name == "object") for t in (own[name], both)]
                    for name, part in parts.items()
                }
                rows.append(
                    {
                        "splats": n,
                        "median splat, mm": f"{1000 * size:.2g}",
                        "seed": seed,
                        "tiles": len(near),
                        "object, bytes a splat, to alone": (
                            f"{both.n_bytes[near].sum() / n_near / (alone['object'] / n):.2f}"
                        ),
                        "both, bytes to alone": (f"{both.n_bytes.sum() / sum(alone.values()):.2f}"),
                        "object moved, sizes": f"{moved[0]:.2f}, {moved[1]:.2f}",
                        "object, dB": " and ".join(f"{x:.1f}" for x in decibels["object"]),
                        "city, dB": " and ".join(f"{x:.1f}" for x in decibels["city"]),
                    }
                )
                print(*rows[-1].values(), sep=", ", file=sys.stderr, flush=True)
    return rows
