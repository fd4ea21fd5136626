"""The reference decoder behind the command of conformance/README.md.

`python -m conformance.decoders.reference --in FILE --out OUT --mode file|progressive ...`
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from conformance.decoders.contract import CAPABILITIES, add_options, run_of_request
from conformance.decoders.outcomes import ACCEPTED, INCOMPLETE, Outcome, Run, refused
from evogs_codec import Cut, Decoder, Directory, Fault, StreamError, decode, read_directory
from evogs_codec.common.printable import shown
from evogs_codec.io.files import same_file

__all__ = ["by_codec", "main", "run_command"]

USAGE = 2
NAME = {"name": "evogs_codec"}


class _LevelError(Exception):
    """The caller asks for a level that the stream does not have (spec 3.6)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(description="The reference decoder, under test.")
    add_options(parser)
    return run_command(parser.parse_args(arguments))


def run_command(args: argparse.Namespace) -> int:
    """What the options ask for; returns the exit code."""
    if args.capabilities:
        print(json.dumps(NAME | CAPABILITIES))
        return 0
    if args.batch:
        serve()
        return 0
    if args.source is None or args.target is None:
        print("evogs conformance decoder: --in and --out are required", file=sys.stderr)
        return USAGE
    outcome = answer(args.source, args.target, run_of_request(vars(args)))
    if outcome.code is not None:
        print(json.dumps(outcome.fault()))
    return outcome.exit


def serve() -> None:
    """The batch protocol on standard input and output."""
    for line in sys.stdin:
        entry = json.loads(line)
        outcome = answer(Path(entry["in"]), Path(entry["out"]), run_of_request(entry))
        print(json.dumps({"id": entry["id"], "exit": outcome.exit} | outcome.fault()), flush=True)


def answer(source: Path, target: Path, run: Run) -> Outcome:
    """Decode a file, and write the dump if there is one."""
    if same_file(source, target):
        print(f"{shown(target)}: is the stream; name another file", file=sys.stderr)
        return Outcome(USAGE)
    try:
        outcome = by_codec(source.read_bytes(), run)
    except _LevelError as error:
        print(error, file=sys.stderr)
        return Outcome(USAGE)
    if outcome.dump is not None:
        target.write_bytes(outcome.dump)
    return outcome


def by_codec(data: bytes, run: Run) -> Outcome:
    """What the contract wants for these bytes."""
    try:
        if run.mode == "progressive":
            is_fed = run.level is None and not run.verify
            return feed(data, run) if is_fed else complete_packets(data, run)
        cut = partial(_cut, run.level)
        dump = decode(data, cut, verify=run.verify, limits=run.limits).dump()
    except StreamError as error:
        return refused(run, error.fault.name, error.offset)
    return Outcome(ACCEPTED, dump=dump)


def feed(data: bytes, run: Run) -> Outcome:
    """The outcome of a progressive decoder that is fed piece by piece; then no more comes.

    Raises:
        StreamError: a fault of header or chunks, or they are not complete.
    """
    decoder = Decoder(limits=run.limits)
    for at, size in _arrival(data, run):
        try:
            decoder.feed(data[at : at + size], at)
        except StreamError:
            if decoder.directory is None:
                raise
    if decoder.directory is None:
        decoder.close()
    return _outcome(run, decoder.verdict, decoder.is_complete, decoder.dump)


def complete_packets(data: bytes, run: Run) -> Outcome:
    """The same, seen from the end: the packets whose bytes came, of the cut asked for.

    Raises:
        StreamError: a fault of header or chunks, or they are not complete.
    """
    there = np.zeros(len(data), bool)
    for at, size in _arrival(data, run):
        there[at : at + size] = True
    directory = read_directory(memoryview(data)[: _prefix_size(there)], run.limits)
    n_there = np.concatenate([[0], np.cumsum(there)])
    sizes = directory.packets["size"]
    ends = np.minimum(directory.offsets + sizes, len(data))
    starts = np.minimum(directory.offsets, len(data))
    complete = n_there[ends] - n_there[starts] == sizes
    wanted, fault = _cut(run.level, directory), None
    stream = memoryview(data)[: directory.size]
    while True:
        cut = Cut.of_complete(directory, complete).intersection(wanted)
        try:
            result = decode(stream, cut, limits=run.limits)
            break
        except StreamError as error:  # the packet counts as one that did not come (R-6.4-5)
            fault = fault or error
            complete &= (directory.offsets != error.offset) | (sizes == 0)
    fault = fault or _trailing(data, run, directory)
    if run.verify and fault is None:  # 6.1: step 5 before 6
        try:
            decode(stream, cut, verify=True, limits=run.limits)
        except StreamError as error:
            fault = error
    return _outcome(run, fault, cut.contains(wanted), result.dump)


def _outcome(
    run: Run, fault: StreamError | None, is_whole: bool, dump: Callable[[], bytes]
) -> Outcome:
    if fault is not None:
        beside = dump() if run.dump_on_fault else None
        return refused(run, fault.fault.name, fault.offset, beside)
    return Outcome(ACCEPTED if is_whole else INCOMPLETE, dump=dump())


def _arrival(data: bytes, run: Run) -> Sequence[tuple[int, int]]:
    return ((0, len(data)),) if run.arrival is None else run.arrival


def _prefix_size(there: npt.NDArray[np.bool_]) -> int:
    """How many bytes came without a gap."""
    return len(there) if there.all() else int(np.argmin(there))


def _trailing(data: bytes, run: Run, directory: Directory) -> StreamError | None:
    """Bytes after the last packet are a fault when no more come (spec 6.4)."""
    ends = [min(at + size, len(data)) for at, size in _arrival(data, run) if size]
    if max(ends, default=0) <= directory.size:
        return None
    return StreamError(Fault.E_TRAILING, "bytes follow the last packet", directory.size)


def _cut(level: int | None, directory: Directory) -> Cut:
    if level is None:
        return Cut.full(directory)
    try:
        return Cut.of_level(directory, level)
    except ValueError as error:
        raise _LevelError(str(error)) from None


if __name__ == "__main__":
    sys.exit(main())
