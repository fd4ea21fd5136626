"""Streams as an encoder writes them: lifted scenes, trained trees and a drawn one.

The streams were made once, with the encoder of this repository at version 0.1.0, and are kept as
bytes: a better encoder must not change them. The scenes are those of
`evogs_codec.render.demo_scene` (procedural, so they have no other author). The trees were trained
on photographs of them (`tools.trained_streams`). The tree that is called grown was drawn: roots,
then four levels of splits, refines, drops and adds whose psi shrink from level to level and have
heavy tails.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from conformance.decoders.outcomes import Run
from conformance.generator.builder import places
from conformance.generator.cases.case import FILE, PROGRESSIVE, VERIFY, Case, Recipe, case

FAMILY = "real"
STREAMS = Path(__file__).parent / "streams"


def streams() -> Iterator[Case]:
    """Whole, by level, in part."""
    rows = [
        ("lifted-600-degree-1", "a lifted scene of 600 splats, SH degree 1, four levels"),
        ("lifted-150-degree-3-tiles", "a lifted scene of 150 splats, SH degree 3, three tiles"),
        ("lifted-250-near-lossless", "a lifted scene of 250 splats, SH degree 0, near-lossless"),
        ("grown-trained", "a grown tree in two tiles, quantised in a closed loop"),
        ("grown-paper", "a grown tree with 8 bits by range, and an alpha of its own per split"),
        ("trained-evogs", "a trained tree, SH degree 1, three levels"),
        ("trained-evogs-degree-3", "a trained tree, SH degree 3, with 8 bits by range"),
        ("trained-evogs-sym", "a trained symmetric tree: no alpha tables"),
        ("trained-evogs-a", "a trained tree of independent children"),
        ("trained-evogs-b", "a trained tree of independent residuals"),
        ("trained-lapis", "trained layers of LapisGS: adds, and refines of opacity"),
        ("trained-l3gs", "trained layers of L3GS: adds only"),
    ]
    for name, tests in rows:
        data = (STREAMS / f"{name}.evogs").read_bytes()
        packets = places(data).packets
        half = packets[len(packets) // 2][1] - 1
        missing = packets[len(packets) // 3]
        holes = ((0, missing[0]), (missing[1], len(data) - missing[1]))
        yield case(
            name,
            data,
            "R-4.1-2 R-5.7-4 R-5.10-6 R-6.4-1 R-7.5-1",
            tests,
            "decodes small files only",
            runs=(
                FILE,
                VERIFY,
                *(Run(level=level) for level in range(data[12] - 1)),
                PROGRESSIVE,
                Run("progressive", arrival=((0, half),)),
                Run("progressive", arrival=holes),
            ),
        )


RECIPES: tuple[Recipe, ...] = (streams,)
