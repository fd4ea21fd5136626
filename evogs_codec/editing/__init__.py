"""Streams to smaller streams, to trees, and to statistics; no packet is encoded."""
