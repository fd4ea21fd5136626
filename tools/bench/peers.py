"""Files of others, by gsply."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import gsply
import numpy as np

from evogs_codec import SplatParams, write_ply

__all__ = ["from_gsply", "write_compressed_ply", "write_spz"]


def write_spz(splats: SplatParams, path: Path, version: int = 4) -> Path:
    """The path, where there is an SPZ file of the splats now, if there was none."""
    if not path.exists():
        gsply.write_spz(path, _to_gsply(splats), version=version)
    return path


def write_compressed_ply(splats: SplatParams, path: Path) -> Path:
    """The path, where there is a compressed PLY file of the splats now."""
    gsply.plywrite(path, _to_gsply(splats), compressed=True)
    return path


def from_gsply(data: gsply.GSData, like: SplatParams) -> SplatParams:
    """Splats of gsply, which gives back the axes that it was given, with the SH of `like`."""
    n, n_rest = len(data.means), like.sh.shape[1] - 1
    rest = np.array(data.shN).reshape(n, -1, 3)[:, :n_rest] if n_rest else np.zeros((n, 0, 3))
    sh = np.concatenate([np.array(data.sh0).reshape(n, 1, 3), rest], axis=1)
    means, quats, scales = (np.array(x) for x in (data.means, data.quats, data.scales))
    return SplatParams(means, quats, scales, np.array(data.opacities).reshape(n), sh)


def _to_gsply(splats: SplatParams) -> gsply.GSData:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.ply"
        write_ply(path, splats)
        return gsply.plyread(path)
