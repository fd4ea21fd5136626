"""Names of the benchmarks, in the order of their page."""

__all__ = ["PARTS"]

PARTS = (
    "raster", "scene", "rate", "sog", "levels", "refine", "tree", "surface", "prefix", "loss",
    "alone", "depth", "falls", "small", "first", "stream", "decimate", "effort", "before",
    "targets", "refused", "inputs", "scale", "large", "city", "landscape", "worst", "extremes",
)  # fmt: skip
