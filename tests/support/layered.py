"""Streams with layers of precision, and what they are made of."""

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np

from evogs_codec import (
    PRESETS,
    decode,
    lift,
)
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.layers import Layered, Layering
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.encoding.write import write
from evogs_codec.model.channels import N_GROUPS, n_channels
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views

SETTINGS = replace(PRESETS["scene"], zstd_level=1)
PRICE = 1e-10
N_LEVELS = 3


def views_of(splats):
    return Views(splats, cameras_around(splats, "z", 48)[::6])


@cache
def scene(n=400):
    """A lifted tree of the demo scene and views of its leaves."""
    tree = lift(make_scene(n), N_LEVELS)
    return tree, views_of(tree.leaves())


def aim(tree=None, **more):
    if tree is None:
        return TargetEncoder(scene()[0], SETTINGS, scene()[1], **more)
    return TargetEncoder(tree, SETTINGS, views_of(tree.leaves()), **more)


def at_a_price(tree, layers, price=PRICE, **more):
    """A stream that nothing was searched for."""
    return write(Prepared(aim(tree, layers=layers, **more)).coded(price), zstd_level=1)


@cache
def stream(layers, decibels=40.0):
    return aim(layers=layers).at_psnr(decibels)


@cache
def many(layers=3):
    """A tree whose layers have several steps each, and its stream."""
    tree = lift(make_scene(2500), N_LEVELS)
    with patch("evogs_codec.encoding.layer_parts.MIN_LEAVES", 512):
        return tree, at_a_price(tree, layers)


def psnr(data, tree=None, **cut):
    tree, views = scene() if tree is None else (tree, views_of(tree.leaves()))
    leaves = decode(data, **cut).leaves(sh_degree=tree.shown_degree)
    return views.psnr(leaves)


def all_ones(splats):
    return np.ones((n_channels(splats.sh_degree), len(splats)), np.float32)


def layered(tree, n_layers, n_tiles=1):
    tiles = arrange(tree, n_tiles)
    importance = Importance.of(tiles, tree.n_levels, all_ones)
    with patch("evogs_codec.encoding.layer_parts.MIN_LEAVES", 512):
        found = Layered.of(tiles, tree.n_levels, importance, Layering(n_layers))
        assert len(found.of_tiles) == len(tiles)  # made here
        return tiles, found


def dropping(tree, slots):
    """The tree, which drops these slots in its last level."""
    d, slots = n_channels(tree.sh_degree), np.asarray(slots, np.int32)
    drops = Step(
        tree.n_levels - 1,
        slots,
        np.full(len(slots), Kind.DROP, np.uint8),
        np.empty((d, 0), np.float32),
        np.empty((N_GROUPS, 0), np.float32),
        np.empty((d, 0), np.float32),
    )
    return replace(tree, steps=(*tree.steps, drops))
