"""Writing files: never over a source, and a reader sees the old file or the new one whole."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from evogs_codec.errors import InputError
from evogs_codec.format.layout import SIGNATURE
from evogs_codec.io import makers

__all__ = [
    "JPEG",
    "KIND_BYTES",
    "PAGE",
    "PICTURE",
    "REPORT",
    "SCENE",
    "STREAM",
    "TREE",
    "FileKind",
    "check_target",
    "kind_of",
    "same_file",
    "write_atomic",
]


@dataclass(frozen=True)
class FileKind:
    """What a command makes.

    Attributes:
        name: for messages.
        begins: the first bytes, one of these.
        members: names of files that it has as a zip.
        made_by: whether the file at a path, which is of this kind, names a command as its maker;
            None: the kind is its maker.
    """

    name: str
    begins: tuple[bytes, ...]
    members: frozenset[str] = frozenset()
    made_by: Callable[[Path, str], bool] | None = None

    def fits(self, path: Path) -> bool:
        """Whether a file that exists is of this kind; one that cannot be read is not."""
        try:
            with path.open("rb") as file:
                start = file.read(max(map(len, self.begins)))
                return start.startswith(self.begins) and self._has_members(file)
        except OSError:
            return False

    def _has_members(self, file: BinaryIO) -> bool:
        if not self.members:
            return True
        try:
            with zipfile.ZipFile(file) as archive:
                return self.members <= set(archive.namelist())
        except Exception:  # whatever `zipfile` raises, it could not read it
            return False


STREAM = FileKind("EvoGS stream", (SIGNATURE,), made_by=makers.encoded_stream)
SCENE = FileKind(".ply", (b"ply\n", b"ply\r"), made_by=makers.marked_scene)
TREE = FileKind(
    ".tree.npz",
    (b"PK\x03\x04",),
    frozenset({"format.npy", "means.npy"}),
    makers.marked_tree,
)
PICTURE = FileKind("PNG", (b"\x89PNG\r\n\x1a\n",), made_by=makers.marked_picture)
JPEG = FileKind("JPEG", (b"\xff\xd8\xff",), made_by=makers.marked_jpeg)
PAGE = FileKind("page", (b"<!doctype html>", b"<!DOCTYPE html>"))
REPORT = FileKind("page", PAGE.begins, made_by=makers.marked_page)
KINDS = (STREAM, SCENE, TREE, PICTURE)
KIND_BYTES = 8  # of a file, that tell its kind


def kind_of(data: bytes | memoryview) -> FileKind | None:
    """The kind of a file whose first `KIND_BYTES` bytes, or more, are `data`; None if of no kind.

    Every zip counts as a `.tree.npz`: its members are not looked at.
    """
    start = bytes(data[:KIND_BYTES])
    return next((kind for kind in KINDS if start.startswith(kind.begins)), None)


def check_target(
    path: str | os.PathLike[str],
    kind: FileKind | None = None,
    *,
    command: str,
    sources: Iterable[str | os.PathLike[str]] = (),
    force: bool = False,
) -> None:
    """Refuse now what could not or must not be written later, after the work is done.

    Args:
        path: what will be written.
        kind: what it will be; a file that is there must be of this kind, or empty.
        command: what makes it; a file that is there must name it as its maker, or be empty.
        sources: what is read; none of them may be written, not even with `force`.
        force: replace any other file.

    Raises:
        OSError: the folder of `path` is missing, is no folder, or may not be written to; or `path`
            is a folder, or a link that leads nowhere but to itself.
        InputError: `path` is one of the sources, of another kind, or somebody else's.
    """
    target = _resolved(path)
    try:
        mode = target.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        _check_folder(target.parent, path)
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        return  # a device or a pipe
    _check_folder(target.parent, path)
    for source in sources:
        if same_file(path, source):
            raise InputError(f"{path}: is an input of the command; name another output")
    if kind is None or force or not target.stat().st_size:
        return
    instead = "name another output, or use --force"
    if not kind.fits(target):
        raise InputError(f"{path}: exists and is no {kind.name}; {instead}")
    if kind.made_by is not None and not kind.made_by(target, command):
        raise InputError(
            f"{path}: exists and was not made by `{command}`, as far as it says; {instead}"
        )


def same_file(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to the same file, also through links; false if one is not there."""
    try:
        return Path(one).samefile(other)
    except OSError:
        return False


def write_atomic(path: str | os.PathLike[str], data: bytes | Callable[[BinaryIO], object]) -> None:
    """Write `data` to `path` through a temporary file in the same folder.

    The bytes are on the disk before the name is: after a power failure too, `path` is the old file
    or the new one.

    Args:
        path: the file to make or replace; a device or pipe is written to directly.
        data: the bytes, or a function that writes them to the stream it is given.

    Raises:
        OSError: the file cannot be written; it names `path`, not the temporary file.
    """
    if Path(path).is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    try:
        # A link keeps pointing at the file that it names.
        target = _resolved(path)
        if target.exists() and not target.is_file():
            with target.open("wb") as stream:  # replacing /dev/null would remove it
                _fill(stream, data)
            return
        _replace(target, data)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def _resolved(path: str | os.PathLike[str]) -> Path:
    """Where the links of `path` lead; not `Path.resolve`, which has an error of its own."""
    target = Path(os.path.realpath(path))
    if target.is_symlink():  # what is left is a link to itself
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return target


def _check_folder(folder: Path, path: str | os.PathLike[str]) -> None:
    nearest = next(at for at in (folder, *folder.parents) if at.exists())
    if not nearest.is_dir():
        said = f"{nearest.name} is a file, not a folder: name another output"
        raise NotADirectoryError(errno.ENOTDIR, said, str(path))
    if not folder.exists():
        raise FileNotFoundError(errno.ENOENT, "its folder does not exist: make it first", str(path))
    if not os.access(folder, os.W_OK):
        said = "its folder may not be written to: name another output"
        raise PermissionError(errno.EACCES, said, str(path))


def _replace(target: Path, data: bytes | Callable[[BinaryIO], object]) -> None:
    # Not `tempfile`: its files are private to the user, ours get the usual permissions. The name
    # is short, so that it fits wherever the name of the target does.
    temporary = target.with_name(f".{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
            _fill(stream, data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except BaseException:  # also Ctrl-C
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Put the new name on the disk, where the system lets a folder be opened and synced."""
    with contextlib.suppress(OSError):  # the file is whole under its name already
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _fill(stream: BinaryIO, data: bytes | Callable[[BinaryIO], object]) -> None:
    if callable(data):
        data(stream)
    else:
        stream.write(data)
