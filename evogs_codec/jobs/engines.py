"""Engines: where jobs run. Each is a `concurrent.futures.Executor`."""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal, TypeAlias, TypeVar

from evogs_codec.errors import InputError

__all__ = ["Engine", "Workers"]

Call: TypeAlias = "tuple[Any, ...]"
T = TypeVar("T")

RETRIES = 3  # of jobs whose worker died
JOBS_EACH = 16  # of a process, then another takes its place
# A job is one thread: there are as many workers as processors.
LIBRARIES = "OMP", "OPENBLAS", "MKL", "NUMBA"
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in LIBRARIES}


@dataclass(frozen=True)
class Engine:
    """Where jobs run.

    Attributes:
        name: `processes` of this machine, `serial` in this process, or `dask`.
        workers: processes; by default one for each processor.
        scheduler: address of a Dask scheduler; by default a cluster of this machine.

    Raises:
        ValueError: on construction, there is no such engine, or `workers` is below 1.
    """

    name: Literal["processes", "serial", "dask"] = "processes"
    workers: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.name not in ("processes", "serial", "dask"):
            raise ValueError(f"engine is {self.name!r}, expected processes, serial or dask")
        if self.workers is not None and self.workers < 1:
            raise ValueError(f"workers is {self.workers}, expected at least 1")

    @property
    def n_workers(self) -> int:
        """Processes."""
        return self.workers or os.cpu_count() or 1

    @property
    def n_jobs(self) -> int:
        """Jobs that an executor gets. A process that does many keeps memory."""
        return self.n_workers * JOBS_EACH if self.name == "processes" else sys.maxsize

    def executor(self) -> AbstractContextManager[Executor]:
        """A new executor; what it started ends with it.

        Raises:
            InputError: Dask is missing, or there is no scheduler at the address.
        """
        if self.name == "dask":
            return _dask(self)
        return ProcessPoolExecutor(
            self.n_workers, multiprocessing.get_context("spawn"), _end_quietly
        )


class Workers:
    """Workers of an engine, which start when the first job is there, and end with this context.

    They stay from one stage of a run to the next, since a process loads libraries for some seconds.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._executor: Executor | None = None
        self._n_left = 0  # jobs that it may still get
        self._started = ExitStack()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def run(self, function: Callable[..., Any], calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
        """(number of the call, what it returned) as they end, in any order.

        A job whose worker dies is started again, and gives what it would have given.

        Raises:
            InputError: workers died too often, Dask is missing, or no scheduler answers.
        """
        if self.engine.name == "serial":
            for number, call in enumerate(calls):
                yield number, _done(function, call)
            return
        left = dict(enumerate(calls))
        n_broken = 0
        while left:
            if n_broken > RETRIES:
                raise InputError(
                    f"workers were killed {n_broken} times: is there too little memory? Try fewer"
                    " --workers, and --resume"
                )
            with _one_thread_each():
                executor, batch = self._batch(left)
                futures = {}
                try:
                    with _interrupts_wait():  # `submit` starts processes
                        for n, call in batch.items():
                            futures[executor.submit(_done, function, call)] = n
                    for future in as_completed(futures):
                        found = future.result()
                        del left[futures[future]]
                        yield futures[future], found
                except BrokenProcessPool:
                    n_broken += 1
                    self._end()
                finally:
                    for future in futures:
                        future.cancel()

    def _batch(self, left: Mapping[int, Call]) -> tuple[Executor, dict[int, Call]]:
        """An executor, and which of these jobs it gets."""
        if not self._n_left:
            self._end()
        if self._executor is None:
            self._executor = self._started.enter_context(self.engine.executor())
            self._n_left = self.engine.n_jobs
        batch = dict(islice(left.items(), self._n_left))
        self._n_left -= len(batch)
        return self._executor, batch

    def _end(self) -> None:
        self._executor = None
        self._started.close()


def _done(function: Callable[..., T], call: Call) -> T:
    """What a job returns. Its arrays, if they are in cycles, do not wait for the next one.

    The collection leaves out objects that were there before the job. If the caller has frozen some
    (`gc.freeze`), as a job around this one has, all others are collected: they stay frozen.
    """
    is_first = not gc.get_freeze_count()
    if is_first:
        gc.freeze()
    try:
        found = function(*call)
        gc.collect()
    finally:
        if is_first:
            gc.unfreeze()
    return found


def _end_quietly() -> None:
    """Ctrl-C ends a worker, as does the end of the main process, which says what is to be said."""
    threading.Thread(target=_end_with_main, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _end_with_main() -> None:
    """End this process if the main process was killed: it would wait for jobs for ever."""
    main = multiprocessing.parent_process()
    if main is not None:
        main.join()
        os._exit(1)


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Ctrl-C comes afterwards, and to processes that are started meanwhile in `_end_quietly`.

    They would print a traceback of their imports.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that are started meanwhile compute in one thread."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _dask(engine: Engine) -> Iterator[Executor]:
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("Dask is missing: pip install -e '.[cluster]'") from None
    if engine.scheduler is None:
        with (
            LocalCluster(
                n_workers=engine.n_workers,
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,  # after Ctrl-C it would say what it kills
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client.get_executor(retries=RETRIES)
        return
    try:
        client = Client(engine.scheduler, timeout="10s")
    except OSError as error:
        raise InputError(f"{engine.scheduler}: no Dask scheduler answers: {error}") from None
    with client:
        yield client.get_executor(retries=RETRIES)
