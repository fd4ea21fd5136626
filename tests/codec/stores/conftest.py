"""What the tests of stores have in common."""

import random

import pytest

from tests.support.range_server import serving

BYTES = random.Random(1).randbytes(3_000_000)


@pytest.fixture
def site():
    """A server with `a.bin`, 3,000,000 bytes, `small`, 5 bytes, and `empty`."""
    pytest.importorskip("obstore", reason="URLs need obstore: pip install -e '.[stores]'")
    with serving({"a.bin": BYTES, "small": b"small", "empty": b""}) as site:
        yield site
