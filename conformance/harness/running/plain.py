"""What strangers say, made plain: printable and short text, and JSON that can be read.

A decoder writes any bytes it likes. None of them may move a cursor, end an element of a page, fill
a report, or end the harness.
"""

from __future__ import annotations

import json
import sys
from typing import Any

__all__ = ["MOST_OF_LINE", "plain", "plain_all", "plain_lines", "read_json", "say"]

MAX_CHARACTERS = 200  # characters of what a decoder says
MOST_OF_LINE = 2000  # characters of a line of a report


def plain(text: str | bytes, most: int = MAX_CHARACTERS) -> str:
    """`text` with all that is not printable escaped, cut to a length.

    What is left can be shown in a terminal and stand in XML, HTML and JSON. Bytes that are not
    UTF-8 are escaped too.
    """
    if isinstance(text, bytes):
        text = text[: 4 * most + 4].decode("utf-8", "backslashreplace")
    shown = "".join(c if c.isprintable() else _escaped(c) for c in text[: most + 1])
    return shown if len(shown) <= most else shown[: most - 3] + "..."


def plain_lines(text: str) -> str:
    """Each line of a report made plain."""
    return "\n".join(plain(line, MOST_OF_LINE) for line in text.split("\n"))


def plain_all(value: Any) -> Any:  # noqa: ANN401 - whatever JSON can hold
    """A value of JSON with all its strings made plain."""
    if isinstance(value, str):
        return plain(value, MOST_OF_LINE)
    if isinstance(value, dict):
        return {plain_all(key): plain_all(item) for key, item in value.items()}
    return [plain_all(item) for item in value] if isinstance(value, list | tuple) else value


def read_json(raw: bytes) -> Any:  # noqa: ANN401 - whatever JSON can hold
    """The value of a JSON text.

    Raises:
        ValueError: it is not UTF-8, not JSON, or nested too deep.
    """
    try:
        return json.loads(raw.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is not UTF-8") from None
    except RecursionError:
        raise ValueError("nested too deep") from None


def say(text: str) -> None:
    """Print to standard output, in the characters that it can show."""
    coding = sys.stdout.encoding or "ascii"
    print(text.encode(coding, "backslashreplace").decode(coding), flush=True)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
