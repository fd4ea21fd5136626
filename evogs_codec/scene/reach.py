"""Which targets can be reached, from few splats: what is far beyond them is refused at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.arrange import leaf_order
from evogs_codec.encoding.sketch import families, part_of
from evogs_codec.encoding.targets import PRICES, TargetEncoder, TargetMissedError, psnr_reached
from evogs_codec.encoding.write import write
from evogs_codec.format.directory import read_directory
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.request import Request

__all__ = ["expect_in_reach"]

SOME = 6_000  # splats, whose ends stand for those of all
N_VIEWS = 4
# Targets that are not looked at, since they can be reached: dB, bytes of a splat, and of each of
# its numbers.
PSNR, LEAST, MOST = (30.0, 60.0), 2.5, 0.75
# What a target may be beyond the ends of some splats and yet be tried: dB, times the bytes.
PSNR_ROOM, BYTES_ROOM = 4.0, 1.6


def expect_in_reach(trees: Sequence[EvolutionTree], request: Request, layers: int) -> None:
    """Refuse a target far beyond what the streams of trees with the same leaves reach.

    Args:
        trees: with many splats.
        request: with a target PSNR or a number of bytes, and views.
        layers: of precision.

    Raises:
        TargetMissedError: it is; the ends that it names are estimates.
    """
    tree = trees[-1]
    n, psnr, n_bytes = tree.n_leaves, request.target_psnr, request.target_bytes
    if psnr is not None and not PSNR[0] <= psnr <= PSNR[1]:
        ends = [end for one in trees for end in _ends(one, request, layers)]
        least, most = min(ends), max(ends)
        if not least - PSNR_ROOM <= psnr <= most + PSNR_ROOM:
            said = f"{psnr:g} dB cannot be met: {psnr_reached(least, most, 'about ')}"
            raise TargetMissedError(said, max(least - psnr, psnr - most))
    most_likely = MOST * n_channels(tree.shown_degree)
    if n_bytes is not None and not LEAST <= n_bytes / n <= most_likely:
        ends = [end for one in trees for end in _ends(one, request, layers)]
        least, most = min(ends), max(ends)
        if not least / BYTES_ROOM <= n_bytes <= most * BYTES_ROOM:
            reached = f"about {_rounded(least):,} to {_rounded(most):,} bytes can be reached"
            said = f"{n_bytes:,} bytes cannot be met: {reached}"
            raise TargetMissedError(said, max(least - n_bytes, n_bytes - most))


def _ends(tree: EvolutionTree, request: Request, layers: int) -> list[float]:
    """PSNR or bytes, whichever is aimed at, at the ends of the range of prices, about."""
    (is_in,) = families([tree], SOME / tree.n_leaves)
    part = part_of(tree, is_in)
    views = request.views(part.leaves(), N_VIEWS)
    aim = TargetEncoder(part, request.settings, views, layers=layers, by_leaves=True)
    streams = [write(aim.prepared.coded(at), effort=1, digests=False) for at in PRICES]
    if request.target_psnr is not None:
        finest, coarsest = map(aim.psnr, streams)
        return [min(finest, _psnr_among_all(tree, is_in, part, streams[0], request)), coarsest]
    found = []
    for data in streams:
        body = int(read_directory(data).packets["size"].sum())
        found.append(len(data) - body + body * tree.n_leaves / part.n_leaves)
    return found


def _psnr_among_all(
    tree: EvolutionTree,
    is_in: npt.NDArray[np.bool_],
    part: EvolutionTree,
    data: bytes,
    request: Request,
) -> float:
    """PSNR of the whole scene, dB, if all err as the leaves of a stream of a part do among all.

    Args:
        tree: the scene.
        is_in: (n,) which slots of it the part has.
        part: of the tree.
        data: a stream of the part.
        request: of views.
    """
    scene, (_, live) = tree.shared_leaves(), tree.lineage()
    views = request.views(scene, N_VIEWS)
    assert views is not None, "there are views"
    mixed = scene.channels().copy()
    rows = np.flatnonzero(is_in[live])
    found = decode(data).leaves(sh_degree=tree.shown_degree)
    mixed[:, rows[leaf_order(part)]] = found.channels()
    share = part.n_leaves / tree.n_leaves
    return views.psnr(SplatParams.from_channels(mixed)) + 10 * math.log10(share)


def _rounded(n: float) -> int:
    """To two digits."""
    unit = 10.0 ** max(math.floor(math.log10(max(n, 1))) - 1, 0)
    return int(round(n / unit) * unit)
