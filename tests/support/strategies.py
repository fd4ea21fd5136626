"""Hypothesis strategies that build valid inputs: splats and evolution trees.

Structure (steps, kinds, levels) shrinks record by record. Numbers come from a seeded generator in a
drawn style, since a hypothesis draw per channel would make trees of a few records slow.
"""

import numpy as np
from hypothesis import strategies as st

from evogs_codec.model.channels import GROUP_CHANNELS, n_channels
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step

SH_DEGREES = st.integers(0, 3)

# Largest magnitude of a style; "zero" comes first, so that it is what examples shrink to.
MAGNITUDES = (0.0, 1.0, 1e-6, 1e-40, 300.0, 1e6, 1e30)
ALPHAS = (0.0, 1.0, -1.0, 0.5, 10.0, -1000.0)


@st.composite
def numbers(draw, shape, largest=1e30):
    """Float32 arrays of `shape` (channels first), each group of channels in a style of its own."""
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    styles = st.sampled_from([m for m in MAGNITUDES if m <= largest])
    out = np.zeros(shape, np.float64)
    # Half of the examples are all of one style: fewer draws, and simpler failures.
    common = draw(st.none() | styles)
    for channels in GROUP_CHANNELS:
        magnitude = draw(styles) if common is None else common
        part = out[channels]
        part[...] = magnitude * rng.uniform(-1, 1, part.shape)
        if magnitude == 300.0:  # whole numbers, with repeats and ties
            part[...] = np.rint(part / 100) * 0.5
    return out.astype(np.float32)


@st.composite
def alphas(draw, n_splits):
    """(5, n_splits) float32: constant, one per group, or one per split."""
    out = np.empty((5, n_splits), np.float32)
    constant = draw(st.none() | st.sampled_from(ALPHAS))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    for row in out:
        if constant is not None:
            row[...] = constant
        elif draw(st.booleans()):
            row[...] = draw(st.sampled_from(ALPHAS))
        else:
            row[...] = rng.uniform(-10, 10, n_splits)
    return out


@st.composite
def splats(draw, max_size=12, sh_degrees=SH_DEGREES, largest=1e30):
    """`SplatParams` of 0 to `max_size` splats."""
    d = n_channels(draw(sh_degrees))
    n = draw(st.integers(0, max_size))
    return SplatParams.from_channels(draw(numbers((d, n), largest)))


@st.composite
def steps(draw, level, live, d, max_adds=4, largest=1e30):
    """A step that may follow slots of which `live` are (n,) live; often of one kind only."""
    candidates = np.flatnonzero(live).tolist()
    chosen = sorted(draw(st.sets(st.sampled_from(candidates)))) if candidates else []
    kind = st.sampled_from([Kind.REFINE, Kind.SPLIT, Kind.DROP])
    only = draw(st.none() | kind)
    kinds = [draw(kind) if only is None else only for _ in chosen]
    n_psi = sum(k != Kind.DROP for k in kinds)
    n_splits = sum(k == Kind.SPLIT for k in kinds)
    n_adds = draw(st.integers(0, max_adds))
    return Step(
        level,
        np.array(chosen, np.int32),
        np.array(kinds, np.uint8),
        draw(numbers((d, n_psi), largest)),
        draw(alphas(n_splits)),
        draw(numbers((d, n_adds), largest)),
    )


@st.composite
def trees(draw, max_roots=12, max_steps=5, sh_degrees=SH_DEGREES, largest=1e30):
    """Valid trees: no or several roots, steps of all mixes, several steps a level, empty levels.

    Args:
        draw: given by hypothesis.
        max_roots: adds of step 0 at most.
        max_steps: steps after step 0 at most.
        sh_degrees: strategy of the SH degree.
        largest: bound on the magnitude of roots, psi and adds.
    """
    degree = draw(sh_degrees)
    d = n_channels(degree)
    roots = draw(numbers((d, draw(st.integers(0, max_roots))), largest))
    result = [Step.of_adds(0, roots)]
    live = np.ones(roots.shape[1], bool)
    for _ in range(draw(st.integers(0, max_steps))):
        level = result[-1].level + draw(st.sampled_from([0, 1, 1, 2]))
        step = draw(steps(level, live, d, largest=largest))
        live[step.slots[step.kinds == Kind.DROP]] = False
        live = np.concatenate([live, np.ones(step.n_new, bool)])
        result.append(step)
    # A last level without records is only visible as an empty step.
    if draw(st.booleans()):
        result.append(Step.of_adds(result[-1].level + 1, np.empty((d, 0), np.float32)))
    return EvolutionTree(degree, tuple(result))
