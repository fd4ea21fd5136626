"""The report as JUnit XML, for build servers: a suite per family, a test per vector."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from conformance.harness.judging.judging import Result
from conformance.harness.running.plain import MOST_OF_LINE, plain, plain_lines
from conformance.harness.trial import Trial

__all__ = ["as_junit"]


def as_junit(trial: Trial) -> str:
    """The report as text. What is wrong with the trial as a whole is a suite of its own.

    All text in it is plain: XML has no way to hold other characters.
    """
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
    for element in root.iter():
        element.attrib = {key: plain(value, MOST_OF_LINE) for key, value in element.items()}
        element.text = plain_lines(element.text) if element.text else None
    ElementTree.indent(root)
    raw: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return raw.decode() + "\n"


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
            failure = ElementTree.SubElement(test, "failure", type=wrong[0].kind, message=says)
            failure.text = "\n".join(_lines(wrong))
        elif not any(result.judged for result in results):
            n_skipped += 1
            ElementTree.SubElement(test, "skipped", message=results[0].says)
    counts = {"tests": len(vectors), "failures": n_failures, "errors": 0, "skipped": n_skipped}
    for key, count in counts.items():
        suite.set(key, str(count))


def _add_trial(root: ElementTree.Element, trial: Trial) -> None:
    errors = [*trial.failures, *trial.incomplete]
    suite = ElementTree.SubElement(root, "testsuite", name="trial")
    test = ElementTree.SubElement(suite, "testcase", classname="evogs.trial", name="complete")
    if errors:
        element = ElementTree.SubElement(test, "error", type="trial", message=errors[0])
        element.text = "\n".join(errors)
    for key, count in (("tests", 1), ("failures", 0), ("errors", len(errors[:1])), ("skipped", 0)):
        suite.set(key, str(count))


def _lines(results: list[Result]) -> Iterable[str]:
    vector = results[0].case.vector
    yield f"tests: {vector.tests}"
    yield f"requirements: {', '.join(vector.requirements)}"
    for result in results:
        yield f"{result.case.id} ({result.case.run.options()}): {result.kind}: {result.says}"
