"""Wrong runs asked alone: a decoder may keep something from one request of a batch to the next."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from conformance.harness.judging.judging import Result
from conformance.harness.runner import Asker, Options, ask_once
from conformance.harness.running.capabilities import Capabilities
from conformance.harness.running.scratch import scratch

__all__ = ["ask_alone"]

MAX_ALONE = 8


def ask_alone(
    results: Sequence[Result],
    capabilities: Capabilities,
    golden: Callable[[str], bytes],
    options: Options,
) -> tuple[str, bool]:
    """(what can be said of a batch decoder, whether it is true of all that was asked again).

    A sample of the wrong runs is asked again, each in a batch of its own; if none of these is
    right, each without the batch protocol. Nothing is said if that changes nothing.
    """
    wrong = [one for one in results if one.failed and one.answer.trouble != "timeout"]
    if not options.batch or not wrong:
        return "", False
    sample = random.Random(options.seed).sample(wrong, min(MAX_ALONE, len(wrong)))

    def right(make: Callable[[], Asker]) -> int:
        n = 0
        with scratch() as folder:
            for result in sample:
                asker = make()
                again = ask_once(asker, result.case, folder, capabilities, golden, options)
                asker.close()
                n += not again.failed
        return n

    n_right = right(lambda: options.asker(options.seed))
    if n_right:
        is_all = n_right == len(sample)
        return (
            f"{n_right} of {len(sample)} wrong runs are right when each is the first request of"
            " its process: the decoder keeps something from one request to the next"
            + ("" if is_all else ", or answers by chance")
            + " (--no-batch asks one run per process)"
        ), is_all
    n_right = right(options.one_shot)
    if n_right:
        return (
            f"{n_right} of {len(sample)} wrong runs are right with one process per run"
            " (--no-batch): what is wrong is in the batch mode"
        ), n_right == len(sample)
    return "", False
