"""The best stream of the trees that a scene may be encoded as: plainly, or to a target."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from evogs_codec.encoding.encode import encode
from evogs_codec.encoding.error_factors import N_MEASURING_VIEWS
from evogs_codec.encoding.guess import Guess, price_near
from evogs_codec.encoding.measured_gains import N_ORDERING_VIEWS
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.encoding.palette_worth import bits_of_palette, bits_of_psi
from evogs_codec.encoding.search import Found
from evogs_codec.encoding.sensitivity import SEEN_SHARE_OF_CIRCLE
from evogs_codec.encoding.settings import SCENE_PRESET, SCENE_PRICE, TREE_PRESET, TREE_PSNR
from evogs_codec.encoding.sketch import Sketch
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.errors import InputError
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.found_stream import FoundStream, Make
from evogs_codec.scene.measure import with_room
from evogs_codec.scene.reach import CHECKED_FROM, SURE_BYTES_OF_SPLAT
from evogs_codec.scene.request import Request

__all__ = ["at_tree_psnr", "best_stream", "palette_pays"]

# One of two trees is not encoded if it takes so many times the bits of the other by an estimate: of
# psi, and of picks, where the estimate does not know that neighbours have the same.
SURE_OF_PSI, SURE_OF_PICKS = 1.05, 2.0
MIN_GUESSED = 1_000  # splats; of fewer, a target is looked for before levels are looked at
# From `TREE_PSNR`, at most: of a splat or two a price of a bit moves a PSNR so far.
TREE_SLACK_DB = 1.0


def best_stream(
    trees: Sequence[EvolutionTree],
    request: Request,
    leaf_error: tuple[float, ...],
    scene: SplatParams,
) -> FoundStream:
    """The best stream of trees with the same leaves, at the target if there is one.

    Args:
        trees: of which one is encoded.
        request: what is asked for.
        leaf_error: of the leaves, as of `EncodeTask`.
        scene: what a PSNR that is aimed at is measured against. The leaves of the trees are it but
            for rounding.
    """
    tree = trees[-1]
    encoder = TargetEncoder(
        tree,
        request.settings,
        leaf_error=leaf_error,
        n_tiles=request.n_tiles,
        info=request.info,
        progress=request.progress,
    )
    if request.errors:
        return _best(_made_plainly(encoder, trees, lambda one: one.within(request.errors)))
    if request.is_plain:
        by_views = not request.has_preset and tree.n_leaves and _draws(request)
        return (_at_default_price if by_views else _at_steps)(encoder, trees, request)
    if not tree.n_leaves:
        raise InputError("a scene without splats has nothing to aim at")
    encoder = _aiming(encoder, request, scene)
    if request.target_bytes is not None:
        return _at_bytes(encoder, trees, request, request.target_bytes)
    assert request.target_psnr is not None, "there is a target"
    return _at_psnr(encoder, trees, request, request.target_psnr)


def _at_default_price(
    encoder: TargetEncoder, trees: Sequence[EvolutionTree], request: Request
) -> FoundStream:
    """The best of the trees where views decide how exact numbers are, without a target."""
    tree = encoder.tree
    views = request.weighing_views(tree.shared_leaves())
    ordering = None if views is None else request.effort.ordering_views(views)
    layers = request.n_layers(tree.n_levels)
    encoder = replace(encoder, views=views, ordering=ordering, layers=layers)
    if request.effort.by_leaves:
        encoder = replace(encoder, by_leaves=True)
    elif views is not None:
        encoder = replace(encoder, measuring=views.fewer(N_MEASURING_VIEWS))
    if request.cameras is None and not request.effort.all_round:
        encoder = replace(encoder, seen=SEEN_SHARE_OF_CIRCLE)
    price = request.effort.price * SCENE_PRICE / tree.n_leaves
    encoders = _that_pay(_each(encoder, trees), price, is_sure=not request.effort.looks)
    return _at_price(encoders, price)


def _at_steps(
    encoder: TargetEncoder, trees: Sequence[EvolutionTree], request: Request
) -> FoundStream:
    """The smallest of the trees at the fixed steps of a preset."""
    tree = encoder.tree
    views = request.views(tree.shared_leaves(), N_ORDERING_VIEWS) if tree.n_leaves else None

    def plainly(one: TargetEncoder) -> bytes:
        return encode(
            one.tree,
            request.settings,
            n_tiles=request.n_tiles,
            info=request.info,
            views=views,
            progress=request.progress,
        )

    return _best(_made_plainly(encoder, trees, plainly))


def _aiming(encoder: TargetEncoder, request: Request, scene: SplatParams) -> TargetEncoder:
    """The encoder with the views by which a target is looked for.

    Raises:
        InputError: the target needs views, and there are none.
    """
    tree = encoder.tree
    views = request.views_of_scene(scene)
    layers = request.n_layers(tree.n_levels)
    if views is None and (request.polish or layers > 1 or request.target_psnr is not None):
        by_bytes = "polishing needs" if request.polish else "several layers need"
        what = by_bytes if request.target_psnr is None else "a target PSNR needs"
        raise InputError(f"{what} rendered views: {request.why_no_views}")
    # The last layer refines every leaf, whatever the tree does.
    moves = layers > 1 or any(
        step.level == tree.n_levels - 1 > 0 and step.psi.any() for step in tree.steps
    )
    if request.polish and not moves:
        warnings.warn("polishing changes nothing: the last level refines nothing", stacklevel=4)
    encoder = replace(encoder, polish=request.polish, layers=layers)
    if views is None:
        return encoder
    effort = request.effort
    of_leaves = replace(views, scene=tree.shared_leaves(), drawn={})
    return replace(
        encoder,
        views=views.weighing_within(effort.pixels),
        ordering=effort.ordering_views(views),
        measuring=of_leaves.fewer(N_MEASURING_VIEWS).within(effort.pixels),
    )


def _at_bytes(
    encoder: TargetEncoder, trees: Sequence[EvolutionTree], request: Request, most: int
) -> FoundStream:
    """The best stream of the trees of at most so many bytes."""
    tree = encoder.tree
    n_levels = max(tree.n_levels, 1) + encoder.layers - 1
    encoder = replace(encoder, info=with_room(request.info, tree, n_levels, request))
    encoders = _each(encoder, trees)
    may_be_few = not request.is_in_reach and most < SURE_BYTES_OF_SPLAT * tree.n_leaves
    if encoder.views is not None and tree.n_leaves >= CHECKED_FROM and may_be_few:
        _expect_one(encoders, lambda one: one.expect_bytes(most))

    def make(one: TargetEncoder, near: float | None) -> Found[bytes]:
        return one.nearest_bytes(most, near)

    near = None if encoder.views is None else SCENE_PRICE / tree.n_leaves
    guess = partial(Guess.of_bytes, n_bytes=most)
    found = _aimed(encoders, make, near, guess, Sketch.psnr, TargetEncoder.psnr)
    return replace(found, n_bytes=most)


def _at_psnr(
    encoder: TargetEncoder, trees: Sequence[EvolutionTree], request: Request, decibels: float
) -> FoundStream:
    """The smallest stream of the trees that has this PSNR in views."""
    tree, encoders = encoder.tree, _each(encoder, trees)
    if not request.polish and tree.n_leaves >= CHECKED_FROM and not request.is_in_reach:
        encoders[0].expect_psnr(decibels)  # the leaves of the other tree are on the same grids

    def make(one: TargetEncoder, near: float | None) -> Found[bytes]:
        return one.nearest_psnr(decibels, near)

    near = price_near(decibels, SCENE_PRICE / tree.n_leaves)
    guess = partial(Guess.of_psnr, decibels=decibels)
    return replace(_aimed(encoders, make, near, guess, _fewness), psnr=decibels)


def _draws(request: Request) -> bool:
    """Whether something can be rendered; if not although it was to be, a warning says so."""
    if request.why_no_views and request.cameras is None:
        said = f"{request.why_no_views}; encoded with the preset {SCENE_PRESET} instead"
        warnings.warn(said, stacklevel=4)
    return not request.why_no_views


def _each(encoder: TargetEncoder, trees: Sequence[EvolutionTree]) -> list[TargetEncoder]:
    return [replace(encoder, tree=tree) for tree in trees]


def _that_pay(
    encoders: Sequence[TargetEncoder], price: float, *, is_sure: bool = False
) -> Sequence[TargetEncoder]:
    """Of a tree with a palette and one without, that of fewer bits where an estimate is sure."""
    if len(encoders) == 1:
        return encoders
    shared, plain = encoders
    importance = shared.importance
    if importance is None:
        return encoders
    bits = bits_of_palette(shared.tree, importance, price)
    instead = bits_of_psi(plain.tree, importance, price)
    if instead > SURE_OF_PSI * bits:
        return [shared]
    is_psi = bits > SURE_OF_PICKS * instead
    if is_sure and not is_psi and palette_pays(bits, instead):
        return [shared]
    plain = plain.weighed_as(shared)
    return [plain] if is_psi or is_sure else [shared, plain]


def palette_pays(bits: float, instead: float) -> bool:
    """Whether a palette of so many bits by an estimate is better than psi of so many, likely."""
    return bits < math.sqrt(SURE_OF_PICKS) * instead


def _at_price(encoders: Sequence[TargetEncoder], price: float) -> FoundStream:
    """Of the streams at a price of a bit that whose bits and errors cost least."""

    def make(encoder: TargetEncoder, near: float | None) -> Found[bytes]:
        return Found(price, math.nan, encoder.at_price(price))

    found = [FoundStream.of(encoder, make, price) for encoder in encoders]
    if len(found) == 1:
        return found[0]

    def cost(one: FoundStream) -> float:
        assert one.encoder is not None, "it is made by views"
        return 8 * len(one.data) * price + 10 ** (-one.encoder.psnr(one.data) / 10)

    return min([one.made() for one in found], key=cost)


def _made_plainly(
    whole: TargetEncoder, trees: Sequence[EvolutionTree], make: Callable[[TargetEncoder], bytes]
) -> list[FoundStream]:
    """Of trees, without a price of a bit; yet to be made."""

    def made(encoder: TargetEncoder, near: float | None) -> Found[bytes]:
        return Found(math.nan, math.nan, make(encoder))

    return [FoundStream.of(encoder, made) for encoder in _each(whole, trees)]


def _aimed(
    encoders: Sequence[TargetEncoder],
    make: Make,
    near: float | None,
    guess: Callable[..., Guess],
    sketched: Callable[[Sketch, float], float],
    worth: Callable[[TargetEncoder, bytes], float] | None = None,
) -> FoundStream:
    """`_best`; of two trees one alone where an estimate is sure, at the price of the first.

    Of trees of many splats one, yet to be made, near a price that is guessed: of two that of which
    `sketched` gives more, of a sketch at that price, and which can meet the target.
    """
    if near is not None and encoders[0].tree.n_leaves >= MIN_GUESSED and not encoders[0].polish:
        found = guess(encoders[0].sketch, near=near)
        guesses = [
            (encoder, found if encoder is encoders[0] else guess(encoder.sketch, near=found.price))
            for encoder in _that_pay(encoders, found.price)
        ]
        encoder, found = guesses[0]
        if len(guesses) > 1:
            encoder, found = max(guesses, key=lambda pair: _promise(pair[0], pair[1], sketched))
        return FoundStream.of(encoder.guessing(found), make, found.price)
    streams = [FoundStream.of(encoder, make, near) for encoder in encoders]
    if len(encoders) == 1 or near is None:
        return _best(streams, worth)
    try:
        first = streams[0].made()
    except TargetMissedError as error:
        try:
            return streams[1].made()
        except TargetMissedError as other:
            raise min(error, other, key=lambda one: one.by) from None
    assert first.price is not None, "views decide"
    others = [encoder for encoder in _that_pay(encoders, first.price) if encoder is not encoders[0]]
    return _best(
        [first, *(FoundStream.of(encoder, make, first.price) for encoder in others)], worth
    )


def _fewness(sketch: Sketch, price: float) -> float:
    """Greater of fewer bytes."""
    return -sketch.log_bytes(price)


def _promise(
    encoder: TargetEncoder, guess: Guess, sketched: Callable[[Sketch, float], float]
) -> tuple[bool, float]:
    """What a tree promises at a price that is guessed; of two the greater is better."""
    return not guess.is_at_end, sketched(encoder.sketch, guess.price)


def _expect_one(encoders: Sequence[TargetEncoder], expect: Callable[[TargetEncoder], None]) -> None:
    """Refuse a target that none of them meets, with what the nearest says."""
    missed: list[TargetMissedError] = []
    for encoder in encoders:
        try:
            expect(encoder)
        except TargetMissedError as error:
            missed.append(error)
        else:
            return
    raise min(missed, key=lambda error: error.by)


def _best(
    streams: Sequence[FoundStream],
    worth: Callable[[TargetEncoder, bytes], float] | None = None,
) -> FoundStream:
    """The smallest of the streams that meet a target, or that with the highest `worth`, made.

    Without views to tell its worth, the first that meets it.

    Raises:
        TargetMissedError: of the tree that comes nearest, if none meets it.
    """
    found: list[tuple[float, FoundStream]] = []
    missed: list[TargetMissedError] = []
    for stream in streams:
        try:
            one = stream.made()
        except TargetMissedError as error:
            missed.append(error)
            continue
        assert one.encoder is not None, "it has been made"
        if worth is None:
            found.append((-len(one.data), one))
        elif len(streams) == 1 or one.encoder.views is None:
            return one
        else:
            found.append((worth(one.encoder, one.data), one))
    if not found:
        raise min(missed, key=lambda error: error.by)
    return max(found, key=lambda pair: pair[0])[1]


def at_tree_psnr(tree: EvolutionTree, request: Request) -> FoundStream | None:
    """At `TREE_PSNR`; None, with a warning, if nothing can be rendered."""
    views = request.views(tree.shared_leaves())
    if views is None:
        warn_of_preset(request.why_no_views)
        return None
    encoder = TargetEncoder(
        tree,
        request.settings,
        views,
        ordering=views.fewer(request.effort.n_ordering_views),
        measuring=views.fewer(N_MEASURING_VIEWS),
        layers=request.n_layers(tree.n_levels),
        n_tiles=request.n_tiles,
        info=request.info,
        progress=request.progress,
    )

    def make(one: TargetEncoder, near: float | None) -> Found[bytes]:
        return one.nearest_psnr(TREE_PSNR, near, TREE_SLACK_DB)

    if tree.n_leaves < MIN_GUESSED:
        return replace(FoundStream.of(encoder, make).made(), psnr=TREE_PSNR)
    guess = Guess.of_psnr(encoder.sketch, TREE_PSNR, SCENE_PRICE / tree.n_leaves)
    return replace(FoundStream.of(encoder.guessing(guess), make, guess.price), psnr=TREE_PSNR)


def warn_of_preset(why: object) -> None:
    """Say why a tree is encoded with `TREE_PRESET`."""
    warnings.warn(f"{why}; encoded with the preset {TREE_PRESET} instead", stacklevel=4)
