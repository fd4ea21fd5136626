"""The extremes: what codec, rasterizer and trainer promise, against exact arithmetic."""
