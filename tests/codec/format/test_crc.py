"""CRC-32: ISA-L's where it is installed, zlib's elsewhere, and the same."""

import importlib
import sys
import zlib

import pytest

from evogs_codec.format import crc

TEXT = bytes(range(256)) * 300


@pytest.mark.parametrize("n", [0, 1, 9, 255, 76_800])
def test_it_is_that_of_zlib(n):
    assert crc.crc32(TEXT[:n]) == zlib.crc32(TEXT[:n])
    assert crc.crc32(memoryview(TEXT)[n:], crc.crc32(TEXT[:n])) == zlib.crc32(TEXT)


def test_without_isal_it_is_zlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "isal.isal_zlib", None)
    try:
        assert importlib.reload(crc).crc32 is zlib.crc32
    finally:
        monkeypatch.undo()
        importlib.reload(crc)
