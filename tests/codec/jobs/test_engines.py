"""Where jobs run: processes that are started, and Ctrl-C meanwhile."""

import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from evogs_codec.jobs.engines import Engine, run_jobs


def blocked():
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks of signals here")
def test_processes_are_started_while_ctrl_c_waits(monkeypatch):
    seen = []

    class Executor(ThreadPoolExecutor):
        def submit(self, *given, **named):
            seen.append(blocked())
            return super().submit(*given, **named)

    monkeypatch.setattr(Engine, "executor", lambda _: Executor(1))
    assert sorted(run_jobs(Engine(workers=1), abs, [(-1,), (-2,)])) == [(0, 1), (1, 2)]
    assert seen == [True, True]
    assert not blocked()
