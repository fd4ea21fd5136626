"""JSON files of strangers, and the limits of a decoder, which are given in one."""

from __future__ import annotations

import json
import os
from pathlib import Path

from evogs_codec._generated.limits import LIMITS
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError

__all__ = ["read_json", "read_limits"]


def read_json(path: str | os.PathLike[str]) -> object:
    """The value of a JSON file; what is in it is for the caller to check.

    Raises:
        InputError: the file cannot be read or is no JSON.
    """
    try:
        return json.loads(Path(path).read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except RecursionError as error:
        raise InputError(f"{path}: lists or objects are nested too deeply") from error
    except ValueError as error:  # of JSON, of its encoding, of a number of thousands of digits
        raise InputError(f"{path}: is not JSON: {shown(error)}") from error


def read_limits(path: str | os.PathLike[str]) -> dict[str, int]:
    """Limits by the names of spec 8.2, as `decode` and `read_directory` take them.

    Raises:
        InputError: the file cannot be read, or is no object of known names and whole numbers.
    """
    found = read_json(path)
    if not isinstance(found, dict):
        raise InputError(f'{path}: is no object of limits, as {{"slots": 5000000}}')
    limits: dict[str, int] = {}
    for name, limit in found.items():
        if name not in LIMITS:
            raise InputError(f"{path}: '{shown(name)}' is no limit; limits are {', '.join(LIMITS)}")
        if type(limit) is not int or limit < 0:
            raise InputError(f"{path}: {name} is no whole number of 0 or more")
        limits[name] = limit
    return limits
