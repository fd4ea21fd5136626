"""How many examples hypothesis draws: all in `make test-all`, a third of them in `make test`."""

from hypothesis import settings

__all__ = ["N_DEFAULT", "N_SEEDED", "examples"]

N_DEFAULT = 100  # of a test that does not say how many
N_SEEDED = 33  # of such a test in the profile `seeded`


def examples(n: int) -> settings:
    """The settings of a test that draws n examples; its share of them in the profile `seeded`."""
    return settings(max_examples=max(1, n * settings().max_examples // N_DEFAULT))
