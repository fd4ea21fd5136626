"""Damage to Huffman-coded literals, which libzstd does not see whole (R-5.10-12 to R-5.10-15).

Random streams are too small for it to take its fast way, so these are streams of a few hundred to
a few thousand splats whose lists are compressed, with bits of a block changed behind right
checksums.
"""

from __future__ import annotations

from random import Random

from conformance.generator.builder import Packet, Stream, build, compressed

__all__ = ["damaged_literals"]

HEADER_SIZE = 7  # of a frame of 256 bytes up to 64 KiB, as these are: its blocks begin there
BLOCK_HEADER_SIZE = 3
TREE = 60  # bytes at the front of a block in which most trees end
WIDTHS = (1, 3, 10, 40)


def damaged_literals(rng: Random) -> bytes:
    """A stream of one list, mostly with one to three bits of its literals changed."""
    n, width = rng.choice((300, 700, 3000)), rng.choice(WIDTHS)
    values = [min(255, int(abs(rng.gauss(0, width)))) for _ in range(n)]
    if rng.random() < 0.5:  # matches, and blocks with sequences
        begin = rng.randrange(n // 2)
        values[n // 2 : n // 2 + 40] = values[begin : begin + 40]
    pack = compressed(rng.choice((1, 3, 19)))

    def style(content: bytes) -> bytes:
        frame = bytearray(pack(content))
        for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
            first = HEADER_SIZE + BLOCK_HEADER_SIZE
            last = min(len(frame), rng.choice((first + 6, first + TREE, len(frame))))
            if first < last:
                frame[rng.randrange(first, last)] ^= 1 << rng.randrange(8)
        return bytes(frame)

    lists = {"adds 0": values}
    return build(Stream([Packet(n_adds=n, stored=lists, codings={"adds 0": 8}, style=style)]))
