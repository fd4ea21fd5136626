"""Families of vectors that a harness makes itself from a committed one: prefixes and bit flips.

Entries of `families` in the manifest, by their `rule`:

- `every-prefix`: in file mode every proper prefix of the vector is refused with E_TRUNCATED; in
  progressive mode it is incomplete (exit 3), with the dump `dumps[n]` of the n packets that are
  whole in it, and no dump before header and chunks are.
- `every-bit-flip`: the vector with any one bit changed is refused, but for the bits `exceptions`,
  with which it decodes as without.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping

from conformance.decoders.outcomes import Run
from conformance.generator.builder import places
from conformance.generator.suite import DisagreementError, Entry, agreed

__all__ = ["PREFIXES", "generated"]

PREFIXES = ("core-bands-degree-1", "core-two-tiles", "core-digests-of-every-packet")
FLIPS = ("core-kinds-of-one-step", "core-bands-degree-1")


def generated(data: Mapping[str, bytes]) -> tuple[list[Entry], list[bytes]]:
    """Entries of the manifest, and the dumps they name.

    Args:
        data: the vectors by id.

    Raises:
        DisagreementError: of oracle and codec, or a rule does not hold.
    """
    entries, dumps = list[Entry](), list[bytes]()
    for name in PREFIXES:
        states = prefix_dumps(data[name])
        dumps += states
        entries.append(
            {
                "name": f"every-prefix-of-{name}",
                "rule": "every-prefix",
                "of": name,
                "tests": "the file cut off after each of its bytes",
                "faulty": "reads past the end, or shows a packet that is not whole",
                "requirements": ["R-6.2-2", "R-6.4-1", "R-6.4-3"],
                "dumps": [hashlib.sha256(dump).hexdigest() for dump in states],
            }
        )
    for name in FLIPS:
        exceptions = accepted_flips(data[name])
        entries.append(
            {
                "name": f"every-bit-flip-of-{name}",
                "rule": "every-bit-flip",
                "of": name,
                "tests": "the file with each of its bits changed",
                "faulty": "does not check every checksum",
                "requirements": ["R-6.3-1", "R-6.3-2"],
                "exceptions": exceptions,
            }
        )
    return entries, dumps


def prefix_dumps(data: bytes) -> list[bytes]:
    """The dump with 0, 1, ... packets; every prefix is tried."""
    head, packets = 64 + int.from_bytes(data[32:36], "little"), places(data).packets
    dumps = dict[int, bytes]()
    for size in range(len(data) + 1):
        n_packets = sum(end <= size for _, end in packets)
        outcome = agreed(data[:size], Run("progressive"))
        is_whole = size == len(data)
        if outcome.exit != (0 if is_whole else 3) or (outcome.dump is None) != (size < head):
            raise DisagreementError(f"prefix of {size}: {outcome.exit} {outcome.code}")
        if outcome.dump is not None and dumps.setdefault(n_packets, outcome.dump) != outcome.dump:
            raise DisagreementError(f"prefix of {size}: another dump of {n_packets} packets")
        if not is_whole and agreed(data[:size], Run()).code != "E_TRUNCATED":
            raise DisagreementError(f"prefix of {size} is not truncated")
    return [dumps[n] for n in range(len(packets) + 1)]


def accepted_flips(data: bytes) -> list[int]:
    """Bits that may change; every other is refused."""
    whole = agreed(data, Run())
    found = []
    for bit, flipped in flips(data):
        outcome = agreed(flipped, Run())
        if outcome == whole:
            found.append(bit)
        elif outcome.exit != 1:
            raise DisagreementError(f"bit {bit}: {outcome.exit} {outcome.code}")
    return found


def flips(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The bytes with each bit changed."""
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit >> 3] ^= 1 << (bit & 7)
        yield bit, bytes(flipped)
