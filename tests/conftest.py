"""Fixtures of all tests, and the hypothesis profiles.

Tests have three rings. A test without a mark is in the first, which `make test` runs in under three
minutes. `thorough` leaves it to `make test-all`, `slow` to `make test-slow`.
"""

import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from evogs_codec import write_ply, write_tree
from evogs_codec.cli import terminal
from evogs_codec.cli.commands import main
from evogs_codec.render.demo_scene import make_scene
from tests.support import damage
from tests.support.examples import N_SEEDED

# The first call of a numpy function may take longer than hypothesis allows an example.
settings.register_profile("dev", deadline=None, suppress_health_check=[HealthCheck.too_slow])
# `make test` repeats the same few examples. `make test-all` draws others, and prints how to repeat
# one that fails (@reproduce_failure); so does a bare `pytest`, which also keeps it in .hypothesis.
settings.register_profile(
    "seeded",
    settings.get_profile("dev"),
    derandomize=True,
    database=None,
    max_examples=N_SEEDED,
)
settings.register_profile("random", settings.get_profile("dev"), print_blob=True, database=None)
settings.load_profile("dev")


def pytest_collection_modifyitems(items):
    """Files with long tests first: a worker that begins one at the end keeps the others waiting."""
    long = {item.path for item in items if item.get_closest_marker("thorough")}
    items.sort(key=lambda item: item.path not in long)


SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real scenes next to the project, which are not ours to commit."""
    if not (SHARED / "data").is_dir():
        pytest.skip("the real scenes (../shared/data) are not on this machine")
    return SHARED


@pytest.fixture(autouse=True, scope="session")
def no_line_of_progress():
    """A slow machine prints no more lines than a fast one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "SECONDS_OF_A_LINE", math.inf)
        yield


# --- of the command line --------------------------------------------------------------------------


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A folder with scene.ply, scene.evogs and tree.npz that tests only read."""
    folder = tmp_path_factory.mktemp("made")
    write_ply(folder / "scene.ply", make_scene(3000))
    write_tree(folder / "x.tree.npz", damage.random_tree(20, 3, 1))
    words = ["encode", str(folder / "scene.ply"), str(folder / "scene.evogs"), "--preset", "scene"]
    words += ["--levels", "5"]
    assert main(words) == 0
    return folder


@pytest.fixture
def evogs(capsys):
    """Run a command; returns (exit code, standard output, standard error)."""

    def run(*arguments):
        capsys.readouterr()
        code: object
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as exit_:
            code = exit_.code
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.fixture
def refused(evogs):
    """Run a command that must fail with one line that has these words; returns the line."""

    def run(*arguments, words=(), code=1):
        found, out, err = evogs(*arguments)
        assert (found, out) == (code, "")
        if code == 1:
            assert err.startswith("evogs: ")
            assert err.endswith("\n")
            assert err.count("\n") == 1
        for word in words:
            assert str(word) in err
        return err

    return run
