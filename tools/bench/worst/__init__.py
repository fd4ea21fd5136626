"""Worst cases: the streams of 100,000 bytes that cost a decoder most, found by a search."""

from tools.bench.worst.table import worst

__all__ = ["worst"]
