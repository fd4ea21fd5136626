"""The folders of a run. A decoder may do in them what it likes, while it is looked at too.

So a file is read only if it is a regular one, no link is followed, and a folder of any depth and
any names can be measured and removed.
"""

from __future__ import annotations

import os
import secrets
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["MAX_DEPTH", "read_regular", "remove", "scratch", "written_too_much"]

MAX_DEPTH = 32


@contextmanager
def scratch(parent: Path | None = None, prefix: str = "evogs-") -> Iterator[Path]:
    """A new folder, removed afterwards as far as it can be."""
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    try:
        yield folder
    finally:
        remove(folder)


def read_regular(path: Path, most: int) -> bytes | None:
    """The bytes of a file, one more than `most` at most; None if it is no regular file.

    A link or a device could show anything, and a pipe could keep its reader waiting.
    """
    try:
        number = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        return None
    with os.fdopen(number, "rb") as file:
        return file.read(most + 1)


def written_too_much(folders: Sequence[Path], most: int, most_files: int) -> bool:
    """Whether folders hold over `most` bytes, or `most_files` files and folders, or too deep ones.

    What cannot be looked into is too much as well.
    """
    n_bytes = n_files = 0
    waiting = [(folder, 0) for folder in folders]
    while waiting:
        folder, depth = waiting.pop()
        try:
            with os.scandir(folder) as entries:
                for entry in entries:
                    n_files += 1
                    n_bytes += entry.stat(follow_symlinks=False).st_size
                    if n_files > most_files or n_bytes > most or depth > MAX_DEPTH:
                        return True
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append((Path(entry.path), depth + 1))
        except FileNotFoundError:  # it has gone in the meantime
            continue
        except OSError:
            return True
    return False


def remove(folder: Path) -> None:
    """Remove a folder with all that is in it, as far as possible.

    Folders in it are moved up first: a path could be too long, and a nesting too deep, to be
    followed down.
    """
    if folder.is_symlink():
        folder.unlink(missing_ok=True)
        return
    with suppress(OSError):
        folder.chmod(0o700)
    waiting, emptied = [folder], list[Path]()
    while waiting:
        inner = waiting.pop()
        emptied.append(inner)
        with suppress(OSError):
            for path in list(inner.iterdir()):
                with suppress(OSError):
                    if path.is_symlink() or not path.is_dir():
                        path.unlink()
                        continue
                    path.chmod(0o700)
                    waiting.append(path.rename(folder / secrets.token_hex(8)))
    for inner in reversed(emptied):
        with suppress(OSError):
            inner.rmdir()
