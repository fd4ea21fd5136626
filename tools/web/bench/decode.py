"""Decodes the streams that it is told of, for decode.mjs: a path a line, answered with seconds."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from evogs_codec.decoding.decode import decode

for line in sys.stdin:
    data = Path(line.strip()).read_bytes()
    wall, cpu = time.perf_counter(), time.process_time()
    leaves = decode(data).leaves()
    took = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    print(json.dumps({"splats": len(leaves), **took}), flush=True)
    del leaves
