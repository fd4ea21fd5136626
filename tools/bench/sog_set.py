"""SOG sets, written by their published layout: what a stream of PlayCanvas fetches.

Pictures are lossless WebP at the default effort of libwebp. Codebooks are found by k-means, and the
palette of the higher SH bands by k-means twice, of clusters and in each of them: splat-transform's
one pass takes a processor minutes for 40,000 splats. `evogs_codec.io.interchange.sog` reads a set.

Letters: N splats, P palette entries, K SH coefficients.
"""

from __future__ import annotations

import json
import math
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.cluster.vq import kmeans2

from evogs_codec import SplatParams
from evogs_codec.io.interchange.sog import FIRST_TAG, META, ROW
from evogs_codec.io.interchange.values import as_bytes, largest_and_rest, sigmoid, unit
from evogs_codec.model.splats import F32, I64

__all__ = ["write_set"]

U8 = npt.NDArray[np.uint8]

ROUNDS = 10  # of k-means of SH
CODE_ROUNDS = 40  # of that of a codebook
CODES = 256  # of a codebook
BINS = 4096  # of the histogram that a codebook begins with
MAX_ENTRIES = 1 << 16  # of a palette
SEED = 7


def write_set(splats: SplatParams, folder: Path) -> int:
    """Write the splats, in their order, as `meta.json` and pictures in a new folder.

    Returns:
        The bytes of all files.
    """
    folder.mkdir(parents=True)
    pictures: dict[str, U8] = {}
    meta: dict[str, object] = {"version": 2, "asset": {"generator": "evogs"}, "count": len(splats)}
    meta["means"] = _means(splats.means, pictures)
    meta["scales"] = _scales(splats.log_scales, pictures)
    meta["quats"] = _quats(splats.quats, pictures)
    meta["sh0"] = _sh0(splats, pictures)
    if splats.sh_degree:
        meta["shN"] = _sh_rest(splats.sh[:, 1:], splats.sh_degree, pictures)
    for name, pixels in pictures.items():
        (folder / name).write_bytes(_webp(pixels))
    (folder / META).write_text(json.dumps(meta, separators=(",", ":")))
    return sum(path.stat().st_size for path in folder.iterdir())


def _means(means: F32, pictures: dict[str, U8]) -> dict[str, object]:
    """16 bits an axis, even in a logarithm with a sign."""
    logs = np.copysign(np.log1p(np.abs(means.astype(np.float64))), means)
    least, most = logs.min(axis=0), logs.max(axis=0)
    extent = np.where(most > least, most - least, 1)
    words = np.rint((logs - least) / extent * 65535).astype(np.uint16)
    names = ["means_l.webp", "means_u.webp"]
    pictures[names[0]] = _image((words & 255).astype(np.uint8))
    pictures[names[1]] = _image((words >> 8).astype(np.uint8))
    return {"mins": least.tolist(), "maxs": most.tolist(), "files": names}


def _scales(log_scales: F32, pictures: dict[str, U8]) -> dict[str, object]:
    codebook, codes = _codebook(log_scales)
    pictures["scales.webp"] = _image(codes)
    return {"codebook": codebook, "files": ["scales.webp"]}


def _quats(quats: F32, pictures: dict[str, U8]) -> dict[str, object]:
    largest, rest = largest_and_rest(unit(quats))
    stored = as_bytes((rest * math.sqrt(2) + 1) * 127.5)
    tags = (FIRST_TAG + largest).astype(np.uint8)
    pictures["quats.webp"] = _image(np.column_stack([stored, tags]))
    return {"files": ["quats.webp"]}


def _sh0(splats: SplatParams, pictures: dict[str, U8]) -> dict[str, object]:
    codebook, codes = _codebook(splats.sh[:, 0])
    opacities = as_bytes(255 * sigmoid(splats.opacity_logits))
    pictures["sh0.webp"] = _image(np.column_stack([codes, opacities]))
    return {"codebook": codebook, "files": ["sh0.webp"]}


def _sh_rest(rest: F32, degree: int, pictures: dict[str, U8]) -> dict[str, object]:
    """A palette of the higher bands, and the entry of each splat."""
    n, k, _ = rest.shape
    palette, labels = _palette(rest.reshape(n, 3 * k))
    codebook, codes = _codebook(palette)
    rows = -(-len(palette) // ROW)
    table = np.zeros((rows * ROW, k, 3), np.uint8)
    table[: len(palette)] = codes.reshape(-1, k, 3)
    names = ["shN_centroids.webp", "shN_labels.webp"]
    pictures[names[0]] = table.reshape(rows, ROW * k, 3)
    low, high = (labels & 255).astype(np.uint8), (labels >> 8).astype(np.uint8)
    pictures[names[1]] = _image(np.column_stack([low, high, np.zeros_like(low)]))
    return {"count": len(palette), "bands": degree, "codebook": codebook, "files": names}


def _palette(vectors: F32) -> tuple[F32, I64]:
    """(P, 3K) entries and (N,) the one of each splat.

    All that differ, if they are at most as many as splat-transform takes: N, rounded down to a
    power of two.
    """
    n = len(vectors)
    most = min(MAX_ENTRIES, 1 << (n.bit_length() - 1))
    distinct, labels = np.unique(vectors, axis=0, return_inverse=True)
    if len(distinct) <= most:
        return distinct, labels.reshape(n).astype(np.int64)
    n_clusters = 1 << ((most.bit_length() - 1) // 2)
    _, clusters = _kmeans(vectors, n_clusters)
    # One entry of each, and the others as they have vectors: not more than `most` in all.
    until = np.cumsum(np.bincount(clusters, minlength=n_clusters)) * (most - n_clusters) // n
    shares = 1 + np.diff(until, prepend=0)
    found: list[F32] = []
    labels = np.empty(n, np.int64)
    for cluster, share in enumerate(shares.tolist()):
        rows = np.flatnonzero(clusters == cluster)
        entries, own = _kmeans(vectors[rows], share)
        labels[rows] = sum(map(len, found)) + own
        found.append(entries)
    return np.concatenate(found), labels


def _kmeans(vectors: F32, n_clusters: int) -> tuple[F32, I64]:
    """Centres, and the nearest one of each vector. A centre without any vector stays as it is."""
    if len(vectors) <= max(1, n_clusters):
        return vectors, np.arange(len(vectors))
    rng = np.random.default_rng(SEED)
    start = vectors[rng.choice(len(vectors), max(1, n_clusters), replace=False)]
    with warnings.catch_warnings(action="ignore"):  # that there is such a centre
        centres, labels = kmeans2(vectors, start, iter=ROUNDS, minit="matrix")
    return centres.astype(np.float32), labels.astype(np.int64)


def _codebook(numbers: F32) -> tuple[list[float], U8]:
    """256 numbers that rise, and which of them is nearest to each of the numbers.

    By k-means of a histogram. As splat-transform does it, frequent numbers count by the root of how
    many they are, so that rare ones are not far off.
    """
    counts, bounds = np.histogram(numbers, BINS)
    weights, middles = np.sqrt(counts), (bounds[1:] + bounds[:-1]) / 2
    dense = np.concatenate([[0.0], np.cumsum(np.cbrt(weights))])
    codes = np.interp((np.arange(CODES) + 0.5) / CODES * dense[-1], dense, bounds)
    masses = np.concatenate([[0.0], np.cumsum(weights)])
    moments = np.concatenate([[0.0], np.cumsum(weights * middles)])
    for _ in range(CODE_ROUNDS):
        inner = np.searchsorted(middles, (codes[1:] + codes[:-1]) / 2)
        edges = np.concatenate([[0], inner, [BINS]])
        mass = np.diff(masses[edges])
        codes = np.where(mass > 0, np.diff(moments[edges]) / np.where(mass > 0, mass, 1), codes)
    codes = np.sort(codes).astype(np.float32).astype(np.float64)
    nearest = np.searchsorted((codes[1:] + codes[:-1]) / 2, numbers)
    return codes.tolist(), nearest.astype(np.uint8)


def _image(rows: U8) -> U8:
    """(height, width, channels): nearly a square, in blocks of 4 pixels."""
    n, channels = rows.shape
    width = 4 * math.ceil(math.sqrt(n) / 4)
    height = 4 * math.ceil(n / width / 4)
    pixels = np.zeros((height * width, channels), np.uint8)
    pixels[:n] = rows
    return pixels.reshape(height, width, channels)


def _webp(pixels: U8) -> bytes:
    file = BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, quality=70, method=4, exact=True)
    return file.getvalue()
