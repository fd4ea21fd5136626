"""Text from files of strangers, made fit to print."""

from __future__ import annotations

__all__ = ["MAX_LINE", "MAX_NAME", "shown"]

MAX_NAME = 200  # characters of a name, a title, a piece of a header
MAX_LINE = 2000  # characters of a whole message, which has a path in it


def shown(text: object, limit: int | None = MAX_NAME) -> str:
    """`text` with everything escaped that is not printable, and cut in its middle to `limit`.

    Escaped are control characters, line breaks, direction marks, and lone surrogates, which no
    output could encode.
    """
    raw = _cut(str(text), limit)
    return _cut("".join(c if c.isprintable() else _escape(c) for c in raw), limit)


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def _cut(text: str, limit: int | None) -> str:
    if limit is None or len(text) <= limit:
        return text
    tail = (limit - 3) // 2
    return f"{text[: limit - 3 - tail]}...{text[len(text) - tail :]}"
