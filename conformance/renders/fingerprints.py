"""What the pictures make of the wrong renderers, and which of them a failing renderer resembles.

Two renderers with one mistake are off by the same amount in the same pictures: the PSNR of each
picture that fails is the fingerprint.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from conformance.renders.candidate import Result
from conformance.renders.manifest import FOLDER, Suite

__all__ = ["Fingerprint", "as_json", "likenesses", "of_results", "read_fingerprints"]

ROUNDING = 0.7 / 255  # of errors: pictures rounded down differ by so much from those rounded
SAME = 0.04  # of an error, besides
MIN_SHARE = 0.8
MAX_NAMED = 3


@dataclass(frozen=True)
class Fingerprint:
    """The pictures that a wrong renderer fails.

    Attributes:
        name, says: of the renderer.
        psnr: dB by the id of each failing image.
    """

    name: str
    says: str
    psnr: Mapping[str, float]


def likenesses(results: Sequence[Result], known: Sequence[Fingerprint]) -> list[str]:
    """Sentences about the wrong renderers that fail as this one does, the likest first."""
    found = of_results("", "", results).psnr
    asked = {result.image.id for result in results}
    alike = []
    for other in known:
        either = (found.keys() | other.psnr.keys()) & asked
        errors = np.array([(_rms(found, id_), _rms(other.psnr, id_)) for id_ in either])
        if not found or not errors.any():
            continue
        apart = np.abs(errors[:, 0] - errors[:, 1])
        n_same = int(np.count_nonzero(apart <= ROUNDING + SAME * errors.max(1)))
        if n_same >= MIN_SHARE * len(either):
            sentence = f"this looks like a renderer in which {other.says}"
            likest = float(apart.sum() / errors.max(1).sum())
            alike.append((likest, f"{sentence} ({n_same} of {len(either)} pictures)"))
    return [sentence for _, sentence in sorted(alike)[:MAX_NAMED]]


def _rms(psnr: Mapping[str, float], id_: str) -> float:
    """Root of the mean square error, white is 1; 0 of an image that passes."""
    return float(10 ** (-psnr[id_] / 20)) if id_ in psnr else 0.0


def of_results(name: str, says: str, results: Sequence[Result]) -> Fingerprint:
    """The fingerprint of a renderer."""
    failing = ((r.image.id, r.numbers) for r in results if r.failed)
    psnr = {id_: round(numbers.psnr, 2) for id_, numbers in failing if numbers is not None}
    return Fingerprint(name, says, psnr)


def as_json(suite: Suite, known: Sequence[Fingerprint]) -> str:
    """The file: a line per renderer, a number per image in the order of the manifest."""
    entries = [
        {
            "name": one.name,
            "says": one.says,
            "psnr": [one.psnr.get(image.id) for image in suite.images],
        }
        for one in known
    ]
    lines = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in entries)
    return f'{{"renders": "{suite.sha256}", "fingerprints": [\n{lines}\n]}}\n'


def read_fingerprints(suite: Suite, folder: Path = FOLDER) -> list[Fingerprint]:
    """The fingerprints of `folder`; none where they are of other images."""
    try:
        read = json.loads((folder / "fingerprints.json").read_bytes())
    except OSError:
        return []
    if read["renders"] != suite.sha256:
        return []
    ids = [image.id for image in suite.images]
    return [
        Fingerprint(
            entry["name"],
            entry["says"],
            {id_: v for id_, v in zip(ids, entry["psnr"], strict=True) if v is not None},
        )
        for entry in read["fingerprints"]
    ]
