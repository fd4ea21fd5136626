"""Where jobs run: processes that are started, and Ctrl-C meanwhile."""

import pickle
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from evogs_codec.encoding.grids import TooFineError
from evogs_codec.jobs.engines import Engine, Workers
from evogs_codec.jobs.scratch import do_missing


@pytest.mark.parametrize(
    ("wrong", "words"), [({"name": "threads"}, "'threads'"), ({"workers": 0}, "workers is 0")]
)
def test_an_engine_that_there_is_not_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        Engine(**wrong)


def test_an_error_comes_back_from_a_process_as_it_was():
    error = TooFineError(2, row=1, times={2: 4.0})
    found = pickle.loads(pickle.dumps(error))
    assert (found.group, found.row, found.times) == (2, 1, {2: 4.0})


@pytest.mark.parametrize("ends", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 3, 0, 1)])
def test_of_several_tiles_that_need_coarser_steps_the_first_is_told_of(ends, tmp_path):
    returned = {0: None, 1: TooFineError(0), 2: TooFineError(1), 3: TooFineError(2)}

    class Some:
        def run(self, _, todo):
            return ((number, returned[number]) for number in ends)

    calls = [(str(tmp_path / str(number)),) for number in range(4)]
    workers: Any = Some()
    found = do_missing(workers, abs, calls, lambda *_: None, "encode")
    assert found is returned[1]


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
    with Workers(Engine(workers=1)) as workers:
        assert sorted(workers.run(abs, [(-1,), (-2,)])) == [(0, 1), (1, 2)]
    assert seen == [True, True]
    assert not blocked()


def test_workers_end_when_the_main_process_is_killed():
    code = (
        "from evogs_codec.jobs.engines import *\n"
        "from tests.support.dying_jobs import sleeps\n"
        "list(Workers(Engine(workers=1)).run(sleeps, [(600,)]))"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        process.kill()
        # The worker has the same output, which ends when both have.
        assert process.communicate(timeout=60)[0] == b""
