"""The version of the package."""

from __future__ import annotations

from importlib import metadata

__all__ = ["__version__"]


def _version() -> str:
    try:
        return metadata.version("evogs")
    except metadata.PackageNotFoundError:  # a source tree that was not installed
        return "0+source"


__version__ = _version()
