"""What the encoder promises for every number of a tree (docs/extremes.md, sections 1 and 2).

Errors are in grid units, s is a quantiser step in grid units. Letters: D channels, n slots.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.encoding.alpha_tables import ALPHA_RATE
from evogs_codec.model.channels import GROUP_CHANNELS, channel_class, n_channels
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import EvolutionTree, Kind

__all__ = ["SLACK", "closed_loop", "near_lossless"]

# What float64 errs in numbers below 2**31 units over 64 generations: 64 * 2**31 * 2**-53, doubled.
SLACK = 2.0**-15


def near_lossless(tree: EvolutionTree) -> F64:
    """(D, n) one unit, in every slot."""
    n = sum(step.n_new for step in tree.steps)
    return np.ones((n_channels(tree.sh_degree), n))


def closed_loop(tree: EvolutionTree, coded: CodedTree, tile: CodedTile) -> F64:
    """(D, n) bound of the error after the last step, along the records of each slot.

    Args:
        tree: of floats, arranged: its slots are those of the stream.
        coded: what it became.
        tile: of `coded`, that of the tree.
    """
    d = n_channels(tree.sh_degree)
    classes = [channel_class(c) for c in range(d)]
    scale = np.array([[2.0 ** coded.grid_exponents[min(k, 4)]] for k in classes])
    bound = np.zeros((d, 0))
    for step, record in zip(tree.steps, tile.steps, strict=True):
        s = np.array([[coded.quantisers[1 + step.level][k].step] for k in classes], np.float64)
        of_adds = np.array([[coded.quantisers[0][k].step] for k in classes], np.float64)
        has_psi = step.kinds != Kind.DROP
        targets = step.slots[has_psi]
        is_split = step.kinds[has_psi] == Kind.SPLIT
        first = np.broadcast_to(s / 2, (d, len(targets))).copy()
        second = np.zeros((d, int(is_split.sum())))
        for group, part in enumerate(GROUP_CHANNELS):
            psi = np.abs(step.psi[part].astype(np.float64)) * scale[part]
            inherited = bound[part][:, targets]
            if not is_split.any() and step.psi.any() and not psi.any():
                first[part] = inherited  # refines of other groups leave this one as it is
            if not is_split.any():
                continue
            table = coded.alpha_table(step.level, group)
            alpha = table.values[record.alpha[group]]
            wanted = step.alpha[group].astype(np.float64)
            of_splits, e = psi[:, is_split], inherited[:, is_split]
            one, two = _split(e, np.abs(alpha - wanted) * of_splits, alpha, s[part], group == 0)
            cap = _of_best_alpha(e, of_splits, wanted, table.values, s[part])
            first[part][:, is_split] = np.minimum(one, cap) + s[part] / 2
            second[part] = np.minimum(two, cap) + np.abs(alpha) * s[part] / 2 + 0.5
        bound[:, targets] = first
        adds = np.broadcast_to(of_adds / 2, (d, step.n_adds))
        bound = np.concatenate([bound, second, adds], axis=1)
        bound[:, step.slots[~has_psi]] = 0
    return bound + SLACK


def _split(inherited: F64, miss: F64, alpha: F64, s: F64, is_position: bool) -> tuple[F64, F64]:
    """Errors of C1 and C2 before rounding, with the alpha that was taken.

    Args:
        inherited: (C, S) bound of the error of P.
        miss: (C, S) |alpha - alpha of the tree| |psi|.
        alpha: (S,) taken.
        s: (C, 1) step of psi.
        is_position: the least largest error is sought whatever the error of P.
    """
    even = inherited + miss / (1 + np.maximum(alpha, 0))
    # Least squares where alpha <= 0, and where no channel of the group errs by more than a step.
    small = np.where(alpha > 0, np.minimum(inherited, s), inherited)
    line = (np.abs(1 + alpha) * small + miss) / (1 + alpha * alpha)
    one, two = np.abs(alpha) * line, line
    if is_position:
        return np.where(alpha > 0, even, one), np.where(alpha > 0, even, two)
    either = alpha > 0
    return np.where(either, np.maximum(even, one), one), np.where(
        either, np.maximum(even, two), two
    )


def _of_best_alpha(inherited: F64, psi: F64, wanted: F64, entries: F64, s: F64) -> F64:
    """(C, S) what no child may exceed before rounding, since the alpha taken costs least.

    The cost of the entry nearest to the alpha of the tree bounds it: joint squared error, what
    rounding adds, and bits of the index.
    """
    nearest = entries[np.abs(entries[:, None] - wanted).argmin(0)]
    squares = 1 + nearest * nearest
    off = np.abs(1 + nearest) * inherited + np.abs(nearest - wanted) * psi
    joint = np.square(off / s).sum(0) / squares
    bits = np.log2(2 * len(wanted) + len(entries))
    cap: F64 = np.sqrt(joint + squares * len(psi) / 12 + ALPHA_RATE * bits) * s
    return cap
