"""Scenes and streams of any size, and what a process takes, for `python -m tools.bench`."""

import sys
from pathlib import Path

import numpy as np
import pytest

from tools.bench import scale
from tools.bench.large import together
from tools.bench.measure import cost


@pytest.fixture
def small_copies(monkeypatch):
    monkeypatch.setattr(scale, "COPY", 300)


@pytest.mark.parametrize("n", [1, 299, 1000])
def test_copies_of_a_scene_are_as_many_splats_as_asked_no_two_alike(small_copies, n):
    splats = scale.tiled(n)
    assert len(splats) == n
    assert splats.sh_degree == scale.SH_DEGREE
    assert splats.finite().all()
    assert len(np.unique(splats.means, axis=0)) == n


def test_the_cost_of_code_is_its_own_peak():
    large = "x = bytearray(64 << 20)\nx = None"
    base, while_there = cost("").peak, cost(large).peak
    assert 60 << 20 < while_there - base < 72 << 20
    assert cost("", before=large, after="print('later')").peak - base < 16 << 20


@pytest.mark.thorough
@pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="Linux alone tells")
def test_the_memory_of_a_command_is_that_of_all_its_processes(tmp_path):
    fill = "x = bytes(range(256)) * (80 << 12)"
    one = f"import time; {fill}; time.sleep(1.5)"
    both = f"import subprocess, sys; {fill}; subprocess.run([sys.executable, '-c', {one!r}])"
    (tmp_path / "file").write_bytes(bytes(1000))
    found = together([sys.executable, "-c", both], tmp_path)
    assert 160 << 20 < found.peak < 260 << 20
    assert found.scratch == 1000
    assert 0 < found.processor < 60
