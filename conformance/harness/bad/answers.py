"""Decoders that end as the contract says, with a wrong answer."""

from __future__ import annotations

import os
import random
import struct
from collections.abc import Callable
from dataclasses import replace

from conformance.harness.bad.right import Question, Reply, Table

__all__ = ["ANSWERS"]

HEADER_SIZE, TILE_SIZE = 16, 28
NO_TILES = b"EVGD\x01\x00" + bytes(10)


def right(table: Table, question: Question) -> Reply:
    return table.answer(question)


def modest(table: Table, question: Question) -> Reply:
    """Has only what must be there, and says so."""
    extras = (question.verify, question.limits, question.arrival is not None)
    if question.mode == "progressive" or any(extras):
        return Reply(127)
    return table.answer(question)


def accept_all(table: Table, question: Question) -> Reply:
    return Reply(0)


def accept_all_with_a_dump(table: Table, question: Question) -> Reply:
    return Reply(0, dump=NO_TILES)


def reject_all(table: Table, question: Question) -> Reply:
    return Reply(1, "E_CRC", 0)


def unsupported_all(table: Table, question: Question) -> Reply:
    return Reply(127)


def by_heart(table: Table, question: Question) -> Reply:
    """Knows the vectors, and nothing else."""
    told = table.look_up(question.source.read_bytes(), question)
    return Reply(1, "E_SIGNATURE", 0) if told is None else table.reply(told)


def by_file_name(table: Table, question: Question) -> Reply:
    """Looks for the answer beside the name of the input."""
    files = {path.name for path in table.folder.rglob("*.evogs")}
    return table.answer(question) if question.source.name in files else Reply(1, "E_CRC", 0)


def by_surroundings(table: Table, question: Question) -> Reply:
    """Has a decimal comma where the locale has one."""
    reply = table.answer(question)
    return reply if os.environ.get("LC_ALL") == "C.UTF-8" else _with_dump(reply, _last_off_by_one)


def by_chance(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return _with_dump(reply, _last_off_by_one) if random.random() < 0.5 else reply


def reversed_slots(table: Table, question: Question) -> Reply:
    """The right integers in wrong order."""
    return _with_dump(table.answer(question), lambda dump: _rearranged(dump, _reversed))


def slot_by_slot(table: Table, question: Question) -> Reply:
    """Splat after splat instead of channel after channel."""
    return _with_dump(table.answer(question), lambda dump: _rearranged(dump, _transposed))


def big_endian(table: Table, question: Question) -> Reply:
    return _with_dump(table.answer(question), lambda dump: _rearranged(dump, _swapped))


def last_off_by_one(table: Table, question: Question) -> Reply:
    return _with_dump(table.answer(question), _last_off_by_one)


def truncated_dump(table: Table, question: Question) -> Reply:
    return _with_dump(table.answer(question), lambda dump: dump[:-1])


def trailing_bytes(table: Table, question: Question) -> Reply:
    return _with_dump(table.answer(question), lambda dump: dump + b"\0")


def empty_dump(table: Table, question: Question) -> Reply:
    return _with_dump(table.answer(question), lambda dump: b"")


def output_on_rejection(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return replace(reply, dump=reply.dump or NO_TILES)


def partial_then_fail(table: Table, question: Question) -> Reply:
    """Writes half of the dump and gives up."""
    dump = table.answer(question).dump or NO_TILES
    return Reply(1, "E_CRC", 0, dump[: len(dump) // 2])


def wrong_codes(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return replace(reply, code=reply.code and "E_META")


def wrong_offsets(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return reply if reply.offset is None else replace(reply, offset=reply.offset + 1)


def ignores_level(table: Table, question: Question) -> Reply:
    return table.answer(replace(question, level=None))


def ignores_limits(table: Table, question: Question) -> Reply:
    return table.answer(replace(question, limits=None))


def ignores_checksums(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return Reply(0, dump=NO_TILES) if reply.code == "E_CRC" else reply


def ignores_digests(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return Reply(0, dump=NO_TILES) if reply.code == "E_DIGEST" else reply


def waits_for_nothing(table: Table, question: Question) -> Reply:
    """Takes missing bytes for a fault, in progressive mode too."""
    reply = table.answer(question)
    return Reply(1, "E_TRUNCATED", 0) if reply.exit == 3 else reply


def skips_the_unknown(table: Table, question: Question) -> Reply:
    """Does not mind a critical chunk that it does not know."""
    reply = table.answer(question)
    return Reply(0, dump=NO_TILES) if reply.exit == 127 else reply


def changed_by_a_fault(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return _with_dump(reply, _last_off_by_one) if reply.exit == 1 else reply


def nothing_beside_a_fault(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    return replace(reply, dump=None) if reply.exit == 1 else reply


def of_before_dump_on_fault(table: Table, question: Question) -> Reply:
    """Was written before the option came, and dies of it."""
    if question.dump_on_fault:
        os.abort()
    return table.answer(question)


ANSWERS = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(right, modest, accept_all, accept_all_with_a_dump, reject_all, unsupported_all),
        *(by_heart, by_file_name, by_surroundings, by_chance, reversed_slots, slot_by_slot),
        *(big_endian, last_off_by_one, truncated_dump, trailing_bytes, empty_dump),
        *(output_on_rejection, partial_then_fail, wrong_codes, wrong_offsets, ignores_level),
        *(ignores_limits, ignores_checksums, ignores_digests, waits_for_nothing),
        *(skips_the_unknown, changed_by_a_fault, nothing_beside_a_fault, of_before_dump_on_fault),
    )
}


def _with_dump(reply: Reply, change: Callable[[bytes], bytes]) -> Reply:
    return reply if reply.dump is None else replace(reply, dump=change(reply.dump))


def _last_off_by_one(dump: bytes) -> bytes:
    """Of dumps with a slot, whose last four bytes are an integer."""
    if len(dump) < HEADER_SIZE + TILE_SIZE + 4:
        return dump + b"\0"
    (last,) = struct.unpack("<i", dump[-4:])
    return dump[:-4] + struct.pack("<i", last + 1)


def _rearranged(dump: bytes, change: Callable[[list[int], int], list[int]]) -> bytes:
    """The integers of each tile changed; `change` gets them and the number of slots."""
    out, at = bytearray(dump[:HEADER_SIZE]), HEADER_SIZE
    n_channels = 11 + 3 * (dump[5] + 1) ** 2
    while at < len(dump):
        (n_slots,) = struct.unpack_from("<I", dump, at + 24)
        begin = at + TILE_SIZE + n_slots
        out += dump[at:begin]
        form = f"<{n_channels * n_slots}i"
        values = list(struct.unpack_from(form, dump, begin))
        out += struct.pack(form, *(change(values, n_slots) if n_slots else values))
        at = begin + struct.calcsize(form)
    return bytes(out)


def _reversed(values: list[int], n_slots: int) -> list[int]:
    rows = [values[at : at + n_slots] for at in range(0, len(values), n_slots)]
    return [value for row in rows for value in reversed(row)]


def _transposed(values: list[int], n_slots: int) -> list[int]:
    return [value for slot in range(n_slots) for value in values[slot::n_slots]]


def _swapped(values: list[int], n_slots: int) -> list[int]:
    raw = struct.pack(f">{len(values)}i", *values)
    return list(struct.unpack(f"<{len(values)}i", raw))
