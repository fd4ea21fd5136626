"""The report as one HTML page that needs nothing else: a summary, and every run, to be filtered.

What the decoder said is data from a stranger: it is made plain, enters the page as JSON, and is
shown as text.
"""

from __future__ import annotations

import html
import json
from typing import Any

from conformance.harness.reporting.report import as_dict
from conformance.harness.reporting.table import trial_line
from conformance.harness.running.plain import MOST_OF_LINE, plain, plain_all
from conformance.harness.trial import Trial

__all__ = ["as_html"]


def as_html(trial: Trial) -> str:
    """The page."""
    report = as_dict(trial)
    state = {0: "pass", 1: "fail"}.get(trial.exit, "incomplete")
    says = {"pass": "The decoder is right", "fail": "The decoder is not right"}
    title = says.get(state, "Nothing can be said about the decoder")
    return PAGE.format(
        title=html.escape(title),
        state=state,
        style=STYLE,
        line=_text(trial_line(trial)),
        command=_text(" ".join(trial.options.command)),
        messages=_messages(trial, report),
        families=_families(report["summary"]["families"]),
        requirements=_requirements(report["requirements"]),
        data=_embedded(_rows(trial, report)),
        script=SCRIPT,
        name=_text(trial.capabilities.name if trial.capabilities else "?"),
    )


def _messages(trial: Trial, report: dict[str, Any]) -> str:
    lines = [("like", text) for text in trial.diagnosis.sentences()]
    lines += [("bad", text) for text in trial.failures]
    lines += [("bad", f"incomplete: {text}") for text in trial.incomplete]
    lines += [("", note) for note in trial.notes]
    lines += [("good", report["claim"])] if report["claim"] else []
    return "".join(f'<p class="{kind}">{_text(text)}</p>\n' for kind, text in lines)


def _families(families: dict[str, dict[str, int]]) -> str:
    rows = []
    for family, counts in families.items():
        n, n_pass = sum(counts.values()), counts.get("pass", 0)
        n_skipped, n_not_asked = counts.get("skipped", 0), counts.get("not asked", 0)
        n_wrong = n - n_pass - n_skipped - n_not_asked
        state = "bad" if n_wrong else "good" if n_pass else ""
        cells = f"<td>{n}<td>{n_pass}<td>{n_skipped}<td>{n_not_asked}<td>{n_wrong}"
        rows.append(f'<tr class="{state}"><th>{_text(family)}{cells}</tr>')
    return "\n".join(rows)


def _requirements(states: dict[str, str]) -> str:
    kinds = {"pass": "good", "fail": "bad", "untested": ""}
    return "\n".join(
        f'<button class="{kinds[state]}" data-find="{_text(requirement)}">'
        f"{_text(requirement)}</button>"
        for requirement, state in states.items()
    )


def _rows(trial: Trial, report: dict[str, Any]) -> list[list[str]]:
    rows = []
    for result, entry in zip(
        [*trial.results, *trial.again], [*report["results"], *report["again"]], strict=True
    ):
        vector = result.case.vector
        needs = " ".join(vector.requirements)
        about = "" if result.kind == "pass" else f"{vector.tests} A faulty one: {vector.faulty}"
        rows.append([entry["kind"], entry["id"], entry["asked"], entry["says"], needs, about])
    return [plain_all(row) for row in rows]


def _text(text: str) -> str:
    return html.escape(plain(text, MOST_OF_LINE))


def _embedded(value: object) -> str:
    """JSON that cannot end the element it stands in."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}: {name}</title>
<style>{style}</style>
<h1 class="{state}">{title}</h1>
<p>{line}<br><code>{command}</code></p>
{messages}
<details open><summary>Families</summary>
<table><tr><th>family<th>runs<th>pass<th>skipped<th>not asked<th>wrong</tr>
{families}
</table></details>
<details><summary>Requirements (a click shows the runs)</summary>
<p class="tags">{requirements}</p></details>
<h2>Runs</h2>
<p><input id="find" type="search" placeholder="id, requirement or text" size="40">
<label><input id="wrong" type="checkbox" checked> only what is wrong</label>
<span id="count"></span></p>
<table id="runs"><tr><th>verdict<th>run<th>asked<th>what came<th>requirements</tr></table>
<script type="application/json" id="data">{data}</script>
<script>{script}</script>
</html>
"""

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem;
  color: #1b1f24; background: #fff }
h1.pass { color: #116329 } h1.fail, h1.incomplete { color: #b02a1d }
table { border-collapse: collapse; width: 100% }
td, th { text-align: left; vertical-align: top; padding: .2rem .6rem;
  border-bottom: 1px solid #ddd }
.good > th, .good { color: #116329 } .bad > th, .bad, td.bad { color: #b02a1d }
.like { background: #fff4d6; padding: .5rem .8rem; border-left: 4px solid #d4a72c }
.tags button { margin: .1rem; font: inherit; font-size: 13px; cursor: pointer }
code, #runs td:nth-child(2) { font-family: ui-monospace, monospace; font-size: 13px }
summary { cursor: pointer; font-weight: 600; margin: .8rem 0 .3rem } small { color: #59636e }
@media (prefers-color-scheme: dark) {
  body { color: #e6e9ed; background: #14171a } td, th { border-color: #333 }
  h1.pass, .good > th, .good { color: #57c07a }
  h1.fail, h1.incomplete, .bad > th, .bad, td.bad { color: #ff8d80 }
  .like { background: #3a3013 } small { color: #9aa4af } }
"""

SCRIPT = """
const MOST = 500;
const rows = JSON.parse(document.getElementById('data').textContent);
const find = document.getElementById('find'), wrong = document.getElementById('wrong');
const table = document.getElementById('runs'), count = document.getElementById('count');
const isWrong = row => !['pass', 'skipped', 'not asked'].includes(row[0]);
if (!rows.some(isWrong)) wrong.checked = false;
function show() {
  const words = find.value.toLowerCase().split(/\\s+/).filter(Boolean);
  const chosen = rows.filter(row => (!wrong.checked || isWrong(row))
    && words.every(word => row.some(cell => cell.toLowerCase().includes(word))));
  while (table.rows.length > 1) table.deleteRow(1);
  for (const row of chosen.slice(0, MOST)) {
    const line = table.insertRow();
    row.slice(0, 5).forEach((text, k) => {
      const cell = line.insertCell();
      cell.textContent = text;
      if (k === 0) cell.className = isWrong(row) ? 'bad' : 'good';
      if (k === 3 && row[5]) {
        const note = document.createElement('small');
        note.textContent = row[5];
        cell.append(document.createElement('br'), note);
      }
    });
  }
  count.textContent = chosen.length + ' of ' + rows.length + ' runs'
    + (chosen.length > MOST ? ', the first ' + MOST + ' shown' : '');
}
find.addEventListener('input', show);
wrong.addEventListener('change', show);
document.querySelectorAll('[data-find]').forEach(button => button.addEventListener('click', () => {
  find.value = button.dataset.find; wrong.checked = false; show(); find.scrollIntoView();
}));
show();
"""
