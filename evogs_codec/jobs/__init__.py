"""Scenes of any size: partition -> survey -> a stream for each tile -> merge.

Each takes bounded memory; `encode_files` is the whole of it.
"""

from evogs_codec.jobs.encode import JobOptions, encode_files
from evogs_codec.jobs.engines import Engine

__all__ = ["Engine", "JobOptions", "encode_files"]
