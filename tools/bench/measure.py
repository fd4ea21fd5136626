"""Measuring: turns of contenders, errors of splats, memory of a process of its own."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np

from evogs_codec import EvolutionTree, SplatParams, leaf_order

__all__ = [
    "Code",
    "Cost",
    "cost",
    "errors",
    "least",
    "leaves_in_stream_order",
    "peak_memory",
    "seconds_text",
    "take_turns",
    "take_turns_apart",
]


def take_turns(contenders: Mapping[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Median seconds of each contender; they take turns, after one round that does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(turns + 1):
        for name, run in contenders.items():
            start = time.perf_counter()
            result = run()
            if turn:
                seconds[name].append(time.perf_counter() - start)
            del result
    return {name: statistics.median(times) for name, times in seconds.items()}


class Code(NamedTuple):
    """A contender as text, so that it can run anywhere: what goes before, and what is timed."""

    before: str
    timed: str

    def runner(self) -> Callable[[], object]:
        """What runs it here."""
        names: dict[str, object] = {}
        exec(f"{self.before}\ndef run():\n    return {self.timed}\n", names)
        run = names["run"]
        assert callable(run)
        return run


def take_turns_apart(
    contenders: Mapping[str, Code], turns: int, clock: str = "perf_counter"
) -> dict[str, float]:
    """As `take_turns`, each in a process of its own: memory that one frees serves no other.

    `clock` is one of `time`: "process_time" counts what all threads take, in the system too.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    with ExitStack() as stack:
        workers = {
            name: stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", _WORKER, clock, *code],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            for name, code in contenders.items()
        }
        for turn in range(turns + 1):
            for name, worker in workers.items():
                assert worker.stdin is not None
                assert worker.stdout is not None
                print(file=worker.stdin, flush=True)
                found = float(worker.stdout.readline())
                if turn:
                    seconds[name].append(found)
    return {name: statistics.median(times) for name, times in seconds.items()}


_WORKER = """
import sys, time
from tools.bench.measure import Code
now = getattr(time, sys.argv[1])
run = Code(*sys.argv[2:]).runner()
for line in sys.stdin:
    start = now()
    result = run()
    print(now() - start, flush=True)
    del result
"""


def least(run: Callable[[], object], turns: int) -> float:
    """Processor seconds of all threads, of the fastest of so many turns, after one for nothing."""
    run()
    seconds = []
    for _ in range(turns):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return min(seconds)


def seconds_text(seconds: float) -> str:
    """Seconds to one decimal; of less than a second the first two digits, so that none is 0."""
    return f"{seconds:.1f}" if seconds >= 1 else f"{seconds:.2g}"


def leaves_in_stream_order(tree: EvolutionTree) -> SplatParams:
    """The float leaves in the order in which a default stream of the tree decodes them."""
    return tree.leaves().take(leaf_order(tree))


def errors(decoded: SplatParams, original: SplatParams) -> dict[str, float]:
    """Attribute errors of splats in the same order; quaternions after normalisation, up to sign."""
    q = decoded.quats.astype(np.float64)
    p = original.quats.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    q *= np.sign((p * q).sum(1, keepdims=True))
    sh = np.square(decoded.sh.astype(np.float64) - original.sh)
    return {
        "position max": float(np.abs(decoded.means - original.means).max()),
        "quaternion max": float(np.abs(p - q).max()),
        "log-scale rms": _rms(decoded.log_scales - original.log_scales),
        "opacity logit rms": _rms(decoded.opacity_logits - original.opacity_logits),
        "SH 0 rms": float(np.sqrt(sh[:, 0].mean())),
        "SH 1+ rms": float(np.sqrt(sh[:, 1:].mean())) if sh.shape[1] > 1 else 0.0,
    }


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.square(difference, dtype=np.float64).mean()))


def peak_memory(code: str) -> tuple[int, float]:
    """(peak bytes, seconds) of `code` in a process of its own, imports included."""
    found = cost(code)
    return found.peak, found.seconds


class Cost(NamedTuple):
    """What code takes: peak bytes of its process, seconds, processor seconds of all threads."""

    peak: int
    seconds: float
    processor: float


def cost(code: str, before: str = "", after: str = "") -> Cost:
    """That of `code` in a process of its own, and of what `before` has left there."""
    program = (
        "import time\n"
        f"{before}\n"
        "open('/proc/self/clear_refs', 'w').write('5')\n"  # the peak begins here
        "start, of_start = time.perf_counter(), time.process_time()\n"
        f"{code}\n"
        "seconds = time.perf_counter() - start\n"
        "processor = time.process_time() - of_start\n"
        "lines = open('/proc/self/status').read().splitlines()\n"
        "peak = next(line for line in lines if line.startswith('VmHWM')).split()[1]\n"
        f"{after}\n"
        "print(int(peak) * 1024, seconds, processor)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    peak, seconds, processor = run.stdout.split()[-3:]
    return Cost(int(peak), float(seconds), float(processor))
