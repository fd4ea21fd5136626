"""Reports of a run: a table for the terminal, JSON, one HTML page, pictures of differences."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conformance.harness.running.plain import MOST_OF_LINE, plain, plain_all, plain_lines
from conformance.harness.trial import FAILED, INCOMPLETE, PASSED
from conformance.renders.candidate import Result
from conformance.renders.judging import read_golden, side_by_side
from conformance.renders.manifest import Suite
from conformance.renders.png import encode_png

__all__ = ["Run", "as_html", "as_json", "as_text", "write_pictures"]


@dataclass(frozen=True, eq=False)
class Run:
    """Everything that was asked of a renderer and what came of it.

    Attributes:
        suite: the images.
        command: of the renderer.
        results: one per image.
        alike: sentences about known mistakes that fail in the same way.
        is_all: all images of the suite were asked for.
    """

    suite: Suite
    command: Sequence[str]
    results: Sequence[Result]
    alike: Sequence[str]
    is_all: bool

    @property
    def exit(self) -> int:
        """0: right; 1: wrong; 3: nothing can be said, because too little was rendered."""
        if any(result.failed for result in self.results):
            return FAILED
        return PASSED if self._says_something() else INCOMPLETE

    @property
    def conclusion(self) -> str:
        """The verdict, in a sentence."""
        n_failed = sum(result.failed for result in self.results)
        n_unsupported = sum(result.kind == "unsupported" for result in self.results)
        if self.exit == FAILED:
            return f"FAIL: {n_failed} of {len(self.results)} pictures are wrong"
        if self.exit == INCOMPLETE:
            return "INCOMPLETE: nothing was asked, or something required is not supported"
        note = f"; {n_unsupported} that need the antialiased mode left out" if n_unsupported else ""
        what = "" if self.is_all else " of this selection"
        return f"PASS: all {len(self.results) - n_unsupported} pictures{what} are right{note}"

    def _says_something(self) -> bool:
        """Only the antialiased mode may be left out, and not everything."""
        kinds = {result.kind for result in self.results}
        left_out = (r for r in self.results if r.kind == "unsupported")
        return "pass" in kinds and all(
            self.suite.scenes[result.image.scene].antialiased for result in left_out
        )


def as_text(run: Run) -> str:
    """The report for a terminal: a line per scene, the failures, the conclusion."""
    width = max((len(scene) for scene in run.suite.scenes), default=5)
    lines = [f"{'scene':{width}}  images  pass  worst error (limit), 1/255     least PSNR (limit)"]
    for scene, results in _by_scene(run):
        n_pass = sum(result.kind == "pass" for result in results)
        line = f"{scene:{width}}  {len(results):6}  {n_pass:4}"
        judged = [result for result in results if result.numbers]
        if judged:
            worst = max(judged, key=lambda r: r.numbers.error)  # type: ignore[union-attr]
            least = min(judged, key=lambda r: r.numbers.psnr)  # type: ignore[union-attr]
            assert worst.numbers is not None
            assert least.numbers is not None
            limit = worst.image.thresholds
            line += f"  {255 * worst.numbers.error:11.3f} ({255 * limit.max_error:.2f})"
            line += f"  {least.numbers.psnr:22.2f} ({limit.min_psnr:g}) dB"
        lines.append(line)
    for result in run.results:
        if result.failed:
            scene_ = run.suite.scenes[result.image.scene]
            lines += [
                f"{result.kind.upper()} {result.image.id}: {result.says}",
                f"    tests: {scene_.tests}",
                f"    a wrong renderer: {scene_.faulty}",
            ]
    return plain_lines("\n".join([*lines, *run.alike, run.conclusion]))


def as_json(run: Run) -> str:
    """The report as JSON."""
    return json.dumps(plain_all(_as_dict(run)), indent=1) + "\n"


def as_html(run: Run) -> str:
    """The report as one page that needs nothing else, with pictures of what fails."""
    state = {PASSED: "pass", FAILED: "fail"}.get(run.exit, "incomplete")
    return PAGE.format(
        style=STYLE,
        state=state,
        conclusion=html.escape(run.conclusion),
        command=html.escape(plain(" ".join(run.command), MOST_OF_LINE)),
        alike="".join(f'<p class="like">{html.escape(text)}</p>\n' for text in run.alike),
        rows="\n".join(_row(run.suite, result) for result in run.results),
    )


def write_pictures(run: Run, folder: Path) -> list[Path]:
    """Golden, candidate and difference of every image that fails; the files."""
    paths = []
    for result in run.results:
        if result.failed:
            folder.mkdir(parents=True, exist_ok=True)
            paths.append(folder / f"{result.image.id}.png")
            paths[-1].write_bytes(_picture(run.suite, result))
    return paths


def _by_scene(run: Run) -> Iterable[tuple[str, list[Result]]]:
    for scene in run.suite.scenes:
        results = [result for result in run.results if result.image.scene == scene]
        if results:
            yield scene, results


def _as_dict(run: Run) -> dict[str, Any]:
    return {
        "suite": run.suite.sha256,
        "renderer": list(run.command),
        "exit": run.exit,
        "conclusion": run.conclusion,
        "alike": list(run.alike),
        "complete": run.is_all,
        "results": [_result(result) for result in run.results],
    }


def _result(result: Result) -> dict[str, Any]:
    numbers = result.numbers
    return {
        "id": result.image.id,
        "kind": result.kind,
        "says": result.says,
        "seconds": round(result.seconds, 3),
        **(
            {}
            if numbers is None
            else {
                "max_error": round(numbers.error, 6),
                "at": numbers.at,
                "n_over": numbers.n_over,
                "n_doubtful_over": numbers.n_doubtful_over,
                "psnr": _finite(numbers.psnr),
                "level_psnr": _finite(numbers.level_psnr),
            }
        ),
    }


def _finite(value: float | None) -> float | None:
    """JSON has no infinity."""
    return None if value is None or math.isinf(value) else round(value, 3)


def _row(suite: Suite, result: Result) -> str:
    numbers, scene = result.numbers, suite.scenes[result.image.scene]
    cells = [result.kind, result.image.id]
    if numbers is None:
        cells += ["", "", ""]
    else:
        cells += [f"{255 * numbers.error:.3f}", str(numbers.n_over), f"{numbers.psnr:.2f}"]
    row = "".join(f"<td>{html.escape(cell)}" for cell in cells)
    about = html.escape(plain(result.says, MOST_OF_LINE))
    if result.failed:
        data = base64.b64encode(_picture(suite, result)).decode()
        about += f"<br><small>{html.escape(scene.tests)} A wrong one: {html.escape(scene.faulty)}"
        about += f'</small><br><img alt="" src="data:image/png;base64,{data}">'
    return f'<tr class="{result.kind.replace(" ", "-")}">{row}<td>{about}'


def _picture(suite: Suite, result: Result) -> bytes:
    return encode_png(side_by_side(read_golden(suite, result.image), result.pixels))


PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Render conformance: {state}</title>
<style>{style}</style>
<h1 class="{state}">{conclusion}</h1>
<p><code>{command}</code></p>
{alike}<p>Pictures: golden, candidate, 16 times their difference (doubtful pixels grey).</p>
<table><tr><th>verdict<th>image<th>worst error, 1/255<th>pixels over<th>PSNR, dB<th>what came</tr>
{rows}
</table>
</html>
"""

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem;
  color: #1b1f24; background: #fff }
table { border-collapse: collapse; width: 100% }
td, th { text-align: left; vertical-align: top; padding: .2rem .6rem;
  border-bottom: 1px solid #ddd }
.like { background: #fff4d6; padding: .5rem .8rem; border-left: 4px solid #d4a72c }
img { image-rendering: pixelated; max-width: 100% } code { font-size: 13px }
h1.pass, .pass > td:first-child { color: #116329 }
h1.fail, h1.incomplete, .fail > td:first-child, .no-picture > td:first-child { color: #b02a1d }
@media (prefers-color-scheme: dark) {
  body { color: #e6e9ed; background: #14171a } td, th { border-color: #333 }
  h1.pass, .pass > td:first-child { color: #57c07a } .like { background: #3a3013 }
  h1.fail, h1.incomplete, .fail > td:first-child, .no-picture > td:first-child { color: #ff8d80 } }
"""
