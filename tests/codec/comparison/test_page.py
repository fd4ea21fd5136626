"""The page: everything is escaped, nothing is loaded, and it is HTML."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest

pytest.importorskip("numba", reason="the package renders")
from PIL import Image

from evogs_codec.comparison.page import Bar, Figure, Gallery, Notes, Section, Table, html_page

EVIL = "<script>alert('1')</script> & \"x\" \u202e\n</title>"
VOID = {"meta", "img", "br"}


class Tags(HTMLParser):
    """Checks that tags are closed in the order in which they were opened."""

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.seen.add(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def parsed(page):
    tags = Tags()
    tags.feed(page.decode())
    assert not tags.open
    return tags


def page_of(*parts, text="x"):
    section = Section(text, parts, text)
    return html_page(text, text, [section], command="evogs compare", made_with=text)


PARTS = (
    Table([EVIL, "n"], [[EVIL, Bar(EVIL, 0.5)]], words=frozenset({1}), folded=EVIL),
    Table([EVIL, "n"], [[EVIL, EVIL]], words=frozenset({1})),
    Notes([EVIL]),
    Gallery([[Figure(np.zeros((2, 3, 3)), EVIL, EVIL)]]),
)


def test_no_text_gets_out_of_where_it_is_put():
    page = page_of(*PARTS, text=EVIL)
    found = parsed(page)
    assert not found.seen & {"script", "iframe", "link", "object", "a", "base", "form"}
    assert "\u202e" not in page.decode()
    assert "alert('1')" in found.text


def test_the_page_may_load_nothing():
    page = page_of(*PARTS).decode()
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'" in page
    assert re.findall(r'(?:src|href|srcset|action)="(?!data:image/png;base64,)', page) == []
    assert "url(" not in page
    assert "http" not in page.replace("http-equiv", "")


def test_a_picture_on_the_page_has_its_pixels():
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    page = page_of(Gallery([[Figure(pixels / 255, "a")]])).decode()
    data = re.search(r"data:image/png;base64,([^\"]+)", page)
    assert data is not None
    with Image.open(io.BytesIO(base64.b64decode(data[1]))) as image:
        np.testing.assert_array_equal(np.asarray(image), pixels)


def test_a_bar_is_as_long_as_its_share_and_never_longer_than_its_cell():
    for share, said in ((0.25, "25.0%"), (-1, "0.0%"), (7, "100.0%")):
        page = page_of(Table(["a", "b"], [["x", Bar("1", share)]])).decode()
        assert f"var(--bar) {said}" in page


def test_the_same_page_is_the_same_bytes():
    assert page_of(*PARTS) == page_of(*PARTS)
