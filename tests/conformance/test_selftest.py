"""Bad decoders get the verdict that is written down for them."""

import json
import os
import time
from pathlib import Path

import pytest

from conformance.harness.manifest import SuiteError
from conformance.harness.selftest import BAD, CLASSES, self_test

TABLE = json.loads((BAD / "expected.json").read_text(encoding="utf-8"))
# One of each kind; all of them take a minute.
QUICK = [
    *("right in batches", "modest", "accept-all", "by-heart", "by-surroundings"),
    *("changed-by-a-fault", "nothing-beside-a-fault", "of-before-dump-on-fault"),
    *("last-off-by-one", "crash-after-success", "sleeps-at-the-end", "memory-hog", "noise"),
    *("huge-output", "wrong-ids", "stale-output", "says-not-what-it-can"),
    *("hides-its-memory", "leaves-a-hopper", "huge-output-below", "pipes-for-files"),
    *("strange-name-and-codes", "strange-last-words", "deep-json", "stale-verdict", "banner"),
]


@pytest.mark.parametrize(
    "name", [QUICK[0], *(pytest.param(name, marks=pytest.mark.thorough) for name in QUICK[1:])]
)
def test_a_bad_decoder_is_judged_as_written(made_suite, name):
    (judged,) = self_test(made_suite, names=[name])
    assert not judged.problems


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(TABLE) - set(QUICK)))
def test_every_other_bad_decoder_is_judged_as_written(made_suite, name):
    (judged,) = self_test(made_suite, names=[name])
    assert not judged.problems


def test_there_are_bad_decoders_of_every_sort_and_each_verdict_is_a_failure():
    assert len(TABLE) >= 75
    assert all(entry["says"] for entry in TABLE.values())
    assert [name for name, entry in TABLE.items() if entry.get("exit") == 0] == [
        *("right", "right in batches", "modest", "of-before-dump-on-fault", "leaves-a-process"),
        *("strange-name", "leaves-a-daemon", "leaves-a-hopper"),
    ]


def test_a_wrong_table_is_found_out(made_suite, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "conformance.harness.selftest.BAD", _copied(tmp_path, {"accepted": ["pass"]})
    )
    (judged,) = self_test(made_suite, names=["accept-all"])
    assert any("accepted: wrong dump, should be pass" in problem for problem in judged.problems)


def _copied(folder, entry):
    """A folder of bad decoders with another table."""
    for path in BAD.glob("*.py"):
        text = path.read_text().replace("parents[3]", f"parents[0] / {str(BAD.parents[2])!r}")
        (folder / path.name).write_text(text)
    (folder / "expected.json").write_text(json.dumps({"accept-all": {"says": "x"} | entry}))
    return folder


def test_the_self_test_needs_runs_of_every_class(suite_folder):
    told = json.loads((suite_folder / "manifest.json").read_text())
    told["vectors"] = [entry for entry in told["vectors"] if entry["id"] != "critical-chunk"]
    (suite_folder / "manifest.json").write_text(json.dumps(told))
    with pytest.raises(SuiteError, match="unsupported"):
        list(self_test(suite_folder, names=["right"]))
    assert "unsupported" in CLASSES
    with pytest.raises(SuiteError, match="no bad decoder"):
        list(self_test(suite_folder, names=["best"]))


@pytest.mark.thorough
@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="looks at processes in /proc")
@pytest.mark.parametrize("name", ["leaves-a-process", "burns-processors"])
def test_no_process_of_a_bad_decoder_survives(made_suite, name):
    list(self_test(made_suite, names=[name]))
    deadline = time.monotonic() + 5
    while _left() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _left()


def _left():
    """Command lines of what bad decoders start."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        is_ours = b"-I" in words and any(b"import time" in word for word in words)
        if entry.name.isdigit() and int(entry.name) != os.getpid() and is_ours:
            found.append(words)
    return found
