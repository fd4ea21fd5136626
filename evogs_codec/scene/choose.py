"""The best stream of the trees that a scene may be encoded as: plainly, or to a target."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.late_level import can_be_late
from evogs_codec.encoding.layers import N_LAYERS, Layering
from evogs_codec.encoding.measured_gains import ORDERING_VIEWS
from evogs_codec.encoding.palette_worth import bits_of_palette, bits_of_psi
from evogs_codec.encoding.settings import SCENE_PRESET, SCENE_PRICE, TREE_PRESET, TREE_PSNR
from evogs_codec.encoding.targets import TargetEncoder, TargetMissedError
from evogs_codec.encoding.write import write
from evogs_codec.errors import InputError
from evogs_codec.format.write_directory import MAX_LEVELS
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.splats import I64
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.measure import with_room
from evogs_codec.scene.request import Request

__all__ = ["FoundStream", "at_tree_psnr", "best_stream"]

# So many times the bits, by an estimate, are more: of psi, and of picks, of which the estimate does
# not see that neighbours have the same.
SURE, SURE_OF_PICKS = 1.05, 2.0
DRAFT = 1  # level of Zstandard of what is written to be looked at
SEEN = 0.9  # of the worth of a number, where nobody said from where a scene is looked at


@dataclass(frozen=True, eq=False)
class FoundStream:
    """A stream and the tree that it is of; the larger `merit` is the better.

    `aim` and `make` are how it was made, if by views. A draft has the integers of the stream, in
    more bytes: it is `coded` at a `price` of a bit, and `finished` writes it.
    """

    data: bytes
    tree: EvolutionTree
    merit: float = 0.0
    aim: TargetEncoder | None = None
    make: Callable[[TargetEncoder], bytes] | None = None
    price: float = 0.0
    coded: CodedTree | None = None

    @staticmethod
    def draft(aim: TargetEncoder, price: float) -> FoundStream:
        """At a price of a bit."""
        coded = aim.prepared.coded(price)
        data = write(coded, effort=DRAFT, digests=False)
        return FoundStream(data, aim.tree, aim=aim, price=price, coded=coded)

    def finished(self) -> bytes:
        """The bytes, of a draft those of the stream."""
        if self.aim is None or self.coded is None:
            return self.data
        return self.aim.written(self.coded)

    @property
    def is_by_views(self) -> bool:
        """Whether views decided how exact numbers are."""
        return self.aim is not None and self.aim.views is not None

    @property
    def is_layered(self) -> bool:
        """Whether it has several layers of precision."""
        return self.aim is not None and self.aim.layers > 1

    @property
    def n_coarse(self) -> int:
        """Levels at coarse steps, or all of them where there is one layer."""
        layered = None if self.aim is None else self.aim.prepared.layered
        return self.tree.n_levels if layered is None else layered.n_coarse

    @property
    def orders(self) -> Sequence[I64 | None] | None:
        """What layers did to the order of slots (`EncodedScene`)."""
        layered = None if self.aim is None else self.aim.prepared.layered
        return None if layered is None else layered.orders

    @property
    def can_be_late(self) -> bool:
        """Whether the last level of the tree may come with a second layer."""
        if self.aim is None or not self.is_layered:
            return False
        return can_be_late(self.aim.prepared.tiles, self.tree.n_levels)

    def holding(self, runs: Sequence[Run], layering: Layering) -> FoundStream | None:
        """That of the same tree with runs of steps held back (`TargetEncoder.holding`).

        None if it was not made by views, or if the target is missed.
        """
        if self.aim is None or not self.is_by_views:
            return None
        aim = self.aim.holding(runs, layering)
        if self.coded is not None:
            return FoundStream.draft(aim, self.price)
        if self.make is None:
            return None
        try:
            return replace(self, data=self.make(aim), aim=aim)
        except TargetMissedError:
            return None


def best_stream(
    trees: Sequence[EvolutionTree], request: Request, leaf_error: tuple[float, ...]
) -> FoundStream:
    """The best stream of trees with the same leaves, at the target if there is one."""
    tree = trees[-1]
    whole = TargetEncoder(
        tree,
        request.settings,
        leaf_error=leaf_error,
        n_tiles=request.n_tiles,
        info=request.info,
        progress=request.progress,
    )
    if request.errors:
        return _best(_each(whole, trees), lambda aim: aim.within(request.errors))
    if request.is_plain and not request.has_preset and tree.n_leaves and _draws(request):
        views = request.weighing_views(tree.leaves())
        ordering = None if views is None else views.fewer(request.effort.n_band_views)
        aim = replace(whole, views=views, ordering=ordering, layers=_layers(tree, request))
        aim = replace(aim, by_leaves=request.effort.by_leaves)
        aim = aim if request.cameras else replace(aim, seen=SEEN)
        price = SCENE_PRICE / tree.n_leaves
        aims = _that_pay(_each(aim, trees), price, is_sure=not request.effort.looks)
        return _at_price(aims, price, looks=request.effort.looks)
    if request.is_plain:
        views = request.views(tree.leaves(), ORDERING_VIEWS) if tree.n_leaves else None

        def plainly(aim: TargetEncoder) -> bytes:
            return encode(
                aim.tree,
                request.settings,
                n_tiles=request.n_tiles,
                info=request.info,
                views=views,
                progress=request.progress,
            )

        return _best(_each(whole, trees), plainly)
    if not tree.n_leaves:
        raise InputError("a scene without splats has nothing to aim at")
    views = request.views(tree.leaves(), descent=request.polish > 0)
    layers = request.layers or (1 if views is None else _layers(tree, request))
    if views is None and (request.polish or layers > 1 or request.target_psnr is not None):
        by_bytes = "polishing needs" if request.polish else "several layers need"
        what = by_bytes if request.target_psnr is None else "a target PSNR needs"
        raise InputError(f"{what} rendered views: {request.why_no_views}")
    # The last layer refines every leaf, whatever the tree does.
    moves = layers > 1 or any(
        step.level == tree.n_levels - 1 > 0 and step.psi.any() for step in tree.steps
    )
    if request.polish and not moves:
        warnings.warn("polishing changes nothing: the last level refines nothing", stacklevel=3)
    aim = replace(whole, views=views, polish=request.polish, layers=layers)
    if request.target_bytes is not None:
        most = request.target_bytes
        n_levels = max(tree.n_levels, 1) + layers - 1
        aim = replace(aim, info=with_room(request.info, tree, n_levels, request))
        return _best(_each(aim, trees), lambda one: one.at_bytes(most), TargetEncoder.psnr)
    target = request.target_psnr
    assert target is not None, "there is a target"
    return _best(_each(aim, trees), lambda one: one.at_psnr(target))


def _layers(tree: EvolutionTree, request: Request) -> int:
    """Layers of precision: what was asked for, or as many as there is room for."""
    return request.layers or max(1, min(N_LAYERS, 1 + MAX_LEVELS - tree.n_levels))


def _draws(request: Request) -> bool:
    """Whether something can be rendered; if not although it was to be, a warning says so."""
    if request.why_no_views and request.cameras is None:
        said = f"{request.why_no_views}; encoded with the preset {SCENE_PRESET} instead"
        warnings.warn(said, stacklevel=4)
    return not request.why_no_views


def _each(aim: TargetEncoder, trees: Sequence[EvolutionTree]) -> list[TargetEncoder]:
    return [replace(aim, tree=tree) for tree in trees]


def _that_pay(
    aims: Sequence[TargetEncoder], price: float, *, is_sure: bool = False
) -> Sequence[TargetEncoder]:
    """Of a tree with a palette and one without, that of fewer bits where an estimate is sure."""
    if len(aims) == 1:
        return aims
    shared, plain = aims
    importance = shared.importance
    if importance is None:
        return aims
    bits = bits_of_palette(shared.tree, importance, price)
    instead = bits_of_psi(plain.tree, importance, price)
    if instead > SURE * bits:
        return [shared]
    if bits > SURE_OF_PICKS * instead:
        return [plain]
    if is_sure:
        return [shared if bits < math.sqrt(SURE_OF_PICKS) * instead else plain]
    return aims


def _at_price(aims: Sequence[TargetEncoder], price: float, *, looks: bool) -> FoundStream:
    """Of the drafts, that whose bits and errors cost least; the stream, if nothing looks at it."""
    if len(aims) == 1 and not looks:
        return FoundStream(aims[0].at_price(price), aims[0].tree)
    drafts = [FoundStream.draft(aim, price) for aim in aims]
    if len(drafts) == 1:
        return drafts[0]

    def cost(draft: FoundStream) -> float:
        assert draft.aim is not None, "drafts are made by views"
        return 8 * len(draft.finished()) * price + 10 ** (-draft.aim.psnr(draft.data) / 10)

    return min(drafts, key=cost)


def _best(
    aims: Sequence[TargetEncoder],
    make: Callable[[TargetEncoder], bytes],
    worth: Callable[[TargetEncoder, bytes], float] | None = None,
) -> FoundStream:
    """The smallest of the streams that meet a target, or that with the highest `worth`.

    Without views to tell its worth, the first that meets it.

    Raises:
        TargetMissedError: of the tree that comes nearest, if none meets it.
    """
    found: list[FoundStream] = []
    missed: list[TargetMissedError] = []
    for one in aims:
        try:
            data = make(one)
        except TargetMissedError as error:
            missed.append(error)
            continue
        if worth is None:
            found.append(FoundStream(data, one.tree, -len(data), one, make))
        elif len(aims) == 1 or one.views is None:
            return FoundStream(data, one.tree, math.inf, one, make)
        else:
            found.append(FoundStream(data, one.tree, worth(one, data), one, make))
    if not found:
        raise min(missed, key=lambda error: error.by)
    return max(found, key=lambda one: one.merit)


def at_tree_psnr(tree: EvolutionTree, request: Request) -> FoundStream | None:
    """At `TREE_PSNR`; None if nothing can be rendered, or if views show too little of the tree."""
    views = request.views(tree.leaves())
    instead = f"encoded with the preset {TREE_PRESET} instead"
    if views is None:
        warnings.warn(f"{request.why_no_views}; {instead}", stacklevel=3)
        return None
    aim = TargetEncoder(
        tree,
        request.settings,
        views,
        layers=_layers(tree, request),
        n_tiles=request.n_tiles,
        info=request.info,
        progress=request.progress,
    )

    def make(one: TargetEncoder) -> bytes:
        return one.at_psnr(TREE_PSNR)

    try:
        return FoundStream(make(aim), tree, aim=aim, make=make)
    except InputError as error:  # of a few splats, or none that is seen
        warnings.warn(f"{error}; {instead}", stacklevel=3)
        return None
