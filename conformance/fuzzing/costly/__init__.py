"""Streams of at most 100,000 bytes that are made to cost a decoder as much as they can."""

from conformance.fuzzing.costly.shapes import STEPS, Shape, random_shape
from conformance.fuzzing.costly.streams import BUDGET, costly_stream, stream_of

__all__ = ["BUDGET", "STEPS", "Shape", "costly_stream", "random_shape", "stream_of"]
