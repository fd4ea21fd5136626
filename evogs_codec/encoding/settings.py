"""What an encoder is asked for: steps per class and level, alpha tables, effort.

A step is the distance of two neighbouring values, in the units of the group: an error of half of it
at most, of a twelfth of its square on average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

__all__ = ["ALPHA_BITS", "N_ALPHA", "PRESETS", "TREE_PSNR", "Settings"]

# Pictures of a stream against those of its tree, dB: a tree 35 dB from photographs loses 0.1 dB.
TREE_PSNR = 52.0
N_ALPHA, ALPHA_BITS = 256, 10  # as many alphas as a table holds; which are used, their bits decide


@dataclass(frozen=True)
class Settings:
    """How to quantise a tree.

    Attributes:
        steps: per class (spec 3.2) the step that a splat coded on its own would have.
        relative: the position step is a part of the extent of the scene.
        coarser: per class the factor of the step per level below the last. Where a child inherits
            the error of its parent, the step is shared out over the levels: for positions largest
            errors add up, for the rest mean squares. 0: the same step at all levels.
        adds: factor of the step of adds to that of psi at level 0.
        n_alpha: entries of an alpha table at most, where the tree's own alphas are more.
        alpha_bits: K of tables that are fitted.
        closed_loop: quantise against what the decoder has.
        range_bits: if not 0, steps that divide the range of psi of a level and group into
            2**range_bits - 1, and of adds 256 times finer, instead of `steps`.
        near_lossless: one grid unit per generation; the grids are as fine as 24 bits allow.
        effort: Zstandard level.
        table: if not empty, the steps of the adds and of psi of each level, per class, in the units
            of the group: instead of all that make steps above.
        whole_origins: origins of tiles are multiples of the position step of adds, so that adds
            that are multiples stay as they are.
    """

    steps: tuple[float, ...]
    relative: bool = False
    coarser: tuple[float, ...] = (0.0,) * 8
    adds: float = 1.0
    n_alpha: int = 32
    alpha_bits: int = 5
    closed_loop: bool = True
    range_bits: int = 0
    near_lossless: bool = False
    effort: int = 19
    table: tuple[tuple[float, ...], ...] = ()
    whole_origins: bool = False

    @staticmethod
    def of_quanta(quanta: tuple[tuple[float, ...], ...]) -> Settings:
        """For a tree whose numbers are multiples of `quanta` (`EvolutionTree`).

        The multiples go into the stream as they are, without a loop that would change them to mend
        what the grid rounds off products of alpha.
        """
        return replace(
            PRESETS["trained"],
            closed_loop=False,
            n_alpha=N_ALPHA,
            alpha_bits=ALPHA_BITS,
            table=quanta,
            whole_origins=True,
        )

    def finer(self, factor: float) -> Settings:
        """The same with all steps divided by `factor`: 2 halves all errors."""
        table = tuple(tuple(step / factor for step in row) for row in self.table)
        return replace(self, steps=tuple(step / factor for step in self.steps), table=table)


_SCENE = Settings(
    steps=(1.18e-4, 0.0027, 0.105, 0.14, 0.036, 0.118, 0.118, 0.118),
    relative=True,
    # A lifted parent has the rotation of a child, whose error it does not pass on.
    coarser=(0.5, 0.0, 0.7, 0.7, 0.7, 0.7, 0.7, 0.7),
)
_TRAINED = Settings(steps=(0.0005, 0.02, 0.06, 0.12, 0.03, 0.03, 0.03, 0.03), adds=0.5)

PRESETS = {
    # Accuracy of SPZ version 4, position relative to the extent: for lifted scenes.
    "scene": _SCENE,
    # Closed loop at the steps where a trained tree starts to lose image quality.
    "trained": _TRAINED,
    # The paper's proof of concept: 8 bits by range, open loop.
    "paper": replace(_TRAINED, closed_loop=False, range_bits=8, n_alpha=256),
    "near-lossless": replace(_TRAINED, near_lossless=True, n_alpha=256, alpha_bits=7),
}
