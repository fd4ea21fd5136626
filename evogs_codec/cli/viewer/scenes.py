"""The scenes that are served, by the names that requests give them."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol
from urllib.parse import unquote

__all__ = ["Folder", "NoScenes", "OneFile", "Scenes", "TilesetFolder"]

SUFFIX = ".evogs"


class Scenes(Protocol):
    """Finds scenes; what it does not find is not served."""

    def find(self, name: str) -> Path | None:
        """The file of a name, or None."""
        ...

    def names(self) -> list[str]:
        """All names, in order."""
        ...


class NoScenes:
    """Nothing: the page is to show a scene of another server."""

    def find(self, name: str) -> None:
        """Nothing has a name."""

    def names(self) -> list[str]:
        """No name."""
        return []


class OneFile:
    """A single file, under its own name."""

    def __init__(self, path: Path, name: str) -> None:
        self._path = path
        self._name = name

    def find(self, name: str) -> Path | None:
        """The file, if it is meant."""
        return self._path if name == self._name else None

    def names(self) -> list[str]:
        """Its name."""
        return [self._name]


class Folder:
    """The `.evogs` files of a folder and of those below, and nothing outside of it."""

    suffixes: tuple[str, ...] = (SUFFIX,)

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def find(self, name: str) -> Path | None:
        """A file in the folder; links that lead out of it lead nowhere."""
        parts = name.split("/")
        if any(part in ("", ".", "..") or "\\" in part or "\0" in part for part in parts):
            return None
        if not name.endswith(self.suffixes):
            return None
        try:
            path = self._folder.joinpath(*parts).resolve(strict=True)
        except OSError:
            return None
        return path if path.is_file() and path.is_relative_to(self._folder) else None

    def names(self) -> list[str]:
        """Names of all that is found, sorted."""
        names = (
            path.relative_to(self._folder).as_posix() for path in self._folder.rglob("*" + SUFFIX)
        )
        return sorted(name for name in names if self.find(name) is not None)


class TilesetFolder(Folder):
    """The files of a tileset, and no others of its folder."""

    suffixes = (SUFFIX, ".json")

    def __init__(self, root: Path, files: frozenset[str]) -> None:
        """Of the first file of a tileset, which names the others as in a URL (`%20`)."""
        super().__init__(root.parent)
        self._name = root.name
        self._files = frozenset(map(unquote, files))

    def find(self, name: str) -> Path | None:
        """A file of the tileset."""
        return super().find(name) if name == self._name or name in self._files else None

    def names(self) -> list[str]:
        """That of the first file, with which all of it is opened."""
        return [self._name]
