"""Palettes of tile jobs: the entries of all tiles, once these are quantised, and their picks.

What an entry is worth, and the first level that picks it, depends on all tiles. So a job leaves its
picks as numbers of what it shares, and other jobs number and pack them when the entries are known.

quantised tiles -> `Unnumbered` -> `Entries` of all -> `number_picks` -> `NumberedPicks` -> merge

Letters: K steps of a tile, n entries, C SH channels above band 0.
"""

from __future__ import annotations

import hashlib
import io
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evogs_codec.decoding.palette_state import unpack_picks
from evogs_codec.encoding.packet_order import highest_picks
from evogs_codec.encoding.palette_entries import (
    entries_in_order,
    first_uses,
    quantised_entries,
    renumbered,
)
from evogs_codec.encoding.palette_worth import bits_of_entries
from evogs_codec.encoding.sensitivity import steps_of_entries
from evogs_codec.format.pack import pack_picks
from evogs_codec.format.packet_header import Counts
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.distinct import Vectors
from evogs_codec.jobs.partition import Partition, vectors_of
from evogs_codec.jobs.plan import Plan, Survey, surveyed, worth_of_entries
from evogs_codec.jobs.scratch_files import arrays_of
from evogs_codec.model.channels import N_CORE, N_GROUPS, channel_class
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.palette import Palette
from evogs_codec.model.splats import F32, I32, I64
from evogs_codec.model.tree import Kind, take_picks
from evogs_codec.scene import choose

__all__ = [
    "Entries",
    "NumberedPicks",
    "Unnumbered",
    "number_picks",
    "numbered_of",
    "palette_pays",
    "rows_of_picks",
    "unnumbered_of",
]


def unnumbered_of(part: Path) -> Path:
    """The file of what a tile picks, beside its stream."""
    return part.with_suffix(".unnumbered")


def numbered_of(part: Path) -> Path:
    """The file of the packets of picks of a tile, beside its stream."""
    return part.with_suffix(".picks")


def rows_of_picks(part: Path) -> Path:
    """The file of what rows of these packets say."""
    return part.with_suffix(".rows-of-picks")


@dataclass(frozen=True, eq=False)
class Unnumbered:
    """What a tile picks.

    Attributes:
        steps: (K,) with picks: 0 of none, then the coarse entries, then `keys`.
        errors: (K,) for the rows of the packets of picks.
        keys: of the vectors that the tile has, as of `Vectors`.
        weights: (degree, n_coarse + keys) of each entry, in prices of a bit.
        first: (n_coarse + keys,) the first use of each (`first_uses`).
    """

    steps: Sequence[CodedStep]
    errors: I64
    keys: I64
    weights: F32
    first: I64

    @staticmethod
    def of(tile: CodedTile, keys: I64, weights: F32) -> Unnumbered:
        """Of a tile that is quantised (`tiles_on`)."""
        return Unnumbered(
            tile.steps,
            np.array([step.error[1] for step in tile.steps], np.int64),
            keys,
            weights,
            first_uses([tile], weights.shape[1]),
        )

    def write(self, path: Path) -> None:
        """To a file that `read` reads."""
        arrays: dict[str, Any] = {"errors": self.errors, "keys": self.keys}
        arrays |= {"weights": self.weights, "first": self.first}
        counts = [(step.level, step.alpha.shape[1], step.adds.shape[1]) for step in self.steps]
        arrays["counts"] = np.array(counts, np.int64).reshape(-1, 3)
        for k, step in enumerate(self.steps):
            arrays |= {f"slots_{k}": step.slots, f"kinds_{k}": step.kinds}
            arrays |= {f"picks_{k}": step.picks, f"changed_{k}": step.changed_picks}
        write_atomic(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))

    @staticmethod
    def read(path: Path) -> Unnumbered:
        """From a file that `write` wrote; of steps what picks need.

        Raises:
            InputError: it is damaged.
        """
        with arrays_of(path) as found:
            steps = [
                CodedStep(
                    level,
                    found[f"slots_{k}"],
                    found[f"kinds_{k}"],
                    np.empty((N_GROUPS, n_splits), np.uint8),
                    np.empty((0, 0), np.int32),
                    np.empty((0, n_adds), np.int32),
                    picks=found[f"picks_{k}"],
                    changed_picks=found[f"changed_{k}"],
                )
                for k, (level, n_splits, n_adds) in enumerate(found["counts"].tolist())
            ]
            return Unnumbered(
                steps, found["errors"], found["keys"], found["weights"], found["first"]
            )


@dataclass(frozen=True, eq=False)
class Entries:
    """The palette of a stream.

    Attributes:
        tree: of the stream, without its tiles.
        keys: of all vectors (`Vectors`).
        number: (1 + n_coarse + keys,) of each pick.
        zstd_level: level of Zstandard.
    """

    tree: CodedTree
    keys: I64
    number: I32
    zstd_level: int

    @staticmethod
    def of(plan: Plan, vectors: Vectors, picks: Sequence[Path], zstd_level: int) -> Entries:
        """From what all tiles pick.

        Args:
            plan: of the stream.
            vectors: that its splats share.
            picks: files of `Unnumbered`, one of each tile.
            zstd_level: level of Zstandard.

        Raises:
            TooFineError: a number leaves its range on the grid of the plan.
            InputError: a file is damaged.
        """
        assert plan.coarse is not None, "the plan has a palette"
        n_coarse, degree = plan.coarse.values.shape[1], plan.sh_degree
        values = np.concatenate([plan.coarse.values, vectors.rows.T], axis=1)
        palette = Palette(degree, np.ascontiguousarray(values, np.float32), n_coarse)
        weights, first = np.zeros((degree, values.shape[1])), first_uses([], values.shape[1])
        for path in picks:
            with arrays_of(path) as found:
                keys, own_weights, own_first = found["keys"], found["weights"], found["first"]
            place = _places(keys, vectors.keys, n_coarse)
            weights[:, place] += own_weights
            np.minimum.at(first, place, own_first)
        steps = steps_of_entries(weights.mean(axis=1), 1.0)
        grid = plan.grid_of_entries(steps)
        q = quantised_entries(palette, grid, weights.astype(np.float32), 1.0)
        coded = entries_in_order(q, first, n_coarse)
        tree = plan.coded(grid, [])
        tree = replace(tree, entries=coded.q, entry_levels=coded.levels, entry_uses=coded.uses)
        return Entries(tree, vectors.keys, coded.number, zstd_level)

    def write(self, path: Path) -> None:
        """What `number_picks` needs, to a file."""
        tree = self.tree
        assert tree.entries is not None, "they are entries of a palette"
        kinds = [channel_class(N_CORE + c) for c in range(len(tree.entries))]
        units = np.array([tree.quantisers[0][kind].step for kind in kinds])
        arrays: dict[str, Any] = {
            "levels": tree.entry_levels,
            "keys": self.keys,
            "number": self.number,
        }
        arrays["x"] = (tree.entries * units[:, None]).astype(np.int32)
        write_atomic(path, lambda file: np.savez(file, allow_pickle=False, **arrays))


def palette_pays(partition: Partition, surveys: Sequence[Survey]) -> bool:
    """Whether a palette is smaller than SH splat by splat, as surveys of some tiles tell it."""
    sharings = [survey.sharing for survey in surveys if survey.sharing is not None]
    if not sharings:
        return False
    entries = Vectors.read(vectors_of(partition.folder)).rows.T
    worth = worth_of_entries(partition, sharings).astype(np.float32)
    bits, errors, _ = bits_of_entries(
        entries, np.repeat(worth[:, None], entries.shape[1], axis=1), 1.0
    )
    scale = partition.counts.sum() / max(partition.counts[surveyed(partition)].sum(), 1)
    picks = sum(sharing.bits_of_picks for sharing in sharings)
    psi = sum(sharing.bits_of_psi for sharing in sharings)
    return choose.palette_pays(bits + errors + scale * picks, scale * psi)


def number_picks(picks: str, entries: str, zstd_level: int, out: str) -> None:
    """Write the `NumberedPicks` of a tile to a file.

    Args:
        picks: file of `Unnumbered`.
        entries: file of `Entries`.
        zstd_level: level of Zstandard.
        out: the file to make.

    Raises:
        InputError: a file is damaged.
    """
    own = Unnumbered.read(Path(picks))
    with arrays_of(Path(entries)) as found:
        levels, x, keys, number = (found[name] for name in ("levels", "x", "keys", "number"))
    n_coarse = len(number) - 1 - len(keys)
    local = np.append(0, 1 + _places(own.keys, keys, n_coarse))
    tile = CodedTile((0, 0, 0), (0, 0, 0), (0, 0, 0), tuple(own.steps))
    steps = renumbered(tile, number[local]).steps
    bodies = [pack_picks(s.picks, s.changed_picks, zstd_level=zstd_level) for s in steps]
    NumberedPicks(
        bodies, own.errors, highest_picks(steps), _digest(steps, bodies, x, levels)
    ).write(Path(out))


@dataclass(frozen=True, eq=False)
class NumberedPicks:
    """The packets of picks of a tile.

    Attributes:
        bodies: (K,) bytes.
        errors: (K,) for their rows.
        highest: (K,) pick up to each step.
        digest: of the last state (spec 12.6).
    """

    bodies: Sequence[bytes]
    errors: I64
    highest: I64
    digest: bytes

    def write(self, path: Path) -> None:
        """The bytes to a file, and the rest to one beside it."""
        sizes = np.array([len(body) for body in self.bodies], np.int64)
        crcs = np.array([zlib.crc32(body) for body in self.bodies], np.int64)
        found = io.BytesIO()
        digest = np.frombuffer(self.digest, np.uint8)
        np.savez(
            found,
            sizes=sizes,
            crcs=crcs,
            errors=self.errors,
            highest=self.highest,
            digest=digest,
        )
        write_atomic(rows_of_picks(path), found.getvalue())
        write_atomic(path, b"".join(self.bodies))


def _places(own: I64, keys: I64, n_coarse: int) -> I64:
    """(n_coarse + own,) which entries those of a tile are, of all."""
    return np.append(np.arange(n_coarse), n_coarse + np.searchsorted(keys, own))


def _digest(steps: Sequence[CodedStep], bodies: Sequence[bytes], x: I32, levels: I32) -> bytes:
    """SHA-256 of the state that a decoder has of the picks of these packets (spec 12.6)."""
    n, shown = 0, np.zeros(sum(step.n_new for step in steps), np.int32)
    for step, body in zip(steps, bodies, strict=True):
        counts = _counts(step)
        n_entries = int(np.searchsorted(levels, step.level, side="right"))
        changed, new = unpack_picks(memoryview(body), counts, n_entries, 0)
        nothing = np.empty(0, np.int32)
        decoded = replace(
            step,
            picks=nothing if new is None else new.astype(np.int32),
            changed_picks=nothing if changed is None else changed.astype(np.int32),
        )
        take_picks(decoded, shown, n)
        shown[step.slots[step.kinds == Kind.DROP]] = 0
        n += step.n_new
    digest = hashlib.sha256(n.to_bytes(4, "little"))
    for row in x:
        digest.update(np.ascontiguousarray(np.append(np.int32(0), row)[shown], "<i4").data)
    return digest.digest()


def _counts(step: CodedStep) -> Counts:
    """Of the records of a step."""
    n_splits, n_refines, n_drops = (
        int(np.count_nonzero(step.kinds == kind)) for kind in (Kind.SPLIT, Kind.REFINE, Kind.DROP)
    )
    return Counts(step.adds.shape[1], n_splits, n_refines, n_drops)
