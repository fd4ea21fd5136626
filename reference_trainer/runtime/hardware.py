"""What a run was made on, without the name of the machine."""

from __future__ import annotations

import os
import platform
from pathlib import Path

__all__ = ["machine"]


def machine(device: str = "cpu") -> str:
    """The processor with its cores, or the GPU; and the version of Python."""
    if device != "cpu":
        import torch

        return f"{torch.cuda.get_device_name(device)}, Python {platform.python_version()}"
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        model = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), model)
    return f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}"
