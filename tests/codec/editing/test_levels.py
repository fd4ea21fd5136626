"""Figures per level: what a level adds."""

from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream, X, build
from evogs_codec.editing.byte_stats import levels
from evogs_codec.format.directory import read_directory


def added(*packets, n_levels):
    directory = read_directory(build(Stream(list(packets), n_levels=n_levels)))
    return [level.adds for level in levels(directory)]


def test_a_level_adds_detail_if_its_splats_are_others_and_precision_if_they_are_refined():
    roots = Packet(n_adds=2, adds={X: [0, 1]})
    refined = Packet(level=1, records={0: REFINE}, psi={X: [1]})
    split = Packet(level=1, records={0: SPLIT, 1: REFINE}, psi={X: [1, 1]})
    dropped = Packet(level=1, records={0: DROP})
    assert added(roots, refined, n_levels=3) == ["detail", "precision", "nothing"]
    assert added(roots, split, n_levels=2) == ["detail", "detail"]
    assert added(roots, dropped, n_levels=2) == ["detail", "detail"]
