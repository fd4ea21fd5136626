"""Waiting for servers in threads of its own, so that Ctrl-C is heard meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import TypeVar

__all__ = ["apart", "each_apart"]

Item = TypeVar("Item")
Result = TypeVar("Result")


def each_apart(
    call: Callable[[Item], Result], items: Sequence[Item], n_threads: int
) -> Iterator[Result]:
    """`call(item)` of each, in the order in which they are done.

    A thread that waits in a library cannot be interrupted, the one that waits here can: after an
    interrupt, as after an error, no new item is begun and the program may end. Not
    `ThreadPoolExecutor`: a program waits for its threads in the end.
    """
    waiting: SimpleQueue[Item] = SimpleQueue()
    done: SimpleQueue[tuple[Result, None] | tuple[None, BaseException]] = SimpleQueue()
    stopped = Event()
    for item in items:
        waiting.put(item)

    def work() -> None:
        while not stopped.is_set():
            try:
                item = waiting.get_nowait()
            except Empty:
                return
            try:
                done.put((call(item), None))
            except BaseException as error:
                stopped.set()
                done.put((None, error))

    for _ in range(min(n_threads, len(items))):
        Thread(target=work, name="evogs-fetch", daemon=True).start()
    try:
        for _ in items:
            result, error = done.get()
            if error is not None:
                raise error
            yield result  # type: ignore[misc]  # without an error there is one
    finally:
        stopped.set()


def apart(call: Callable[[], Result]) -> Result:
    """`call()`, which Ctrl-C can interrupt."""
    return next(each_apart(lambda _: call(), [None], 1))
