"""Decoders that break the batch protocol, or do not forget between two runs."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from conformance.harness.bad.right import Question, Reply, Table

__all__ = ["PROTOCOLS", "question_of", "requests", "serve", "write"]

Answerer = Callable[[Table, Question], Reply]
Entry = dict[str, Any]


def serve(answerer: Answerer, table: Table) -> None:
    """The protocol as it should be."""
    for entry, question in requests():
        _say(_entry(entry, write(question, answerer(table, question))))


def wrong_ids(table: Table) -> None:
    for entry, question in requests():
        _say(_entry(entry, write(question, table.answer(question))) | {"id": entry["id"] + 1})


def out_of_order(table: Table) -> None:
    """Waits for the next request before it answers."""
    late: list[Entry] = []
    for entry, question in requests():
        late.append(_entry(entry, write(question, table.answer(question))))
        if len(late) == 2:
            _say(late.pop())
            _say(late.pop())


def dies_half_way(table: Table) -> None:
    for number, (entry, question) in enumerate(requests()):
        if number == 3:
            os._exit(0)
        _say(_entry(entry, write(question, table.answer(question))))


def answers_twice(table: Table) -> None:
    for entry, question in requests():
        text = json.dumps(_entry(entry, write(question, table.answer(question))))
        sys.stdout.write(f"{text}\n{text}\n")
        sys.stdout.flush()


def not_json(table: Table) -> None:
    for _, question in requests():
        print(f"exit {write(question, table.answer(question)).exit}", flush=True)


def no_line_end(table: Table) -> None:
    """The answer is there, but its line does not end."""
    for entry, question in requests():
        sys.stdout.write(json.dumps(_entry(entry, write(question, table.answer(question)))))
        sys.stdout.flush()


def stale_output(table: Table) -> None:
    """Writes the dump of the run before."""
    before: bytes | None = None
    for entry, question in requests():
        reply = table.answer(question)
        if reply.dump is not None:
            before, dump = reply.dump, before
            reply = Reply(reply.exit, dump=dump or b"")
        _say(_entry(entry, write(question, reply)))


def stale_verdict(table: Table) -> None:
    """After a fault, rejects everything."""
    is_broken = False
    for entry, question in requests():
        reply = Reply(1, "E_CRC", 0) if is_broken else table.answer(question)
        is_broken |= reply.exit == 1
        _say(_entry(entry, write(question, reply)))


PROTOCOLS = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(wrong_ids, out_of_order, dies_half_way, answers_twice, not_json, no_line_end),
        *(stale_output, stale_verdict),
    )
}


def question_of(entry: Entry) -> Question:
    """A request, its limits and arrival read."""
    limits, arrival = (
        None if entry.get(key) is None else json.loads(Path(entry[key]).read_bytes())
        for key in ("limits", "arrival")
    )
    return Question(
        Path(entry["in"]),
        Path(entry["out"]),
        entry["mode"],
        entry.get("level"),
        limits,
        entry.get("verify", False),
        arrival,
        entry.get("dump_on_fault", False),
    )


def write(question: Question, reply: Reply) -> Reply:
    """Put the dump, if there is one, where it belongs; returns the reply."""
    if reply.dump is not None:
        question.target.write_bytes(reply.dump)
    return reply


def requests() -> Iterator[tuple[Entry, Question]]:
    """Those on standard input."""
    for line in sys.stdin:
        entry = json.loads(line)
        yield entry, question_of(entry)


def _entry(entry: Entry, reply: Reply) -> Entry:
    fault = {} if reply.code is None else {"code": reply.code, "offset": reply.offset}
    return {"id": entry["id"], "exit": reply.exit} | fault


def _say(entry: Entry) -> None:
    print(json.dumps(entry), flush=True)
