"""A run of the suite: every case to the decoder under test, and all that makes it a fair trial."""

from __future__ import annotations

import errno
import json
import os
import queue
import random
import secrets
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from conformance.harness.judging.judging import EXPECTED, Result, judge
from conformance.harness.manifest import Case, Run, SuiteError
from conformance.harness.running.answers import Answer, Parcel
from conformance.harness.running.batch import Batch
from conformance.harness.running.capabilities import Capabilities, lacking, not_asked
from conformance.harness.running.oneshot import OneShot
from conformance.harness.running.plain import plain
from conformance.harness.running.process import Bounds, clean_environment
from conformance.harness.running.scratch import read_regular, scratch

__all__ = ["Asked", "Asker", "Options", "ask_again", "ask_once", "own_fault", "run_cases"]

# Runs after which the rest is not asked, if all of them failed alike.
N_ALIKE, N_ALIKE_HANGS = 12, 4
# What is no fault of a decoder: the disk is full, there are no more file numbers.
OURS = (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE)
# Two surroundings in which a decoder is asked again: nothing of them may show in its answer.
SURROUNDINGS = (
    {"LC_ALL": "C", "LANG": "C", "TZ": "Pacific/Auckland", "PYTHONHASHSEED": "1"},
    {
        "LC_ALL": "de_DE.UTF-8",
        "LANG": "de_DE.UTF-8",
        "TZ": "America/St_Johns",
        "PYTHONHASHSEED": "2",
        "OMP_NUM_THREADS": "1",
        "EVOGS_UNRELATED": "x" * 4096,
    },
)

NOT_ASKED = "the decoder does not declare dump_on_fault"


class Asker(Protocol):
    """One way to ask a decoder."""

    def ask(self, parcel: Parcel, environment: dict[str, str]) -> Answer:
        """The answer to a run."""

    def close(self) -> None:
        """Leave nothing running."""


@dataclass(frozen=True)
class Options:
    """How the decoder is asked.

    Attributes:
        command: the decoder under test.
        bounds: of each run.
        jobs: how many processes at a time.
        batch: ask many runs in one process.
        seed: of everything drawn by chance.
        passed: names of environment variables that the decoder sees.
        patience: hangs after which the rest is not run.
        n_again: runs that are asked again in other surroundings.
    """

    command: Sequence[str]
    bounds: Bounds = field(default_factory=Bounds)
    jobs: int = field(default_factory=lambda: os.cpu_count() or 1)
    batch: bool = True
    seed: int = 0
    passed: Sequence[str] = ()
    patience: int = 25
    n_again: int = 12

    def asker(self, seed: int) -> Asker:
        """A way to ask, as the options say."""
        return Batch(self.command, self.bounds, seed) if self.batch else self.one_shot()

    def one_shot(self) -> Asker:
        """A process per run."""
        return OneShot(self.command, self.bounds)


@dataclass(frozen=True)
class Asked:
    """What came of many runs.

    Attributes:
        results: in the order of the cases, those not run left out.
        ended: why some were not run; "" if all were.
    """

    results: list[Result]
    ended: str


def run_cases(
    cases: Sequence[Case],
    capabilities: Capabilities,
    golden: Callable[[str], bytes],
    options: Options,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> Asked:
    """Ask the decoder every case, unless it hangs too often or fails always alike.

    The order of asking is drawn by chance, so that a decoder cannot lean on what came before.

    Raises:
        SuiteError: a golden is missing.
    """
    order = list(range(len(cases)))
    random.Random(options.seed).shuffle(order)
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number in order:
        waiting.put(number)
    results: dict[int, Result] = {}
    troubles: list[str] = []
    ends: list[str] = []
    errors: list[BaseException] = []

    def work(worker: int, root: Path) -> None:
        asker = options.asker(options.seed + worker)
        case = None
        try:
            while not ends and not errors:
                number = waiting.get_nowait()
                case = cases[number]
                if not_asked(capabilities, case):
                    results[number] = Result(case, Answer(None), "not asked", NOT_ASKED)
                    continue
                result = ask_once(asker, case, root, capabilities, golden, options)
                results[number] = result
                troubles.append(result.answer.trouble)
                progress(len(results), len(cases))
                if len(results) < len(cases) and (why := _why_end(troubles, result, options)):
                    ends.append(why)
        except queue.Empty:
            pass
        except SuiteError as error:  # raised again where the results are read
            errors.append(error)
        except Exception as error:  # the results so far are not lost
            ends.append(own_fault(error, case))
        finally:
            asker.close()

    with scratch() as folder:
        workers = [
            threading.Thread(target=work, args=(worker, folder / str(worker)), daemon=True)
            for worker in range(max(1, min(options.jobs, len(cases))))
        ]
        for thread in workers:
            thread.start()
        try:
            for thread in workers:
                thread.join()
        except BaseException as error:  # an interrupt: the workers end what they started
            errors.append(error)
            for thread in workers:
                thread.join()
    if errors:
        raise errors[0]
    return Asked([results[number] for number in sorted(results)], ends[0] if ends else "")


def ask_once(
    asker: Asker,
    case: Case,
    root: Path,
    capabilities: Capabilities,
    golden: Callable[[str], bytes],
    options: Options,
) -> Result:
    """Ask a case and judge the answer; `root` is a folder for its files."""
    answer = _ask(asker, case, root, clean_environment(root, options.passed))
    missing = lacking(capabilities, case)
    return judge(case, answer, missing, golden, codes=capabilities.codes)


def ask_again(results: Sequence[Result], options: Options) -> tuple[int, list[Result]]:
    """Ask a sample again, a process per run, in two other surroundings.

    Returns:
        How many runs were asked again, and those that differed.

    With the batch protocol, this also holds the two ways of asking against each other.
    """
    sample = [result for result in results if result.kind != "not asked"]
    sample = [result for result in sample if not result.answer.trouble]
    sample = random.Random(options.seed).sample(sample, min(options.n_again, len(sample)))
    asker, found = options.one_shot(), []
    with scratch() as root:
        for result in sample:
            for surroundings in SURROUNDINGS:
                environment = clean_environment(root, options.passed) | surroundings
                again = _ask(asker, result.case, root, environment)
                if not again.same_as(result.answer):
                    says = _how_they_differ(result.answer, again)
                    found.append(Result(result.case, again, "nondeterministic", says))
                    break
    asker.close()
    return len(sample), found


def _why_end(troubles: Sequence[str], result: Result, options: Options) -> str:
    """Why the rest need not be asked; "" if it must."""
    n = len(troubles)
    if troubles.count("timeout") >= options.patience:
        return f"given up after {options.patience} hangs"
    if n >= (N_ALIKE_HANGS if result.kind == "timeout" else N_ALIKE) and set(troubles) == {
        result.kind
    }:
        return (
            f"ended early, because all of the first {n} runs failed alike ({result.kind});"
            f" seen: {result.says}; expected: {EXPECTED[result.kind]}"
        )
    return ""


def own_fault(error: Exception, case: Case | None = None) -> str:
    """The harness itself failed: where and how, in a line."""
    frames = traceback.extract_tb(error.__traceback__)
    at = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    on = "" if case is None else f" on {case.id}"
    return plain(f"the harness failed{on}: {type(error).__name__} in {at}: {error}")


def _ask(asker: Asker, case: Case, root: Path, environment: dict[str, str]) -> Answer:
    """Put the files of a run into a fresh folder and ask; nothing of it stays."""
    try:
        root.mkdir(exist_ok=True)
        with scratch(root, prefix="") as folder:
            parcel = _parcel(case.run, case.data, folder)
            answer = asker.ask(parcel, environment)
            if not answer.trouble and read_regular(parcel.source, len(case.data)) != case.data:
                return replace(answer, trouble="output", detail="the input file was changed")
            return answer
    except OSError as error:
        if error.errno in OURS:
            raise
        says = f"the files of the run cannot be used, or the decoder not be started: {error}"
        return Answer(None, trouble="output", detail=plain(says))


def _parcel(run: Run, data: bytes, folder: Path) -> Parcel:
    def name() -> Path:
        return folder / secrets.token_hex(8)

    def put(content: bytes) -> Path:
        path = name()
        path.write_bytes(content)
        return path

    home = name()
    home.mkdir()
    return Parcel(
        home=home,
        source=put(data),
        target=name(),
        mode=run.mode,
        level=run.level,
        verify=run.verify,
        limits=None if run.limits is None else put(json.dumps(dict(run.limits)).encode()),
        arrival=None if run.arrival is None else put(json.dumps(run.arrival).encode()),
        dump_on_fault=run.dump_on_fault,
    )


def _how_they_differ(first: Answer, again: Answer) -> str:
    if again.trouble:
        return f"asked again: {again.trouble}, {again.detail}"
    for name in ("exit", "code", "offset"):
        before, after = getattr(first, name), getattr(again, name)
        if before != after:
            return f"asked again in other surroundings: {name} {after}, {before} before"
    before, after = len(first.output or b""), len(again.output or b"")
    return f"asked again in other surroundings: another dump ({after} bytes, {before} before)"
