"""The report as JUnit XML, for build servers: a suite per family, a test per vector."""

from __future__ import annotations

import re
from collections.abc import Iterable
from xml.etree import ElementTree

from conformance.harness.judging import Result
from conformance.harness.trial import Trial

__all__ = ["as_junit"]

NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def as_junit(trial: Trial) -> str:
    """The report as text. What is wrong with the trial as a whole is a suite of its own."""
    root = ElementTree.Element("testsuites", name="evogs-conformance")
    families: dict[str, dict[str, list[Result]]] = {}
    for result in [*trial.results, *trial.again]:
        vector = result.case.vector
        families.setdefault(vector.family, {}).setdefault(vector.id, []).append(result)
    for family, vectors in sorted(families.items()):
        _add_suite(root, family, vectors)
    _add_trial(root, trial)
    for name in ("tests", "failures", "errors", "skipped"):
        root.set(name, str(sum(int(suite.get(name, "0")) for suite in root)))
    root.set("time", f"{trial.seconds:.3f}")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_suite(root: ElementTree.Element, family: str, vectors: dict[str, list[Result]]) -> None:
    suite = ElementTree.SubElement(root, "testsuite", name=family)
    n_failures = n_skipped = 0
    for name, results in vectors.items():
        seconds = sum(result.answer.seconds for result in results)
        test = ElementTree.SubElement(
            suite, "testcase", classname=f"evogs.{family}", name=name, time=f"{seconds:.3f}"
        )
        wrong = [result for result in results if result.failed]
        if wrong:
            n_failures += 1
            says = f"{wrong[0].kind}: {wrong[0].says}"
            failure = ElementTree.SubElement(
                test, "failure", type=wrong[0].kind, message=_clean(says)
            )
            failure.text = _clean("\n".join(_lines(wrong)))
        elif all(result.kind == "skipped" for result in results):
            n_skipped += 1
            ElementTree.SubElement(test, "skipped", message=_clean(results[0].says))
    counts = {"tests": len(vectors), "failures": n_failures, "errors": 0, "skipped": n_skipped}
    for key, count in counts.items():
        suite.set(key, str(count))


def _add_trial(root: ElementTree.Element, trial: Trial) -> None:
    errors = [*trial.failures, *trial.incomplete]
    suite = ElementTree.SubElement(root, "testsuite", name="trial")
    test = ElementTree.SubElement(suite, "testcase", classname="evogs.trial", name="complete")
    if errors:
        element = ElementTree.SubElement(test, "error", type="trial", message=_clean(errors[0]))
        element.text = _clean("\n".join(errors))
    for key, count in (("tests", 1), ("failures", 0), ("errors", len(errors[:1])), ("skipped", 0)):
        suite.set(key, str(count))


def _lines(results: list[Result]) -> Iterable[str]:
    vector = results[0].case.vector
    yield f"tests: {vector.tests}"
    yield f"requirements: {', '.join(vector.requirements)}"
    for result in results:
        yield f"{result.case.id} ({result.case.run.options()}): {result.kind}: {result.says}"


def _clean(text: str) -> str:
    """Without characters that XML cannot hold: some of the text comes from the decoder."""
    return NOT_XML.sub("\ufffd", text)
