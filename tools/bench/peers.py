"""Files of others, by gsply."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import gsply
import numpy as np

from evogs_codec import SplatParams, write_ply

__all__ = ["from_gsply", "with_fewer_sh_bits", "write_compressed_ply", "write_spz"]

# The reference encoder of SPZ keeps 5 bits of SH band 1 and 4 of the others; gsply keeps all 8.
BUCKETS = (8, 16, 16)


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


def with_fewer_sh_bits(splats: SplatParams) -> SplatParams:
    """The splats as the reference encoder of SPZ rounds their SH bands, for gsply to write."""
    sh = splats.sh.copy()
    for band in range(1, splats.sh_degree + 1):
        bucket, rows = BUCKETS[band - 1], slice(band * band, (band + 1) ** 2)
        whole = np.rint(sh[:, rows] * 128) + 128
        kept = np.clip((whole + bucket // 2) // bucket * bucket, 0, 255)
        sh[:, rows] = (kept - 128) / 128
    return SplatParams(splats.means, splats.quats, splats.log_scales, splats.opacity_logits, sh)


def _to_gsply(splats: SplatParams) -> gsply.GSData:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.ply"
        write_ply(path, splats)
        return gsply.plyread(path)
