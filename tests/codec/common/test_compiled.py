"""Compiled code is kept for all processes, and is that of its signature and of its sources."""

import importlib.util
import linecache
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("numba")
compiled = pytest.importorskip("evogs_codec.common.compiled")

TOTAL = """
from evogs_codec.common.compiled import jit
from {inner} import FACTOR, term

@jit()
def total(x):
    s = 0
    for i in range(len(x)):
        s += FACTOR * term(x[i])
    return s
"""
TERM = """
from evogs_codec.common.compiled import jit

FACTOR = {factor}

@jit()
def term(v):
    return v + {plus}
"""
FACTORY = """
from evogs_codec.common.compiled import jit

def adder(plus):
    @jit()
    def add(x):
        return x + plus
    return add

one, two = adder(1), adder(2)

@jit()
def both(x):
    return 100 * one(x) + two(x)
"""
LOADED = """
import sys
import numpy as np
from outer import total

print(total(np.ones(2, np.int64)), "numba.core.typing.cffi_utils" in sys.modules)
print(total(np.ones(2, np.float32)), "numba.core.typing.cffi_utils" in sys.modules)
"""
TYPES = ("int32", "int64", "float32", "float64")
RACE = """
import multiprocessing, sys
import numpy as np

def compile_one(type_, barrier):
    from evogs_codec.common import compiled
    import outer
    save = compiled._CodeFiles.save
    def at_once(*args):
        barrier.wait(120)
        save(*args)
    compiled._CodeFiles.save = at_once
    outer.total(np.arange(24, dtype=type_))

if __name__ == "__main__":
    multiprocessing.set_start_method("spawn")
    barrier = multiprocessing.Barrier(len(sys.argv) - 1)
    processes = [
        multiprocessing.Process(target=compile_one, args=(type_, barrier)) for type_ in sys.argv[1:]
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    sys.exit(any(process.exitcode for process in processes))
"""


@pytest.fixture
def sources(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "outer.py").write_text(TOTAL.format(inner="inner"))
    (tmp_path / "inner.py").write_text(TERM.format(factor=2, plus=1))
    yield tmp_path
    for name in ("outer", "inner"):
        sys.modules.pop(name, None)


def total(folder):
    """The function of a process that starts now. Sources that change must change their size."""
    linecache.clearcache()
    compiled._digest_of_file.cache_clear()
    for name in ("inner", "outer"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return module.total


def test_it_is_kept(sources):
    x = np.arange(4, dtype=np.int32)
    first, second = total(sources), total(sources)
    assert (first(x), second(x)) == (20, 20)
    assert sum(first.stats.cache_hits.values()) == 0
    assert sum(second.stats.cache_hits.values()) == 1


def test_it_is_loaded_without_what_compiles(sources):
    assert total(sources)(np.ones(2, np.int64)) == 8
    (sources / "loaded.py").write_text(LOADED)
    run = subprocess.run(
        [sys.executable, "loaded.py"], cwd=sources, check=True, capture_output=True, text=True
    )
    assert run.stdout.split() == ["8", "False", "8.0", "True"]


@pytest.mark.thorough
def test_processes_that_compile_at_the_same_time_keep_all_signatures(sources):
    """With numba's own files, of 15 trials 14 lost a signature; one returned another's result."""
    (sources / "race.py").write_text(RACE)
    subprocess.run([sys.executable, "race.py", *TYPES], cwd=sources, check=True, timeout=240)
    function = total(sources)
    for type_ in TYPES:
        assert function(np.arange(24, dtype=type_)) == 2 * (24 * 23 // 2 + 24)
    assert sum(function.stats.cache_hits.values()) == len(TYPES)


def test_functions_of_one_factory_that_two_processes_keep_are_told_apart(tmp_path):
    """With numba's own numbers, each process names its first function alike: 100 * 5 + 5."""
    (tmp_path / "factory.py").write_text(FACTORY)
    for expression in ("one(4)", "two(4)", "both(4)"):
        code = f"import factory; print(factory.{expression})"
        run = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=True, timeout=240
        )
    assert int(run.stdout) == 100 * 5 + 6


@pytest.mark.parametrize(("factor", "plus"), [(30, 1), (2, 50)])
def test_what_it_was_made_from_may_change_in_another_file(sources, factor, plus):
    x = np.arange(4, dtype=np.int32)
    assert total(sources)(x) == 2 * (6 + 4)
    (sources / "inner.py").write_text(TERM.format(factor=factor, plus=plus))
    changed = total(sources)
    assert changed(x) == factor * (6 + 4 * plus)
    assert sum(changed.stats.cache_hits.values()) == 0


@pytest.mark.parametrize("damage", [lambda b: b[:100], lambda b: b[:-1] + b"\0", lambda b: b""])
def test_a_damaged_file_is_made_again(sources, damage):
    x = np.arange(4, dtype=np.int32)
    total(sources)(x)
    (path,) = sources.glob("__pycache__/outer.total*.nbc")
    good = path.read_bytes()
    path.write_bytes(damage(good))
    again = total(sources)
    assert again(x) == 20
    assert sum(again.stats.cache_hits.values()) == 0
    kept = total(sources)
    assert kept(x) == 20
    assert sum(kept.stats.cache_hits.values()) == 1


def test_what_another_numba_kept_is_not_loaded(sources, monkeypatch):
    x = np.arange(4, dtype=np.int32)
    with monkeypatch.context() as other:
        other.setattr(compiled.numba, "__version__", "0.1")
        total(sources)(x)
    monkeypatch.setattr(compiled.pickle, "loads", lambda _: pytest.fail("it was loaded"))
    again = total(sources)
    assert again(x) == 20
    assert sum(again.stats.cache_hits.values()) == 0


def test_a_folder_that_cannot_be_written_to_only_costs_time(sources, monkeypatch):
    def full(*_args):
        raise OSError("no space left on device")

    monkeypatch.setattr(compiled._CodeFiles, "_open_for_write", full)
    assert total(sources)(np.arange(4, dtype=np.int32)) == 20
    assert not list(sources.glob("__pycache__/*.nbc"))


def test_what_was_kept_can_be_removed(sources):
    function = total(sources)
    function(np.arange(4, dtype=np.int32))
    function._cache.flush()
    assert not list(sources.glob("__pycache__/outer.total*.nbc"))
