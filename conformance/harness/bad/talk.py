"""Decoders that say what no reader expects: bytes, depths, sizes."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace

from conformance.harness.bad.protocol import requests, write
from conformance.harness.bad.right import Question, Reply, Table

__all__ = ["DEPTH", "HOSTILE", "TALKS", "TALKS_IN_BATCH"]

DEPTH = 30_000
# For a terminal, for a coding, for a page, for XML, and for a table.
HOSTILE = "\ud800\x1b[2J\x00\u202e</script><script>alert(1)</script>]]>&" + "x" * 5000


def strange_name_and_codes(table: Table, question: Question) -> Reply:
    """Right but for the code, which is not even text."""
    reply = table.answer(question)
    return reply if reply.code is None else replace(reply, code=HOSTILE)


def strange_last_words(table: Table, question: Question) -> Reply:
    """Dies with bytes on standard error that are no text."""
    os.write(2, b"line\n\x1b]0;title\x07\x1b[2J\x00\xff\xfe</failure>]]>" + b"y" * 5000)
    os._exit(42)


def noise_of_bytes(table: Table, question: Question) -> Reply:
    os.write(1, b"\x1b[2J\x00\xff\xfe" + bytes(range(256)))
    return table.answer(question)


def deep_fault(table: Table, question: Question) -> Reply:
    """Right, and on standard output an array in an array in an array."""
    reply = table.answer(question)
    if reply.exit in (0, 3):
        return reply
    os.write(1, b'{"code": ' + b"[" * DEPTH)
    os._exit(reply.exit)


def deep_json(table: Table) -> None:
    for entry, question in requests():
        reply = write(question, table.answer(question))
        _say(f'{{"id": {entry["id"]}, "exit": {reply.exit}, "x": {"[" * DEPTH}{"]" * DEPTH}}}')


def huge_integers(table: Table) -> None:
    """Offsets of 4,000 digits."""
    for entry, question in requests():
        reply = write(question, table.answer(question))
        fault = f', "code": "{reply.code}", "offset": {"9" * 4000}' if reply.code else ""
        _say(f'{{"id": {entry["id"]}, "exit": {reply.exit}{fault}}}')


def huge_ids(table: Table) -> None:
    """Ids of 6,000 digits."""
    for _ in requests():
        _say(f'{{"id": {"9" * 6000}, "exit": 0}}')


def not_utf_8(table: Table) -> None:
    """Codes in some other coding."""
    for entry, question in requests():
        reply = write(question, table.answer(question))
        fault = {"code": "E_\xff", "offset": reply.offset} if reply.code else {}
        _say(json.dumps({"id": entry["id"], "exit": reply.exit} | fault, ensure_ascii=False))


def zero_bytes(table: Table) -> None:
    for entry, question in requests():
        reply = write(question, table.answer(question))
        _say(f'\0{{"id": {entry["id"]}, "exit": {reply.exit}}}\0')


def banner(table: Table) -> None:
    """Greets before it reads."""
    _say("EvoGS decoder \x1b[1m0.1\x1b[0m")
    for entry, question in requests():
        reply = write(question, table.answer(question))
        _say(json.dumps({"id": entry["id"], "exit": reply.exit}))


def flushes_at_the_end(table: Table) -> None:
    """What it says stays in its buffer until there is no more to read."""
    for entry, question in requests():
        reply = write(question, table.answer(question))
        fault = {} if reply.code is None else {"code": reply.code, "offset": reply.offset}
        sys.stdout.write(json.dumps({"id": entry["id"], "exit": reply.exit} | fault) + "\n")


TALKS = {
    function.__name__.replace("_", "-"): function
    for function in (strange_name_and_codes, strange_last_words, noise_of_bytes, deep_fault)
}
TALKS_IN_BATCH = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(deep_json, huge_integers, huge_ids, not_utf_8, zero_bytes),
        *(banner, flushes_at_the_end),
    )
}


def _say(line: str) -> None:
    sys.stdout.buffer.write(line.encode("latin-1") + b"\n")
    sys.stdout.flush()
