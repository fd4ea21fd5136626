"""The reference decoder behind the command of conformance/README.md.

`python -m conformance.decoder --in FILE --out OUT --mode file|progressive ...`
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import Cut, Decoder, Directory, Fault, StreamError, decode, read_directory
from evogs_codec.files import same_file
from evogs_codec.printable import shown

__all__ = ["add_options", "main", "run_command"]

ACCEPTED, REJECTED, USAGE, INCOMPLETE, OVER_LIMIT, NOT_SUPPORTED = 0, 1, 2, 3, 4, 127
EXITS = {Fault.E_LIMIT: OVER_LIMIT, Fault.E_UNSUPPORTED: NOT_SUPPORTED}
MODES = ["file", "progressive"]
CAPABILITIES = {
    "name": "evogs_codec",
    "version": "1.0-draft",
    "modes": MODES,
    "codes": True,
    "verify": True,
    "limits": True,
    "arrival": True,
    "batch": True,
    "max_tier": 3,
    "max_sh_degree": 3,
}


@dataclass(frozen=True)
class Request:
    """A run: `limits` by name, `arrival` as [offset, size] in order."""

    source: Path
    target: Path
    mode: str
    level: int | None = None
    limits: dict[str, int] | None = None
    verify: bool = False
    arrival: list[list[int]] | None = None


@dataclass(frozen=True)
class Reply:
    """An exit of the contract; the fault if there is one."""

    exit: int
    code: str | None = None
    offset: int | None = None

    def fault(self) -> dict[str, Any]:
        """As the contract reports it."""
        return {} if self.code is None else {"code": self.code, "offset": self.offset}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(description="The reference decoder, under test.")
    add_options(parser)
    return run_command(parser.parse_args(arguments))


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of the contract."""
    parser.add_argument("--in", dest="source", type=Path, metavar="FILE")
    parser.add_argument("--out", dest="target", type=Path, metavar="OUT")
    parser.add_argument("--mode", choices=MODES, default="file")
    parser.add_argument("--level", type=int, metavar="K", help="cut by level K")
    parser.add_argument("--limits", type=Path, metavar="FILE.json", help="limits by name")
    parser.add_argument("--verify", action="store_true", help="check digests")
    parser.add_argument("--arrival", type=Path, metavar="FILE.json", help="[[offset, size], ...]")
    parser.add_argument("--capabilities", action="store_true", help="print them and end")
    parser.add_argument("--batch", action="store_true", help="a JSON request per line of input")


def run_command(args: argparse.Namespace) -> int:
    """What the options ask for; returns the exit code."""
    if args.capabilities:
        print(json.dumps(CAPABILITIES))
        return 0
    if args.batch:
        serve()
        return 0
    if args.source is None or args.target is None:
        print("evogs conformance decoder: --in and --out are required", file=sys.stderr)
        return USAGE
    request = Request(
        args.source,
        args.target,
        args.mode,
        args.level,
        _json(args.limits),
        args.verify,
        _json(args.arrival),
    )
    reply = answer(request)
    if reply.code is not None:
        print(json.dumps(reply.fault()))
    return reply.exit


def serve() -> None:
    """The batch protocol on standard input and output."""
    for line in sys.stdin:
        entry = json.loads(line)
        request = Request(
            Path(entry["in"]),
            Path(entry["out"]),
            entry["mode"],
            entry.get("level"),
            _json(entry.get("limits")),
            entry.get("verify", False),
            _json(entry.get("arrival")),
        )
        reply = answer(request)
        print(json.dumps({"id": entry["id"], "exit": reply.exit} | reply.fault()), flush=True)


def answer(request: Request) -> Reply:
    """Decode, and write the dump if there is one."""
    if same_file(request.source, request.target):
        print(f"{shown(request.target)}: is the stream; name another file", file=sys.stderr)
        return Reply(USAGE)
    data = request.source.read_bytes()
    try:
        if request.mode == "file":
            cut = partial(_cut, request.level)
            decoded = decode(data, cut, verify=request.verify, limits=request.limits)
            exit_code, dump = ACCEPTED, decoded.dump()
        elif request.level is None and not request.verify:
            exit_code, dump = feed(data, request)
        else:
            exit_code, dump = complete_packets(data, request)
    except StreamError as error:
        if request.mode == "progressive" and error.fault is Fault.E_TRUNCATED:  # R-6.4-3
            return Reply(INCOMPLETE)
        return Reply(EXITS.get(error.fault, REJECTED), error.fault.name, error.offset)
    request.target.write_bytes(dump)
    return Reply(exit_code)


def feed(data: bytes, request: Request) -> tuple[int, bytes]:
    """Exit and dump of a progressive decoder that is fed piece by piece; then no more comes.

    Raises:
        StreamError: the first fault; E_TRUNCATED only if header or chunks are not complete.
    """
    decoder = Decoder(limits=request.limits)
    for at, size in _arrival(data, request):
        decoder.feed(data[at : at + size], at)
    if decoder.fault is not None:
        raise decoder.fault
    try:
        decoder.close()
    except StreamError as error:
        if error.fault is not Fault.E_TRUNCATED or decoder.directory is None:
            raise
    assert decoder.directory is not None
    _check_trailing(data, request, decoder.directory)
    full = Cut.full(decoder.directory)
    is_whole = decoder.cut.has(full)
    return ACCEPTED if is_whole else INCOMPLETE, decoder.dump()


def complete_packets(data: bytes, request: Request) -> tuple[int, bytes]:
    """The same, seen from the end: the packets whose bytes came, of the cut asked for."""
    there = np.zeros(len(data), bool)
    for at, size in _arrival(data, request):
        there[at : at + size] = True
    directory = read_directory(memoryview(data)[: _prefix_size(there)], request.limits)
    n_there = np.concatenate([[0], np.cumsum(there)])
    ends = np.minimum(directory.offsets + directory.packets["size"], len(data))
    starts = np.minimum(directory.offsets, len(data))
    complete = n_there[ends] - n_there[starts] == directory.packets["size"]
    wanted = _cut(request.level, directory)
    cut = Cut.of_complete(directory, complete).within(wanted)
    stream = memoryview(data)[: directory.size]
    decoded = decode(stream, cut, limits=request.limits)
    _check_trailing(data, request, directory)
    if request.verify:  # 6.1: step 5 before 6
        decode(stream, cut, verify=True, limits=request.limits)
    is_whole = cut.has(wanted)
    return ACCEPTED if is_whole else INCOMPLETE, decoded.dump()


def _arrival(data: bytes, request: Request) -> list[list[int]]:
    return [[0, len(data)]] if request.arrival is None else request.arrival


def _prefix_size(there: npt.NDArray[np.bool_]) -> int:
    """How many bytes came without a gap."""
    return len(there) if there.all() else int(np.argmin(there))


def _check_trailing(data: bytes, request: Request, directory: Directory) -> None:
    """Bytes after the last packet are a fault when no more come (spec 6.4)."""
    ends = [min(at + size, len(data)) for at, size in _arrival(data, request) if size]
    if max(ends, default=0) > directory.size:
        raise StreamError(Fault.E_TRAILING, "bytes follow the last packet", directory.size)


def _json(path: str | Path | None) -> Any:  # noqa: ANN401 - limits, or ranges
    return None if path is None else json.loads(Path(path).read_bytes())


def _cut(level: int | None, directory: Directory) -> Cut:
    return Cut.full(directory) if level is None else Cut.of_level(directory, level)


if __name__ == "__main__":
    sys.exit(main())
