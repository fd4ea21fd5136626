"""The vectors and what is expected of a decoder for each, read strictly.

An unknown key, a missing file or a wrong hash is a `SuiteError`: a suite that is not what its
manifest says must never end in a pass.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from conformance.harness.running.plain import read_json

__all__ = ["MODES", "Case", "Run", "Suite", "SuiteError", "Vector", "load"]

EXITS = (0, 1, 3, 4, 127)
MODES = ("file", "progressive")
# Notes for readers of the manifest, that the harness has no use for.
UNUSED_SUITE_KEYS = {"suite", "zstd"}


class SuiteError(Exception):
    """The suite is not usable: nothing can be said about the decoder."""


@dataclass(frozen=True)
class Run:
    """One question to a decoder and the answer expected (conformance/README.md).

    Attributes:
        dump_on_fault: `dump` is that of the state beside the fault, if there is one; left out of
            the manifest where it is false.
    """

    mode: str
    level: int | None
    limits: Mapping[str, int] | None
    verify: bool
    arrival: tuple[tuple[int, int], ...] | None
    exit: int
    code: str | None
    offset: int | None
    dump: str | None  # SHA-256 of the dump
    dump_on_fault: bool = False

    def __post_init__(self) -> None:
        if self.mode not in MODES or self.exit not in EXITS:
            raise SuiteError(f"a run has mode {self.mode!r} and exit {self.exit!r}")
        if self.exit == 0 and self.dump is None:
            raise SuiteError("a run that is accepted has no dump")
        if self.exit == 1 and self.dump is not None and not self.dump_on_fault:
            raise SuiteError("a run that is rejected has a dump that is not asked for")

    def options(self) -> str:
        """What was asked for, in words."""
        words = [self.mode]
        words += [f"level {self.level}"] if self.level is not None else []
        words += ["limits"] if self.limits else []
        words += ["verify"] if self.verify else []
        words += [f"{len(self.arrival)} ranges"] if self.arrival is not None else []
        words += ["dump on fault"] if self.dump_on_fault else []
        return ", ".join(words)


@dataclass(frozen=True)
class Vector:
    """A stream of the suite, by the names of the manifest."""

    id: str
    file: str
    sha256: str
    size: int
    family: str
    tests: str
    faulty: str
    requirements: tuple[str, ...]
    sections: tuple[str, ...]
    tier: int
    sh_degree: int
    near_miss_of: str | None
    runs: tuple[Run, ...]
    provenance: str
    kills: tuple[str, ...]


@dataclass(frozen=True)
class Case:
    """A run of a vector: what the runner hands to a decoder."""

    id: str
    vector: Vector
    run: Run
    data: bytes = field(repr=False)


@dataclass(frozen=True)
class Suite:
    """A folder of vectors; `sha256` is that of its manifest, `version` and `spec` as there."""

    folder: Path
    sha256: str
    version: str
    spec: str
    vectors: tuple[Vector, ...]
    families: tuple[Mapping[str, Any], ...] = ()

    def read(self, vector: Vector) -> bytes:
        """The bytes of a vector.

        Raises:
            SuiteError: the file is missing or another one.
        """
        try:
            data = (self.folder / vector.file).read_bytes()
        except OSError as error:
            raise SuiteError(f"{vector.id}: {error}") from None
        if hashlib.sha256(data).hexdigest() != vector.sha256 or len(data) != vector.size:
            raise SuiteError(f"{vector.id}: {vector.file} is not the file of the manifest")
        return data

    def golden(self, sha256: str) -> bytes:
        """The dump with this hash.

        Raises:
            SuiteError: it is missing or another one.
        """
        path = self.folder / "goldens" / f"{sha256[:16]}.z"
        try:
            dump = zlib.decompress(path.read_bytes())
        except (OSError, zlib.error) as error:
            raise SuiteError(f"golden {path.name}: {error}") from None
        if hashlib.sha256(dump).hexdigest() != sha256:
            raise SuiteError(f"golden {path.name} is not the dump of the manifest")
        return dump

    def cases(self) -> list[Case]:
        """Every run of every vector; all files and goldens are checked."""
        cases = []
        for vector in self.vectors:
            data = self.read(vector)
            for number, run in enumerate(vector.runs):
                if run.dump is not None:
                    self.golden(run.dump)
                cases.append(Case(f"{vector.id}#{number}", vector, run, data))
        return cases


def load(folder: Path) -> Suite:
    """Read `manifest.json` of a folder.

    Raises:
        SuiteError: the manifest is missing or not of the form that this harness knows.
    """
    if not (folder / "manifest.json").exists():
        raise SuiteError(
            f"no manifest.json in {folder}: the vectors are in a checkout of the repository, not in"
            " an installed package; name them with --vectors CHECKOUT/conformance/vectors"
        )
    try:
        text = (folder / "manifest.json").read_bytes()
        manifest = read_json(text)
    except (OSError, ValueError) as error:
        raise SuiteError(f"manifest.json: {error}") from None
    if not isinstance(manifest, dict) or not isinstance(manifest.get("vectors"), list):
        raise SuiteError("manifest.json has no list of vectors")
    unknown = set(manifest) - UNUSED_SUITE_KEYS - {"version", "spec", "vectors", "families"}
    if unknown:
        raise SuiteError(f"manifest.json: unknown keys {', '.join(sorted(unknown))}")
    vectors = tuple(_vector(entry) for entry in manifest["vectors"])
    if len({vector.id for vector in vectors}) < len(vectors):
        raise SuiteError("manifest.json: two vectors have one id")
    return Suite(
        folder,
        hashlib.sha256(text).hexdigest(),
        str(manifest.get("version", "?")),
        str(manifest.get("spec", "?")),
        vectors,
        tuple(manifest.get("families", ())),
    )


def _vector(entry: Any) -> Vector:  # noqa: ANN401 - whatever JSON can hold
    name = entry.get("id", "?") if isinstance(entry, dict) else "?"
    try:
        runs = tuple(_run(run) for run in entry["runs"])
        lists = {key: tuple(entry[key]) for key in ("requirements", "sections", "kills")}
        vector = _build(Vector, {**entry, **lists, "runs": runs})
    except (KeyError, TypeError, SuiteError) as error:
        raise SuiteError(f"manifest.json: vector {name}: {error}") from None
    if not vector.runs:
        raise SuiteError(f"manifest.json: vector {name} has no runs")
    return vector


def _run(entry: Mapping[str, Any]) -> Run:
    arrival = entry["arrival"]
    if arrival is not None:
        arrival = tuple((int(offset), int(size)) for offset, size in arrival)
    return _build(Run, {"dump_on_fault": False, **entry, "arrival": arrival})


T = TypeVar("T")


def _build(kind: type[T], values: Mapping[str, Any]) -> T:
    """A dataclass from exactly its fields."""
    names = {item.name for item in fields(kind)}  # type: ignore[arg-type]
    if names != set(values):
        wrong = sorted(names ^ set(values))
        raise SuiteError(f"keys unknown or missing: {', '.join(wrong)}")
    return kind(**values)
