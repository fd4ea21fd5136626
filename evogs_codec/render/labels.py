"""Text in pictures: digits, small letters and some marks, in a font of 5 by 9 pixels.

The base install has no library that draws text, and a contact sheet needs one line of it a row.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.model.splats import F32

__all__ = ["GLYPH_HEIGHT", "GLYPH_WIDTH", "text_line"]

# A glyph is its character and nine rows, from the top; a row is a digit of base 32, whose five
# bits are the pixels, the leftmost first. The last two rows hold the tails of g, j, p, q and y.
FONT = """
0ehjlphe00 14c4444e00 2eh168gv00 3eh161he00 426aiv2200 5vgu11he00 668guhhe00 7v12488800
8ehhehhe00 9ehhf12c00 a00e1fhf00 bgguhhhu00 c00egghe00 d11fhhhf00 e00ehvge00 f698s88800
g00fhhhf1e hgguhhhh00 i40c444e00 j2062222ic kggikoki00 lc44444e00 m00qllll00 n00uhhhh00
o00ehhhe00 p00uhhhugg q00fhhhf11 r00mpggg00 s00fge1u00 t88s889600 u00hhhhf00 v00hhha400
w00hllla00 x00ha4ah00 y00hhhhf1e z00v248v00 Buhhuhhu00 .00000cc00 ,00000c480 :0cc0cc000
%pp248jj00 -000v00000 /11248gg00
"""
GLYPH_HEIGHT, GLYPH_WIDTH = 9, 6  # pixels, with the column between two glyphs
_BITS = np.array([16, 8, 4, 2, 1])
_GLYPHS = {entry[0]: [int(row, 32) for row in entry[1:]] for entry in FONT.split()}


def text_line(text: str, *, scale: int = 1, ink: float = 0.1, paper: float = 1.0) -> F32:
    """One line of text as a picture.

    Args:
        text: spaces and characters of `FONT`.
        scale: pixels of the picture to a pixel of the font.
        ink: brightness of the letters, 0..1.
        paper: brightness around them.

    Returns:
        (9 * scale, 6 * scale * len(text), 3).

    Raises:
        ValueError: the font has no such character.
    """
    missing = set(text) - set(_GLYPHS) - {" "}
    if missing:
        raise ValueError(f"no glyph for {', '.join(sorted(missing))}")
    is_ink = np.zeros((GLYPH_HEIGHT, GLYPH_WIDTH * len(text)), bool)
    for number, character in enumerate(text):
        rows = np.array(_GLYPHS.get(character, [0] * GLYPH_HEIGHT))
        left = GLYPH_WIDTH * number
        is_ink[:, left : left + len(_BITS)] = rows[:, None] & _BITS > 0
    large = np.repeat(np.repeat(is_ink, scale, 0), scale, 1)
    return np.repeat(np.where(large, ink, paper).astype(np.float32)[:, :, None], 3, 2)
