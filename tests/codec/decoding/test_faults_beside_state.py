"""A packet with a fault has no effect: the state is that of the packets before it (spec 6.4)."""

from contextlib import suppress

import pytest

from conformance.generator.builder import (
    DELTA,
    DROP,
    OPACITY,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    X,
    Y,
    Z,
    build,
)
from conformance.generator.builder.places import places
from evogs_codec import Decoder, StreamError, decode

CORE = [
    Packet(adds={X: [1, 2, 3, 4], Z: [5, 6, 7, 8], OPACITY: [1, 2, 3, 4]}),
    Packet(records={0: SPLIT, 1: REFINE, 3: DROP}, psi={X: [1, 2], Z: [1, 1]}, adds={Y: [9]}),
]
LARGE = (1 << 16) - 1  # a mantissa that makes a q of 2^13 leave the range of Delta


def stream(last, *, tiles=2, **options):
    """Tile 0 has the packets of `CORE` and `last`; tile 1 one packet, the first of the file."""
    first = Packet(tile=tiles - 1, adds={X: [0]})
    box = [Tile(low=(-50,) * 3, high=(50,) * 3)] * tiles
    return build(Stream([first, *CORE, *last], n_levels=1, tiles=box, **options))


def outside_box():
    """A refine of tile 0 whose third axis leaves the box: x, y and a drop come before it."""
    records = {0: REFINE, 1: DROP, 2: SPLIT}
    return stream([Packet(records=records, psi={X: [3, 3], Z: [1, 90]})])


def band_over_range():
    """The last channel of band 1 leaves the range of Delta."""
    bands = [
        Packet(component=1, adds={0: [1, 2, 3, 4]}),
        Packet(component=1, psi={0: [5, 6], 8: [1 << 14, 1]}, adds={0: [1]}),
    ]
    return stream(bands, degree=1, quantisers={(1, 5): (LARGE, 0)})


def sums_over_range():
    """A running sum of the last channel of adds leaves its bounds."""
    far = [k * ((1 << 23) - 1) for k in range(1, 41)]
    new = Packet(
        records={0: REFINE}, psi={X: [1]}, adds={13: far, X: [1] * 40},
        codings={"adds 13": DELTA | 0x28},
    )  # fmt: skip
    return stream([new])


def pick_past_the_palette():
    """A pick of a step with a drop names an entry that is not there."""
    last = [
        Packet(component=5, adds={0: [1, 2]}),
        Packet(component=4, picks=(1, 2, 0, 1)),
        Packet(component=4, picks=(0, 1), repicks=(2, 3)),
    ]
    return stream(last, degree=1, has_palette=True)


def entry_over_range():
    """The last channel of the second packet of entries leaves the range of Delta."""
    last = [
        Packet(component=5, adds={0: [1, 2]}),
        Packet(component=5, adds={0: [3, 4], 8: [1, 1 << 14]}),
        Packet(component=4, picks=(1, 2, 0, 1)),
    ]
    return stream(last, degree=1, has_palette=True, quantisers={(0, 5): (LARGE, 0)})


STREAMS = [outside_box, band_over_range, sums_over_range, pick_past_the_palette, entry_over_range]


def fed(data, packets):
    """The decoder after header, chunks and these packets, in this order."""
    where, decoder = places(data).packets, Decoder()
    decoder.feed(data[: where[0][0]], 0)
    for packet in packets:
        begin, end = where[packet]
        with suppress(StreamError):  # asked for by `fault`
            decoder.feed(data[begin:end], begin)
    return decoder


@pytest.mark.parametrize("make", STREAMS)
@pytest.mark.parametrize("first_is_missing", [False, True])
def test_a_packet_with_a_fault_leaves_the_state_as_it_was(make, first_is_missing):
    data = make()
    begins = [begin for begin, _ in places(data).packets]
    with pytest.raises(StreamError) as caught:
        decode(data)
    faulty = begins.index(caught.value.offset)
    arrival = range(int(first_is_missing), len(begins))
    came, right = fed(data, arrival), fed(data, [k for k in arrival if k != faulty])
    assert right.verdict is None
    assert came.verdict is not None
    assert came.verdict.offset == begins[faulty]
    assert came.dump() == right.dump()
    assert came.leaves().channels().tobytes() == right.leaves().channels().tobytes()
