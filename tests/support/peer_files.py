"""Programs of others that read and write files of splats, and how far two readings are apart.

`make test-peers` installs those of npm into `tests/codec/io/peers/node_modules`; EVOGS_NODE_PEERS
names another folder. Tests of one that is not there are skipped.
"""

import json
import os
import shutil
import subprocess
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from evogs_codec import SplatParams, read_scene
from evogs_codec.io.interchange.frames import transformed, turn
from tests.support.odd_scenes import covariances, opacities

FOLDER = Path(__file__).parent.parent / "codec" / "io" / "peers"
NODE = Path(os.environ.get("EVOGS_NODE_PEERS", FOLDER / "node_modules")).resolve()
TRANSFORM = NODE / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
SH_0 = 0.28209479177387814


def run_node(package, *arguments):
    """Run `node` with these arguments, if the package is there."""
    if not (NODE / package).is_dir() or shutil.which("node") is None:
        pytest.skip(f"no {package} in {NODE}, or no node: make test-peers")
    command = ["node", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def transform(*arguments):
    run_node("@playcanvas/splat-transform", TRANSFORM, "-q", "-w", *arguments)


def read_quietly(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of opacities that bytes round to 1
        return read_scene(path).splats


@dataclass(frozen=True)
class Reading:
    """What a program has in memory of a file of N splats.

    Attributes:
        means: (N, 3) positions.
        covariances: (N, 3, 3).
        opacities: (N,) from 0 to 1.
        sh: (N, K, 3).
    """

    means: np.ndarray
    covariances: np.ndarray
    opacities: np.ndarray
    sh: np.ndarray

    @staticmethod
    def of(splats):
        """What splats mean."""
        return Reading(splats.means, covariances(splats), opacities(splats), splats.sh)

    @staticmethod
    def of_json(path):
        """What `three_read.mjs` and `gs3d.mjs` write: colours and opacities are bytes there."""
        found = json.loads(path.read_text())
        means = np.reshape(found["means"], (-1, 3))
        n = len(means)
        rgba = np.reshape(found["rgba"], (n, 4)) / 255
        sh = np.reshape(found["sh"], (n, -1, 3)) if n else np.zeros((0, 0, 3))
        return Reading(
            means,
            np.reshape(found["covariances"], (n, 6))[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(
                n, 3, 3
            ),
            rgba[:, 3],
            np.concatenate([(rgba[:, None, :3] - 0.5) / SH_0, sh], axis=1),
        )

    def turned(self, source, target):
        """The same in other axes, such as "RUB" and "RDF"."""
        n, matrix = len(self.means), turn(source, target)
        splats = SplatParams(
            self.means.astype(np.float32),
            np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
            np.zeros((n, 3), np.float32),
            np.zeros(n, np.float32),
            self.sh.astype(np.float32),
        )
        splats = transformed(splats, matrix)
        return replace(
            self,
            means=splats.means,
            sh=splats.sh,
            covariances=matrix @ self.covariances @ matrix.T,
        )

    def differences(self, other):
        """The largest of positions, covariances (relative), opacities, SH of band 0, SH above.

        The order may differ; of SH degrees the lower counts.
        """
        distances = np.linalg.norm(self.means[:, None] - other.means[None], axis=2)
        order = distances.argmin(axis=1)
        assert sorted(order) == list(range(len(other.means)))
        k = min(self.sh.shape[1], other.sh.shape[1])
        theirs = other.covariances[order]
        apart = np.linalg.norm(self.covariances - theirs, axis=(1, 2))
        sh = np.abs(self.sh[:, :k] - other.sh[order, :k])
        return (
            np.abs(self.means - other.means[order]).max(),
            (apart / np.linalg.norm(theirs, axis=(1, 2))).max(),
            np.abs(self.opacities - other.opacities[order]).max(),
            sh[:, 0].max(),
            sh[:, 1:].max(initial=0),
        )


def assert_close(found, scene, rounding):
    """Splats or readings whose five differences are within `rounding`."""
    found, scene = (of if isinstance(of, Reading) else Reading.of(of) for of in (found, scene))
    apart = found.differences(scene)
    assert all(a <= b * 1.001 for a, b in zip(apart, rounding, strict=True)), apart
