"""Fault codes of spec 9. Made by `tools/spec_tables.py` from `spec/faults.csv`."""

from __future__ import annotations

from enum import Enum


class Fault(Enum):
    """A fault code; the value is (section of the spec, meaning)."""

    E_TRUNCATED = ("6.2", "the data ends before the structure it announces")
    E_SIGNATURE = ("5.1", "the first eight bytes are not the signature")
    E_VERSION = ("5.1", "the major version is not 1")
    E_CRC = ("6.3", "a stored CRC-32 differs from that of the stored bytes")
    E_RESERVED = ("4.4", "a reserved bit or byte is not zero")
    E_HEADER = ("5.1", "a field of the header is outside its domain")
    E_TIER = ("8.2", "a count exceeds the limit of the tier that the header states")
    E_CHUNK = (
        "5.2",
        "a chunk is malformed or missing or repeated or out of order or of the wrong size",
    )
    E_UNSUPPORTED = ("8.1", "a critical chunk is not known to this decoder")
    E_STEP = ("5.3", "a quantiser step is outside its domain")
    E_ALPHA = ("5.4", "an alpha table is outside its domain or out of order")
    E_TILE = ("5.5", "a tile origin or box is outside its domain")
    E_CHAIN = (
        "5.6",
        "a packet entry names a tile or component or level that its place does not allow",
    )
    E_COUNT = ("5.6", "the record counts of a packet entry contradict its size or the live splats")
    E_AMPLIFICATION = (
        "5.6",
        "a packet has more records or entries than its size allows or digests name too much state",
    )
    E_META = ("5.8", "metadata is malformed")
    E_TRAILING = ("6.2", "bytes follow the last packet")
    E_PACKET = ("5.9", "a packet header is malformed")
    E_FRAME = (
        "5.10",
        "a frame is outside the Zstandard subset or its size differs from the planes it holds",
    )
    E_ZSTD = ("5.10", "the content of a frame breaks RFC 8878 or does not regenerate its size")
    E_SLOT = ("7.2", "a record names a slot that is not live before the step")
    E_KIND = ("7.2", "the kinds contradict the counts of the packet entry")
    E_INDEX = ("7.2", "an alpha index or a pick is past the end of its table")
    E_RANGE = ("7.3", "a number leaves its range")
    E_DIGEST = ("7.7", "a digest differs from that of the decoded integers")
    E_LIMIT = ("8.3", "the stream is within its tier but over the limits given to this decoder")

    @property
    def section(self) -> str:
        """Section of `spec/evogs.md` with the rule."""
        return self.value[0]
