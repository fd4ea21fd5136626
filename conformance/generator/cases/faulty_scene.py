"""A legal stream one of whose packets gets a fault, and the cases of it (R-6.4-5)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from conformance.decoders.outcomes import Run
from conformance.generator.builder import (
    Stream,
    build,
    patched,
    places,
)
from conformance.generator.cases.case import Case, case

__all__ = ["ALL", "CRC", "FAMILY", "RULES", "Fault", "Scene", "came"]

FAMILY = "fault-states"
ALL = Run("progressive", dump_on_fault=True)
RULES = "R-6.4-5 R-6.4-1 6.4"


class Fault(NamedTuple):
    """What is wrong, and the fields of packet and stream that make it so."""

    name: str
    rules: str
    code: str
    what: str
    packet: Mapping[str, Any] = {}
    stream: Mapping[str, Any] = {}


CRC = Fault("crc", "R-6.3-1", "E_CRC", "the last byte is another one")


@dataclass(frozen=True)
class Scene:
    """A legal stream.

    Attributes:
        name: of its cases.
        what: the kind of the packet that gets a fault.
        at: the number of that packet.
        free: the number of a packet before it that it does not require.
    """

    name: str
    what: str
    at: int
    free: int
    stream: Stream

    def with_fault(self, fault: Fault) -> bytes:
        """The bytes with a fault."""
        packets = list(self.stream.packets)
        packets[self.at] = replace(packets[self.at], **fault.packet)
        data = build(replace(self.stream, packets=packets, **fault.stream))
        if fault is not CRC:
            return data
        end = places(data).packets[self.at][1]
        return patched(data, end - 1, bytes([data[end - 1] ^ 1]))

    def refused(self, faults: Sequence[Fault]) -> Iterator[Case]:
        """The cases of faults: all came, forwards and backwards; the free packet did not."""
        everything = range(len(self.stream.packets))
        left = [k for k in everything if k != self.free]
        for fault in faults:
            data = self.with_fault(fault)
            orders = (everything[::-1], left, left[::-1])
            yield case(
                f"{self.name}-{fault.name}",
                data,
                f"{RULES} {fault.rules}",
                f"{fault.what}, in {self.what}: the state is that without the packet",
                "keeps what it wrote of the packet before it found the fault, or ends with it",
                fault.code,
                f"{FAMILY}-{self.name}-without-a-fault",
                runs=(ALL, *(came(data, order) for order in orders)),
            )

    def twin(self) -> Iterator[Case]:
        """The case without a fault: it ends as if no dump beside a fault had been asked for."""
        data, everything = build(self.stream), range(len(self.stream.packets))
        yield case(
            f"{self.name}-without-a-fault",
            data,
            f"{RULES} R-4.1-2",
            f"no fault in {self.what}: the whole file, backwards, without its last packet",
            "gives no dump where there is no fault, or takes what is missing for a fault",
            runs=(ALL, came(data, everything[::-1]), came(data, everything[:-1])),
        )


def came(data: bytes, order: Sequence[int]) -> Run:
    """Header and chunks came, then these packets in this order."""
    spans = places(data).packets
    pieces = [(spans[k][0], spans[k][1] - spans[k][0]) for k in order]
    return replace(ALL, arrival=((0, spans[0][0]), *(piece for piece in pieces if piece[1])))
