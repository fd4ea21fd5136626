"""A writer of streams for vectors: everything can be said, also what is wrong.

A stream is described by plain values; sizes, counts, checksums and digests are worked out unless
they are overridden. It knows the bytes of spec 5, not what is legal, and it shares no code with the
codec. Frames are made of raw and run-length blocks by hand, so that bytes do not depend on a
library; `compressed` is the exception.

    build(Stream([Packet(adds={X: [5, -3]}), Packet(records={0: SPLIT}, psi={X: 2})]))
"""

from conformance.generator.builder.files import build
from conformance.generator.builder.frames import (
    COMPRESSED,
    RAW,
    RESERVED,
    RLE,
    FrameStyle,
    compressed,
    frame,
    raw,
    runs,
)
from conformance.generator.builder.packets import (
    ADDS_YCOCG,
    DELTA,
    OF_CHANGED,
    PSI_YCOCG,
    coding_for,
    packet_body,
    planes_of,
)
from conformance.generator.builder.places import (
    CHUNK_HEADER_SIZE,
    HEADER_SIZE,
    ROW_CRC_AT,
    ROW_SIZE,
    ROW_SIZE_AT,
    patched,
    places,
    repaired,
)
from conformance.generator.builder.stream import (
    BLUE,
    DROP,
    GREEN,
    MAX_X,
    OPACITY,
    PALETTE,
    PICKS,
    RED,
    REFINE,
    SPLIT,
    Chunk,
    Packet,
    Stream,
    Tile,
    Values,
    X,
    Y,
    Z,
)

__all__ = [
    "ADDS_YCOCG",
    "BLUE",
    "CHUNK_HEADER_SIZE",
    "COMPRESSED",
    "DELTA",
    "DROP",
    "GREEN",
    "HEADER_SIZE",
    "MAX_X",
    "OF_CHANGED",
    "OPACITY",
    "PALETTE",
    "PICKS",
    "PSI_YCOCG",
    "RAW",
    "RED",
    "REFINE",
    "RESERVED",
    "RLE",
    "ROW_CRC_AT",
    "ROW_SIZE",
    "ROW_SIZE_AT",
    "SPLIT",
    "Chunk",
    "FrameStyle",
    "Packet",
    "Stream",
    "Tile",
    "Values",
    "X",
    "Y",
    "Z",
    "build",
    "coding_for",
    "compressed",
    "frame",
    "packet_body",
    "patched",
    "places",
    "planes_of",
    "raw",
    "repaired",
    "runs",
]
