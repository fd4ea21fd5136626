"""Rows of the encoder: trees at the extremes, their decoded errors against what is promised."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from evogs_codec import PRESETS, EvolutionTree, Step, TargetEncoder, decode, encode, lift
from evogs_codec.encoding.arrange import arrange
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS, n_channels
from tools.bench.extremes.measured import measure
from tools.bench.extremes.row import Row, attempted, outcome
from tools.bench.extremes.scenes import SCENES, chain, plain

__all__ = ["chains", "grids", "products", "scenes", "targets"]

ALPHAS = {
    "1": [1.0],
    "1/3": [1 / 3],
    "10": [10.0],
    "-1": [-1.0],
    "mixed, -3 to 10": [0.5, -1.0, 2.4, 10.0, 1 / 3, -3.0],
}
ASKED = {"position": 1e-4, "rotation": 1e-3, "scale": 1e-3, "opacity": 1e-3, "sh": 1e-3}
ADDS = "s/2"
RECORDS = "records (section 2)"
UNIT = "1 unit"


def scenes(n: int) -> Iterator[Row]:
    """Scenes of n splats, as adds and as lifted trees."""
    for name, (make, group) in SCENES.items():
        splats = make(n)
        flat, lifted = EvolutionTree.of_splats(splats), lift(splats, 4)
        yield _row(f"{name}; one level, `scene`", flat, "scene", ADDS, group=group)
        for preset, bound in (("scene", RECORDS), ("trained", RECORDS), ("near-lossless", UNIT)):
            yield _row(f"{name}; 4 levels, `{preset}`", lifted, preset, bound, group=group)
    yield _one_long_quaternion(n)
    yield _one_far_splat(n)


def targets(n: int) -> Iterator[Row]:
    """`--max-error` on lifted scenes of n splats: one for each group."""
    for name, (make, group) in SCENES.items():
        splats = make(n)
        asked = dict(ASKED)
        if group == "position":  # a part of the scene, but no less than half a step of binary32
            size = float(np.ptp(splats.means.astype(np.float64), axis=0).max())
            asked["position"] = max(1e-4 * size, 2.0**-25 * float(np.abs(splats.means).max()))
        yield attempted(name, _words(asked), partial(_target, name, lift(splats, 4), asked))
    too_little = dict.fromkeys(GROUPS, 1e-13)
    beyond = outcome(
        partial(_aimed, TargetEncoder(lift(plain(n), 4), PRESETS["scene"]), too_little)
    )
    part = 0.0 if "`TargetMissedError`" in beyond else np.inf
    yield Row("1e-13 of every group, which binary32 has not", "refused", beyond, part, "")


def chains(n: int) -> Iterator[Row]:
    """Chains of n generations of splits and refines."""
    for name, alphas in ALPHAS.items():
        for preset, bound in (("trained", RECORDS), ("near-lossless", UNIT)):
            tree = chain(n, size=1.0, alphas=alphas)
            yield _row(f"{n} generations, alpha {name}; `{preset}`", tree, preset, bound)


def grids(n: int) -> Iterator[Row]:
    """Values at both ends of the grid exponents, and at the largest origin."""
    mixed = ALPHAS["mixed, -3 to 10"]
    tiny = chain(n, size=1e-9, alphas=mixed)
    beyond = outcome(lambda: _lost(1e-13))
    yield _row(f"G = 40: {n} generations of size 1e-9", tiny, "near-lossless", UNIT, beyond)
    huge = chain(n, size=2e10, alphas=mixed)
    beyond = outcome(lambda: _encoded(chain(n, size=2.0**41, alphas=mixed), "near-lossless"))
    name = f"G down to -16: {n} generations of size 2e10"
    yield _row(name, huge, "near-lossless", UNIT, beyond)
    edge = _roots(np.array([-(2.0**38), 2.0**38]))
    over = _roots(np.array([-(2.0**38), np.nextafter(np.float32(2.0**38), np.float32(np.inf))]))
    beyond = outcome(lambda: _encoded(over, "near-lossless"))
    yield _row("G = -16: values of 2^38", edge, "near-lossless", UNIT, beyond)
    last = 2.0**27 * 2.0**16  # the largest state that the encoder aims at, on the coarsest grid
    edge, over = _roots(np.array([-last, last])), _roots(np.array([-last, 1.001 * last]))
    beyond = f"1.001 times that: {outcome(lambda: _encoded(over, 'trained'))}"
    yield _row("G = -16: values of 2^43", edge, "trained", ADDS, beyond)
    alone = EvolutionTree.of_splats(replace(plain(1), means=np.full((1, 3), 1e6, np.float32)))
    yield _row("origin: one splat at 1e6", alone, "near-lossless", UNIT)


def products(_: int) -> Iterator[Row]:
    """Splits whose alpha psi reaches the limit of products, 2^30 (R-7.3-2)."""
    for alpha, psi in ((32767 / 4096, 0.25), (32767 / 4096, 2.0), (10.1, 8.0), (10.1, 8000.0)):
        tree = _two_splits((alpha, 0.5), (psi, 0.1))
        for preset, bound in (("trained", RECORDS), ("near-lossless", UNIT)):
            name = f"alpha = {alpha:.8g} on psi = {psi:g}, beside others; `{preset}`"
            yield _row(name, tree, preset, bound)


def _row(
    name: str,
    tree: EvolutionTree,
    preset: str,
    bound: str,
    beyond: str = "",
    *,
    group: str = "",
) -> Row:
    """The line of a tree; the error shown is that of `group`, or of the worst one."""

    def run() -> Row:
        found = measure(tree, PRESETS[preset])
        shown = group or found.group
        said = (f"warned: {text}" for text in found.warned)
        return Row(
            extreme=name,
            bound=bound,
            observed=f"{found.errors[shown]:.3g}, {shown}",
            part=found.part,
            beyond="; ".join(filter(None, (*said, beyond))),
        )

    return attempted(name, bound, run)


def _target(name: str, tree: EvolutionTree, asked: dict[str, float]) -> Row:
    """The leaves of the stream against the leaves of the tree, both as binary32."""
    aim = TargetEncoder(tree, replace(PRESETS["scene"], zstd_level=1))
    got = decode(aim.within(asked)).leaves().channels().astype(np.float64)
    wanted = [tile.leaves().channels() for tile in arrange(tree, 1)]
    off = np.abs(got - np.concatenate(wanted, axis=1))
    found = {
        group: float(off[part].max()) for group, part in zip(GROUPS, GROUP_CHANNELS, strict=True)
    }
    part = max(found[group] / error for group, error in asked.items())
    return Row(name, _words(asked), _words(found), part, "")


def _aimed(aim: TargetEncoder, errors: dict[str, float]) -> str:
    return f"{len(aim.within(errors))} bytes"


def _words(errors: dict[str, float]) -> str:
    return ", ".join(f"{group} {error:.3g}" for group, error in errors.items())


def _one_long_quaternion(n: int) -> Row:
    """A quaternion of 1e6 makes the rotations of all others vanish, and a warning."""
    splats = plain(n)
    quats = splats.quats.copy()
    quats[0] *= 1e6
    tree = EvolutionTree.of_splats(replace(splats, quats=quats))
    quats[0] *= 1e24
    beyond = outcome(lambda: _encoded(EvolutionTree.of_splats(replace(splats, quats=quats))))
    name = "one quaternion of 1e6 among others; one level, `scene`"
    return _row(name, tree, "scene", ADDS, f"1e30: {beyond}", group="rotation")


def _one_far_splat(n: int) -> Row:
    """A position of 1e9 makes the grid coarser, and a warning; one of 1e14 is refused."""
    splats = plain(n)
    means = splats.means.copy()
    means[0] = 1e9
    tree = EvolutionTree.of_splats(replace(splats, means=means))
    means[0] = 1e14
    beyond = outcome(lambda: _encoded(EvolutionTree.of_splats(replace(splats, means=means))))
    name = "one splat at 1e9 among others; one level, `scene`"
    return _row(name, tree, "scene", ADDS, f"1e14: {beyond}", group="position")


def _encoded(tree: EvolutionTree, preset: str = "scene") -> str:
    return f"{len(encode(tree, PRESETS[preset]))} bytes"


def _lost(size: float) -> str:
    """What near-lossless leaves of numbers below half the finest unit, 2^-41."""
    found = measure(_roots(np.array([-size, size])), PRESETS["near-lossless"])
    is_zero = all(not step.adds.any() for tile in found.coded.tiles for step in tile.steps)
    return f"{size:g} is {'0' if is_zero else 'not 0'}"


def _roots(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> EvolutionTree:
    """Roots all of whose numbers are one value."""
    adds = np.tile(values.astype(np.float32), (n_channels(0), 1))
    return EvolutionTree(0, (Step.of_adds(0, adds),))


def _two_splits(alphas: tuple[float, ...], psi: tuple[float, ...]) -> EvolutionTree:
    d, n = n_channels(0), len(alphas)
    roots = Step.of_adds(0, np.zeros((d, n), np.float32))
    splits = Step(
        1,
        np.arange(n, dtype=np.int32),
        np.ones(n, np.uint8),
        np.tile(np.array(psi, np.float32), (d, 1)),
        np.tile(np.array(alphas, np.float32), (5, 1)),
        np.zeros((d, 0), np.float32),
    )
    return EvolutionTree(0, (roots, splits))
