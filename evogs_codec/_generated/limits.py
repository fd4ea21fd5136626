"""Limits by tier of spec 8.2. Made by `tools/spec_tables.py` from `spec/limits.csv`."""

from __future__ import annotations

# name: limit of tier 1, 2, 3
LIMITS: dict[str, tuple[int, int, int]] = {
    "n_tiles": (64, 4096, 65536),
    "n_packets": (16384, 262144, 4194304),
    "n_levels": (64, 64, 64),
    "chunks_size": (1048576, 33554432, 536870912),
    "tile_steps": (1024, 4096, 65535),
    "tile_slots": (1048576, 4194304, 16777216),
    "slots": (2097152, 33554432, 2147483647),
}
