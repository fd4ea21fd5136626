"""What is measured, in a process of its own: run as a program, with any checkout of the codec.

It imports what every command needs, says so, and then runs each command that it is asked for in a
copy of itself (fork), so that start and imports are measured once. It imports nothing of `tools`:
the checkout whose codec is measured may be older than they are.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from evogs_codec import Decoder, StreamError, decode_leaves, read_directory

try:
    from evogs_codec.cli.commands import main as evogs
except ModuleNotFoundError:  # a checkout in which the command line was one module
    from evogs_codec.cli import main as evogs  # type: ignore[attr-defined, no-redef]

SECONDS = 60  # that a command may take


def cli(*arguments: str) -> Callable[[Path, Path], None]:
    """A command line; IN and OUT stand for files."""

    def run(stream: Path, folder: Path) -> None:
        names = {"IN": str(stream), "PLY": str(folder / "o.ply"), "OUT": str(folder / "o.evogs")}
        args = [names.get(word, word) for word in arguments]
        if "--max-bytes" in args:
            args.append(str(stream.stat().st_size * 2 // 3))
        if "--level" in args:
            args.append(str(max(0, stream.read_bytes()[12] - 2)))
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            evogs(args)

    return run


def arrays(stream: Path, folder: Path) -> None:
    """Float arrays of the whole stream."""
    decode_leaves(stream.read_bytes())


def feed(size: int, order: str = "forward") -> Callable[[Path, Path], None]:
    """Pieces of a size, and `leaves` after the last."""

    def run(stream: Path, folder: Path) -> None:
        data, decoder = stream.read_bytes(), Decoder()
        for begin, end in pieces(data, size, order):
            decoder.feed(data[begin:end], begin)
        decoder.leaves()

    return run


def pieces(data: bytes, size: int, order: str) -> Iterator[tuple[int, int]]:
    """(begin, end) of the pieces of a file in an order."""
    starts = list(range(0, len(data), size))
    if order == "backward":
        starts.reverse()
    elif order == "interleaved":
        starts = starts[::2] + starts[1::2]
    elif order == "late":  # the first byte of the first packet comes last
        directory = read_directory(data)
        yield 0, directory.data_offset
        starts = list(range(directory.data_offset + 1, len(data), size))
        yield from ((at, at + size) for at in starts)
        yield directory.data_offset, directory.data_offset + 1
        return
    for at in starts:
        yield at, at + size * (3 if order == "overlapping" else 1)


def feed_all_but_one(stream: Path, folder: Path) -> None:
    """All packets at once but the last, and `leaves` of the others."""
    data = stream.read_bytes()
    directory = read_directory(data)
    decoder = Decoder()
    last = int(directory.offsets[-1]) if len(directory.packets) else len(data)
    decoder.feed(data[:last], 0)
    decoder.leaves()


COMMANDS: dict[str, Callable[[Path, Path], None]] = {
    "decode to .ply": cli("decode", "IN", "PLY"),
    "decode to arrays": arrays,
    "validate": cli("validate", "IN"),
    "info": cli("info", "IN"),
    "info --json": cli("info", "IN", "--json"),
    "extract --level": cli("extract", "IN", "OUT", "--level"),
    "extract --max-bytes": cli("extract", "IN", "OUT", "--max-bytes"),
    "extract --box": cli("extract", "IN", "OUT", "--box", "0", "0", "0", "1", "1", "1"),
    "extract --sh-degree": cli("extract", "IN", "OUT", "--sh-degree", "0"),
    "feed 1": feed(1),
    "feed 1 backward": feed(1, "backward"),
    "feed 100": feed(100),
    "feed 100 interleaved": feed(100, "interleaved"),
    "feed 100 overlapping": feed(100, "overlapping"),
    "feed 100, the first packet last": feed(100, "late"),
    "feed 4096": feed(4096),
    "feed 4096 backward": feed(4096, "backward"),
    "feed all, one packet missing": feed_all_but_one,
}


def measured(command: str, stream: Path) -> dict[str, object]:
    """Processor seconds, peak memory, and how it ended, of a forked copy."""
    begin, end = os.pipe()
    with tempfile.TemporaryDirectory() as folder:
        child = os.fork()
        if not child:
            os.close(begin)
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
            signal.signal(signal.SIGXCPU, signal.SIG_DFL)
            ended = "well"
            try:
                COMMANDS[command](stream, Path(folder))
            except StreamError as error:
                ended = error.fault.name
            except BaseException as error:
                ended = repr(error)
            os.write(end, json.dumps({"ended": ended}).encode())
            os._exit(0)
        os.close(end)
        with os.fdopen(begin, "rb") as pipe:
            said = pipe.read()
        _, _, usage = os.wait4(child, 0)
    found = json.loads(said or b'{"ended": "killed"}')
    seconds = usage.ru_utime + usage.ru_stime
    return {**found, "seconds": seconds, "peak": usage.ru_maxrss * 1024}


def main() -> None:
    """Say what starting took; then answer lines of (command, path) with what it took."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    start = {"seconds": usage.ru_utime + usage.ru_stime, "peak": usage.ru_maxrss * 1024}
    print(json.dumps(start), flush=True)
    for line in sys.stdin:
        command, path = json.loads(line)
        print(json.dumps(measured(command, Path(path))), flush=True)


if __name__ == "__main__":
    main()
