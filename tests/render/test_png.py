"""PNG files are what another reader of PNG sees, and sheets are the pictures side by side."""

import numpy as np
import pytest
from PIL import Image

from evogs_codec.render.labels import GLYPH_HEIGHT, GLYPH_WIDTH, text_line
from evogs_codec.render.png import MARGIN, contact_sheet, write_png


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 300), (300, 1), (37, 53)])
def test_another_reader_sees_the_rounded_pixels(tmp_path, height, width):
    image = np.random.default_rng(0).uniform(-0.2, 1.2, (height, width, 3))
    write_png(tmp_path / "x.png", image)
    with Image.open(tmp_path / "x.png") as file:
        file.verify()
    with Image.open(tmp_path / "x.png") as file:
        assert (file.mode, file.size) == ("RGB", (width, height))
        pixels = np.asarray(file)
    np.testing.assert_array_equal(pixels, np.rint(np.clip(image, 0, 1) * 255))


@pytest.mark.parametrize(("number", "byte"), [(np.nan, 0), (np.inf, 255), (-np.inf, 0), (2.0, 255)])
def test_a_number_that_is_no_colour_is_drawn_as_the_nearest(tmp_path, number, byte):
    write_png(tmp_path / "x.png", np.full((2, 2, 3), number, np.float32))
    with Image.open(tmp_path / "x.png") as file:
        assert (np.asarray(file) == byte).all()


def test_a_picture_of_other_channels_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"expected \(H, W, 3\)"):
        write_png(tmp_path / "x.png", np.zeros((4, 4, 1)))


def test_a_sheet_repeats_the_pixels_of_small_pictures():
    large, small = np.full((8, 8, 3), 0.5), np.random.default_rng(1).random((4, 4, 3))
    sheet = contact_sheet([[small, large], [large]], gap=2, colour=1.0)
    assert sheet.shape == (18, 18, 3)
    np.testing.assert_allclose(sheet[:8:2, :8:2], small, atol=1e-7)
    np.testing.assert_allclose(sheet[1:8:2, 1:8:2], small, atol=1e-7)
    assert (sheet[8:10] == 1).all()
    assert (sheet[10:, 10:] == 1).all()


def test_a_sheet_may_be_without_gaps():
    assert contact_sheet([[np.zeros((8, 8, 3))] * 2] * 2, gap=0).shape == (16, 16, 3)


def test_a_label_stands_above_its_row_and_is_cut_to_the_sheet():
    row = [np.full((20, 300, 3), 0.5)]
    sheet = contact_sheet([row, row], labels=["level 0", 80 * "x"], gap=2)
    large, small = 2 * GLYPH_HEIGHT + 2 * MARGIN, GLYPH_HEIGHT + 2 * MARGIN
    assert sheet.shape == (large + 20 + 2 + small + 20, 300, 3)
    assert (sheet[:large] < 0.5).any()
    assert (sheet[large : large + 20] == 0.5).all()


def test_glyphs_differ_and_stay_in_their_cells():
    characters = "0123456789abcdefghijklmnopqrstuvwxyzB.,:%-/"
    line = text_line(characters)
    assert line.shape == (GLYPH_HEIGHT, GLYPH_WIDTH * len(characters), 3)
    cells = np.split(line[:, :, 0], len(characters), axis=1)
    assert len({cell.tobytes() for cell in cells}) == len(characters)
    assert all((cell[:, -1] == 1).all() and (cell < 1).any() for cell in cells)
    with pytest.raises(ValueError, match="no glyph for !"):
        text_line("level 0!")
