"""Train small trees on photographs of the shipped scene; their streams are vectors of the suite.

`python -m tools.trained_streams OUT` makes `trained-*.evogs`: one per method that makes a tree or
layers, and two settings of EvoGS. Needs the extra `train`; a few minutes on two cores. The streams
of `conformance/generator/cases/streams` were made so once and are kept as bytes: a better trainer
or encoder must not change them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from evogs_codec import PRESETS as ENCODERS
from evogs_codec import encode
from evogs_codec.io.files import write_atomic
from evogs_codec.model.scene_info import SceneInfo
from tools import photos

__all__ = ["TREES", "main"]

VIEWS, PIXELS = 24, 96
# name: method, SH degree, splats of each level, preset of the encoder
TREES = {
    "evogs": ("evogs", 1, (60, 140, 320), "trained"),
    "evogs-degree-3": ("evogs", 3, (60, 120, 200), "paper"),
    "evogs-sym": ("evogs-sym", 1, (60, 140, 320), "trained"),
    "evogs-a": ("evogs-a", 0, (60, 140, 320), "trained"),
    "evogs-b": ("evogs-b", 0, (60, 140, 320), "trained"),
    "lapis": ("lapis", 1, (60, 100, 160), "trained"),
    "l3gs": ("l3gs", 1, (60, 100, 160), "trained"),
}


def main() -> None:
    """Train them all, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path, help="folder for the streams")
    parser.add_argument("--only", nargs="+", choices=list(TREES), default=list(TREES))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        photos.main([folder, "--views", str(VIEWS), "--size", str(PIXELS)])
        for name in args.only:
            data = stream(name, Path(folder))
            write_atomic(args.out / f"trained-{name}.evogs", data)
            print(f"trained-{name}.evogs: {len(data):,} bytes", flush=True)


def stream(name: str, photographs: Path) -> bytes:
    """The stream of a tree."""
    from reference_trainer.cli import pyramid_of
    from reference_trainer.config import PRESETS, Integers
    from reference_trainer.data import load_views
    from reference_trainer.models.backends import backend_for
    from reference_trainer.run import run

    method, sh_degree, caps, encoder = TREES[name]
    quick = PRESETS["quick"]
    config = replace(
        quick,
        method=method,
        sh_degree=sh_degree,
        integers=Integers(),  # their numbers are the preset's to round
        iterations=quick.iterations[: len(caps)],
        max_splats=caps,
    )
    pyramid = pyramid_of(load_views(photographs), len(caps))
    tree = run(config, pyramid, backend_for("cpu"))
    info = SceneInfo(coordinate_system=1, text={"title": f"trained: {name}"})
    return encode(tree, ENCODERS[encoder], info=info)


if __name__ == "__main__":
    main()
