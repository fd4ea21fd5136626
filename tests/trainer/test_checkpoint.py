"""Checkpoints: a run goes on from a whole one that is its own; anything else is refused."""

import hashlib
import itertools
import os
import random
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from evogs_codec import InputError
from reference_trainer.config import Integers
from reference_trainer.methods.base import Done
from reference_trainer.models.backends import backend_for
from reference_trainer.run import run
from reference_trainer.runtime.checkpoint import FILE, SEAL, SEAL_SIZE, Checkpoint
from tests.support import damaged_files as damage
from tests.trainer import tiny
from tests.trainer.stopping import StoppedError, StopsAt

# Method, part in integers, iterations before it stops: levels and stages of every kind.
RUNS = {
    "cloud": ("evogs", 0, 25),
    "between stages": ("evogs", 0, 42),
    "frontier": ("evogs", 0, 75),
    "integers": ("evogs", 0.5, 115),
    "mixed": ("evogs-mixed", 0.5, 90),
    "second attempt": ("evogs-mixed", 0.5, 145),
    "second attempt in integers": ("evogs-mixed", 0.5, 175),
    "residuals": ("evogs-b", 0, 75),
    "opacities": ("lapis", 0, 75),
    "splats to spare": ("l3gs", 0, 65),
}
DAMAGES = [
    damage.flipped,
    damage.flipped,
    damage.cut_short,
    damage.with_flipped_structure,
    damage.with_edited_header,
    damage.with_flipped_arrays,
    damage.with_edited_names,
]


def config_of(name):
    method, part, _ = RUNS[name]
    changed = tiny.config(method=method, integers=Integers(part))
    if name.startswith("second attempt"):
        changed = replace(changed, frontier=replace(changed.frontier, refines_first=None))
    return changed


def go_on(name, folder, n=0):
    """Take a run up from the checkpoint in `folder`, for `n` iterations."""
    with pytest.raises(StoppedError):
        run(
            config_of(name),
            tiny.pyramid(),
            backend_for("cpu"),
            folder=folder,
            resume=True,
            progress=StopsAt(n),
        )


@cache
def checkpoint(name):
    """The bytes of a checkpoint."""
    with TemporaryDirectory() as folder:
        go_on(name, Path(folder), RUNS[name][2])
        return (Path(folder) / FILE).read_bytes()


def sealed(data):
    """`data` with the seal that belongs to it."""
    return data + SEAL + hashlib.sha256(data).hexdigest().encode() + b"\n"


def said_of(function, *arguments):
    """The message of the InputError that a function raises, or None."""
    try:
        function(*arguments)
    except InputError as error:
        return str(error)
    return None


def check_damaged(folder, n, random_):
    """Damaged ones are refused, except where the damage changed nothing."""
    path, counts = folder / FILE, Counter[str]()
    for _ in range(n):
        name, change = random_.choice(list(RUNS)), random_.choice(DAMAGES)
        data = change(checkpoint(name), random_)
        path.write_bytes(data)
        said = said_of(Checkpoint.read, folder)
        if said is None:
            assert data == checkpoint(name), change
        else:
            assert said.startswith(f"{path}: is no checkpoint")
            assert said.endswith("delete it and start again")
        counts["unchanged" if said is None else "refused"] += 1
    print(dict(counts))
    assert counts["refused"] > 0.9 * n


def check_sealed(folder, n, random_):
    """Damaged before they were sealed, they are refused, or are a state that a run goes on from."""
    path, counts = folder / FILE, Counter[str]()
    for number in range(n):
        name, change = random_.choice(list(RUNS)), random_.choice(DAMAGES)
        data = sealed(change(checkpoint(name)[:-SEAL_SIZE], random_))
        path.write_bytes(data)
        try:
            said = said_of(go_on, name, folder)
        except BaseException:
            print(f"file {number}, {name}, {change.__name__}")
            raise
        assert said is None or said.isprintable(), ascii(said)
        counts["gone on from" if said is None else "refused"] += 1
    print(dict(counts))
    assert counts["refused"] > n / 3


def test_damaged_checkpoints_are_refused(tmp_path):
    check_damaged(tmp_path, 150, random.Random(1))


@pytest.mark.slow
def test_three_thousand_damaged_checkpoints_are_refused(tmp_path):
    check_damaged(tmp_path, 3000, random.Random(2))


def test_checkpoints_damaged_before_they_were_sealed_are_refused_or_gone_on_from(tmp_path):
    check_sealed(tmp_path, 40, random.Random(3))


@pytest.mark.slow
def test_a_thousand_checkpoints_damaged_before_they_were_sealed(tmp_path):
    check_sealed(tmp_path, 1000, random.Random(4))


def test_any_one_flipped_bit_is_refused(tmp_path):
    data, random_ = checkpoint("between stages"), random.Random(5)
    ends = range(len(data) - 700, len(data))
    for at in (*random_.sample(range(len(data)), 200), *ends):
        (tmp_path / FILE).write_bytes(with_flipped_bit(data, at, random_.randrange(8)))
        with pytest.raises(InputError, match="is no checkpoint that is whole"):
            Checkpoint.read(tmp_path)


def with_flipped_bit(data, at, bit):
    out = bytearray(data)
    out[at] ^= 1 << bit
    return bytes(out)


def changed(name, folder, **fields):
    """Write a checkpoint with these fields changed, and the right seal; go on from it."""
    (folder / FILE).write_bytes(checkpoint(name))
    saved = Checkpoint.read(folder)
    assert saved is not None
    replace(saved, **{key: value(saved) for key, value in fields.items()}).write(folder)
    go_on(name, folder)


def done_with(**fields):
    return lambda saved: replace(saved.done, **fields)


def on_other_roots(rival):
    roots, *others = rival.steps
    moved = replace(roots, adds=roots.adds + np.float32(0.01))
    return replace(rival, steps=(moved, *others))


STATES = {
    "stage 99": ("cloud", {"stage": lambda _: 99}, "stage is 99, expected 0 to 2"),
    "stage -1": ("cloud", {"stage": lambda _: -1}, "stage is -1, expected 0 to 2"),
    "a stage too late": ("cloud", {"stage": lambda _: 1}, "0 levels are over, expected 1"),
    "a stage too early": ("frontier", {"stage": lambda _: 0}, "1 levels are over, expected 0"),
    "all stages": ("frontier", {"stage": lambda _: 2}, "iteration is 30, expected 0 to 0"),
    "text for a stage": ("cloud", {"stage": lambda _: "0"}, "stage is no int"),
    "true for a stage": ("frontier", {"stage": lambda _: True}, "stage is no int"),
    "iteration 41": ("cloud", {"iteration": lambda _: 41}, "iteration is 41, expected 0 to 40"),
    "iteration 0": ("cloud", {"iteration": lambda _: 0}, "iteration 0 is not there, or is over"),
    "no model": ("cloud", {"model": lambda _: {}}, "iteration 20 is not there"),
    "another SH degree": ("cloud", {"done": done_with(sh_degree=2)}, "SH degree is 2, expected 1"),
    "SH degree 9": ("cloud", {"done": done_with(sh_degree=9)}, "SH degree is 9, expected 0 to 3"),
    "no quanta": ("integers", {"done": done_with(quanta=())}, "quanta have 0 rows, expected 2"),
    "quanta of -1": (
        "integers",
        {"done": lambda saved: replace(saved.done, quanta=((-1.0,) * 6,) * 2)},
        "quanta are no finite numbers above 0",
    ),
    "no first attempt": (
        "second attempt",
        {"done": done_with(rival=None)},
        "the first attempt at level 1 is not there",
    ),
    "a first attempt at another level": (
        "second attempt in integers",
        {"done": lambda saved: replace(saved.done, rival=Done(1, saved.done.steps[:1]))},
        "the first attempt at level 1 is not there, or is another one",
    ),
    "a first attempt and no second": (
        "mixed",
        {"done": lambda saved: replace(saved.done, rival=saved.done)},
        "there is a first attempt at a level, and no second one",
    ),
    "decided too early": (
        "second attempt",
        {"done": done_with(refines_save=0.5)},
        "what refines save is missing, or is known already",
    ),
    "savings that are no number": (
        "second attempt",
        {"done": done_with(refines_save="yes")},
        "refines_save is no list of one finite number",
    ),
    "a first attempt on other roots": (
        "second attempt",
        {"done": lambda saved: replace(saved.done, rival=on_other_roots(saved.done.rival))},
        "the first attempt at level 1 is on other levels",
    ),
    "no spare splats": ("splats to spare", {"done": done_with(spare=None)}, "to spare are missing"),
}


@pytest.mark.parametrize(("name", "fields", "words"), STATES.values(), ids=STATES)
def test_a_state_that_the_run_cannot_be_in_is_refused(tmp_path, name, fields, words):
    with pytest.raises(InputError, match=words):
        changed(name, tmp_path, **fields)


def array_with(key, change, part="model"):
    return {part: lambda saved: {**getattr(saved, part), key: change(getattr(saved, part)[key])}}


ARRAYS = {
    "half the rows": ("cloud", array_with("variable1.value", lambda x: x[::2]), "expected 30 x 4"),
    "moments of other rows": ("cloud", array_with("variable0.m", lambda x: x[1:]), "has shape"),
    "doubles": ("cloud", array_with("variable0.value", np.float64), "is float64, expected float32"),
    "steps below 0": ("cloud", array_with("variable0.t", lambda x: x - 99), "t is -79, expected 0"),
    "slots out of bounds": (
        "frontier",
        array_with("block0.slots", lambda x: x + 1_000_000),
        "block0.slots do not rise",
    ),
    "slots in disorder": ("frontier", array_with("block0.slots", lambda x: x[::-1]), "do not rise"),
    "an unknown kind": ("frontier", array_with("block0.kind", lambda x: x + 9), "kind is 9"),
    "another kind": ("frontier", array_with("block0.kind", lambda x: x + 1), "block0 is fixed"),
    "children elsewhere": ("frontier", array_with("block1.first", lambda x: x - 1), "first is"),
    "too many blocks": ("frontier", array_with("n_blocks", lambda x: x + 9), "n_blocks is"),
    "fewer leaves": ("frontier", array_with("live", lambda x: x[1:]), "live has shape"),
    "scores of others": ("cloud", array_with("total", lambda x: x[1:], "scores"), "total has"),
    "fewer opacities": ("opacities", array_with("variable5.value", lambda x: x[1:]), "variable5"),
    "other integers": ("integers", array_with("latent0.value", lambda x: x[1:]), "latent0.value"),
}


@pytest.mark.parametrize(("name", "fields", "words"), ARRAYS.values(), ids=ARRAYS)
def test_arrays_that_do_not_fit_the_run_are_refused(tmp_path, name, fields, words):
    with pytest.raises(InputError, match=words):
        changed(name, tmp_path, **fields)


def test_a_step_that_breaks_a_rule_of_trees_is_refused(tmp_path):
    def steps(saved):
        (step,) = saved.done.steps
        return replace(saved.done, steps=(replace(step, adds=step.adds * np.float32(np.nan)),))

    with pytest.raises(InputError, match="step 0: adds has a value that is not finite"):
        changed("frontier", tmp_path, done=steps)


@pytest.mark.parametrize("name", RUNS)
def test_a_checkpoint_that_is_written_again_is_the_same_file(tmp_path, name):
    (tmp_path / FILE).write_bytes(checkpoint(name))
    saved = Checkpoint.read(tmp_path)
    assert saved is not None
    saved.write(tmp_path)
    assert (tmp_path / FILE).read_bytes() == checkpoint(name)
    go_on(name, tmp_path)


def test_what_is_no_file_is_no_checkpoint(tmp_path):
    pipe, folder, loop = (tmp_path / name for name in ("pipe", "folder", "loop"))
    for path in (pipe, folder, loop):
        path.mkdir()
    os.mkfifo(pipe / FILE)
    (folder / FILE).mkdir()
    (loop / FILE).symlink_to(FILE)
    for path, words in ((pipe, "is not a file"), (folder, "is not a file"), (loop, "be read")):
        with pytest.raises(InputError, match=words):
            Checkpoint.read(path)


def test_every_prefix_is_refused(tmp_path):
    data = checkpoint("cloud")
    for end in itertools.chain(range(0, 200), range(200, len(data), len(data) // 50)):
        (tmp_path / FILE).write_bytes(data[:end])
        with pytest.raises(InputError, match="is no checkpoint that is whole"):
            Checkpoint.read(tmp_path)
