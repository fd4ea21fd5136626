"""Every choice of a training run, as frozen dataclasses; and the presets.

Numbers without another source are those of 3D Gaussian Splatting (3DGS).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

__all__ = [
    "MAX_SHIFTED",
    "METHODS",
    "PRESETS",
    "CloudGrowth",
    "Config",
    "FrontierGrowth",
    "Integers",
    "Rates",
]

METHODS = (
    "evogs",
    "evogs-mixed",
    "evogs-sym",
    "evogs-a",
    "evogs-b",
    "lapis",
    "l3gs",
    "mono",
    "single",
)


# Numbers in the photographs of a level that has shifted ones: these take 12 bytes for each of them,
# and photographs of twice the size 16.
MAX_SHIFTED = 1 << 26


@dataclass(frozen=True)
class Rates:
    """Learning rates of Adam.

    Attributes:
        position, position_final: of positions and their psi, times the size of the scene
            (`CameraPath.scene_size`); from one to the other, exponentially, in every level.
        rotation, scale, opacity: of the raw parameters and their psi.
        sh, sh_rest: of band 0, and of the others.
        alpha: of the factors of splits; a tenth of it starves them.
        cool: all rates fall to this part of themselves, exponentially, in the last `cool_span` of
            a level.
        cool_span: part of a level.
    """

    position: float = 1.6e-4
    position_final: float = 1.6e-6
    rotation: float = 1e-3
    scale: float = 5e-3
    opacity: float = 0.05
    sh: float = 2.5e-3
    sh_rest: float = 1.25e-4
    alpha: float = 0.02
    cool: float = 0.1
    cool_span: float = 0.3

    def at_most(self, position: float) -> Rates:
        """With the first rate of positions at most this, and the last one lowered as much."""
        if position >= self.position:
            return self
        part = position / self.position
        return replace(
            self, position=part * self.position, position_final=part * self.position_final
        )


@dataclass(frozen=True)
class CloudGrowth:
    """Densification of plain 3DGS, under a cap.

    Attributes:
        start, stop, every: iterations at which splats are cloned, split and pruned; `stop` is a
            part of the level.
        threshold: least mean gradient to the centre on the screen, in NDC.
        dense: above this part of the extent a splat is split, below it is cloned.
        prune_opacity: splats less opaque than this are removed.
        prune_scale: splats wider than this part of the extent are removed, or of the distance to
            the nearest camera if that is more.
        reset_every: opacities fall to 0.01 this often; 0 for never.
        most: at most this part of the splats densifies at once.
        sh_every: iterations until the next SH band comes in.
        n_random: splats at the start where the data has no points.
    """

    start: int = 500
    stop: float = 0.5
    every: int = 100
    threshold: float = 2e-4
    dense: float = 0.01
    prune_opacity: float = 0.005
    prune_scale: float = 0.1
    reset_every: int = 0
    most: float = 1.0
    sh_every: int = 1000
    n_random: int = 100_000


@dataclass(frozen=True)
class FrontierGrowth:
    """Growth of a tree within a level.

    Attributes:
        start: iteration of the first round; gradients are collected until then.
        stop: part of the level at which the last round is.
        rounds: how often leaves are split.
        haste: below 1, the first rounds split more leaves than the last; leaves that are never
            split do not learn.
        refines_first: in a mixed tree the leaves of the level before get a psi of their own, which
            their children share: a refine each. None: level 1 is trained with them, and once more
            without, and all levels are made as the one that is worth its bytes. Trees in floats
            have them then.
        refines_rest: after the last round, leaves that were not split get a psi of their own: a
            refine each. The paper leaves them as they are.
        all_alphas: splits of mixed trees learn alpha of every group, not of sizes and opacities
            alone: more bytes, but short levels learn faster. Where level 1 is tried without
            refines, its splits do, too.
        threshold: least mean gradient to the centre on the screen, in NDC.
        size_power: leaves of the largest gradients are split first. Gradients are multiplied by
            this power of the width of a leaf, the geometric mean of its two larger standard
            deviations. In the paper they are not.
        first_step: where the first rate of positions is more than this part of the median width
            of the leaves before the level, both rates are lowered: splats of fine levels are
            small. 0 for never, as in the paper.
        distance: children sit this many standard deviations from their parent.
        prune_opacity, prune_scale: as in `CloudGrowth`.
    """

    start: int = 100
    stop: float = 0.45
    rounds: int = 5
    haste: float = 1.0
    refines_first: bool | None = True
    refines_rest: bool = False
    all_alphas: bool = False
    threshold: float = 2e-4
    size_power: float = 0.0
    first_step: float = 0.0
    distance: float = 0.3
    prune_opacity: float = 0.005
    prune_scale: float = 0.1


@dataclass(frozen=True)
class Integers:
    """Training of trees in the integers of the codec, at the end of every level.

    Attributes:
        part: of the iterations of a level, after them; 0 for none.
        distortion: squared error that rounding adds to the pictures before descent reduces it, as a
            part of the error that they have; nearly. More makes smaller streams.
        thrift: bits of the psi of a mixed tree weigh in the loss while they are still floats, by
            this times `distortion`: as a part of the loss, for each bit of a number on average.
        rate: of the learning rates, falling to a tenth of that. Positions have come to rest before:
            they have ten times, falling to once, this part of their last rate.
    """

    part: float = 0.0
    distortion: float = 0.07
    thrift: float = 1.0
    rate: float = 0.3

    def __post_init__(self) -> None:
        if not 0 <= self.part <= 1:
            raise ValueError(f"a part of {self.part:g} in integers, expected 0 to 1")
        if not 0 < self.distortion < 10:
            raise ValueError(f"distortion is {self.distortion:g}, expected above 0, below 10")
        if not 0 <= self.thrift <= 100:
            raise ValueError(f"thrift is {self.thrift:g}, expected 0 to 100")
        if not 0 < self.rate <= 1:
            raise ValueError(f"rate is {self.rate:g}, expected above 0, at most 1")

    def price(self, error: float, n: int) -> float:
        """Squared error of the pictures that a bit of a level is worth.

        Args:
            error: mean squared error of the pictures.
            n: numbers of the level.
        """
        # An error of D takes n / 2 log2(1 / D) bits: what a bit saves is D / n, nearly.
        return self.distortion * error / max(n, 1)

    def rates(self, rates: Rates) -> Rates:
        """Those of a level, as it is trained in integers."""
        r = self.rate
        return replace(
            rates,
            position=10 * r * rates.position_final,
            position_final=r * rates.position_final,
            rotation=r * rates.rotation,
            scale=r * rates.scale,
            opacity=r * rates.opacity,
            sh=r * rates.sh,
            sh_rest=r * rates.sh_rest,
            cool=0.1,
            cool_span=0.6,
        )


@dataclass(frozen=True)
class Config:
    """A training run.

    Attributes:
        method: one of `METHODS`.
        seed: of everything random.
        sh_degree: 0..3.
        iterations: of each level, in floats.
        max_splats: most splats that each level may draw.
        ssim_weight: part of D-SSIM in the loss.
        rates, cloud, frontier, integers: see there.
        equal_buckets: of L3GS, as published; else in proportion to `max_splats`.
        next_size: after so many photographs of its own size, in the mean, a level is trained on one
            of the size of the next level, for when it is drawn there; 0 for none.
        shifts: photographs are there on grids of pixels that are half a pixel apart, too, made of
            those of twice the size: held-out views gain what trained ones lose. Levels of more
            than `MAX_SHIFTED` numbers have one grid.
        checkpoint_every: iterations.
    """

    method: str = "evogs"
    seed: int = 0
    sh_degree: int = 2
    iterations: tuple[int, ...] = (7000, 4000, 4000, 5000)
    max_splats: tuple[int, ...] = (4_000, 12_000, 36_000, 100_000)
    ssim_weight: float = 0.2
    rates: Rates = field(default_factory=Rates)
    cloud: CloudGrowth = field(default_factory=CloudGrowth)
    frontier: FrontierGrowth = field(default_factory=FrontierGrowth)
    integers: Integers = field(default_factory=Integers)
    equal_buckets: bool = False
    next_size: int = 0
    shifts: bool = False
    checkpoint_every: int = 500

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method {self.method!r} is none of {', '.join(METHODS)}")
        if not self.iterations or len(self.iterations) != len(self.max_splats):
            raise ValueError(
                f"{len(self.iterations)} levels have iterations, {len(self.max_splats)} a cap"
            )
        if min(self.iterations) < 1 or min(self.max_splats) < 1:
            raise ValueError("iterations and max_splats are at least 1")
        if not 0 <= self.next_size <= 1000:
            raise ValueError(f"next_size is {self.next_size}, expected 0 to 1,000")
        if not 0 <= self.sh_degree <= 3:
            raise ValueError(f"sh_degree is {self.sh_degree}, expected 0..3")

    @property
    def n_levels(self) -> int:
        """Levels of the run."""
        return len(self.iterations)

    def as_published(self) -> Config:
        """With the loss and photographs of 3DGS, and trees that grow and learn as published."""
        plain = Config()
        frontier = replace(
            self.frontier,
            size_power=plain.frontier.size_power,
            first_step=plain.frontier.first_step,
        )
        return replace(self, ssim_weight=plain.ssim_weight, shifts=plain.shifts, frontier=frontier)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(data: dict[str, Any]) -> Config:
        """The inverse of `as_dict`."""
        parts = {
            "rates": Rates, "cloud": CloudGrowth, "frontier": FrontierGrowth, "integers": Integers,
        }  # fmt: skip
        values = {f.name: data[f.name] for f in fields(Config)}
        for name, part in parts.items():
            values[name] = part(**values[name])
        for name in ("iterations", "max_splats"):
            values[name] = tuple(values[name])
        return Config(**values)


# 3DGS trains a level for 30,000 iterations; a tenth of that wants larger steps.
_FAST = Rates(
    position=5e-4,
    position_final=5e-6,
    rotation=4e-3,
    scale=0.01,
    sh=0.01,
    sh_rest=5e-3,
    alpha=0.05,
)
_TWO_CORES = Config(
    rates=_FAST,
    ssim_weight=0.4,
    shifts=True,
    # Fills the budget whatever the gradients, and early: what is not split does not learn.
    frontier=FrontierGrowth(
        refines_first=None,
        threshold=0.0,
        size_power=0.5,
        first_step=0.15,
        rounds=3,
        stop=0.25,
        haste=0.25,
    ),
    integers=Integers(part=0.15),
)
PRESETS = {
    # The paper's schedule, on a GPU: rounds every 3,000 iterations up to 15,000.
    "paper": replace(
        Config(),
        sh_degree=3,
        iterations=(30_000,) * 4,
        max_splats=(500_000, 1_000_000, 2_000_000, 4_000_000),
        cloud=CloudGrowth(reset_every=3000),
        frontier=FrontierGrowth(start=3000, stop=0.5, rounds=5),
        integers=Integers(part=0.1),
        checkpoint_every=5000,
    ),
    # Eleven to sixteen minutes at 400 x 400 on two cores.
    "two-cores": _TWO_CORES,
    # A minute at 200 x 200. Splats may be as wide as what cameras surround: in so few iterations
    # the background is made of few, and 3DGS prunes by width only after 3,000. Shifted grids are
    # no gain before what is there is learned.
    "quick": replace(
        _TWO_CORES.as_published(),
        sh_degree=1,
        iterations=(2000, 600, 600, 600),
        max_splats=(500, 1_500, 4_000, 10_000),
        cloud=CloudGrowth(start=100, every=50, n_random=1000, sh_every=200, prune_scale=1.0),
        frontier=FrontierGrowth(
            start=50,
            rounds=3,
            stop=0.3,
            refines_first=None,
            all_alphas=True,
            threshold=0.0,
            haste=0.25,
            prune_scale=1.0,
        ),
        checkpoint_every=100,
    ),
}
