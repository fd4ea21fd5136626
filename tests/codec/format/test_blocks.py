"""Frames are divided into blocks where that is smaller."""

import numpy as np
import pytest
import zstandard

from evogs_codec.format import blocks
from evogs_codec.format.blocks import block_ends
from evogs_codec.format.frames import MAX_BLOCK, compress, decompress

EFFORT = 19


def part(n, spread, seed=0, offset=0):
    """n bytes of a geometric distribution from `offset` on."""
    rng = np.random.default_rng(seed)
    return (np.minimum(rng.geometric(1 / spread, n) - 1, 99) + offset).astype(np.uint8).tobytes()


def content_of(frame):
    return decompress(memoryview(frame), zstandard.frame_content_size(frame), 0)


@pytest.mark.parametrize("n", [200, 3000, 60_000])
def test_parts_that_are_unlike_are_divided_where_one_ends(n):
    content = part(n, 6) + part(n, 6, 1, 120)
    assert block_ends(content) == [n]
    divided, whole = compress(content, EFFORT, [n]), compress(content, EFFORT)
    assert content_of(divided) == content
    assert len(divided) < len(whole) - n / 16  # about a bit for each byte


def test_parts_that_are_alike_are_one_block():
    assert block_ends(part(40_000, 6)) == []
    assert block_ends(b"") == []
    assert block_ends(bytes(5000)) == []


def test_many_parts_are_many_blocks_in_order():
    parts = [part(2500, 5, k, 40 * (k % 3)) for k in range(8)]
    ends = block_ends(b"".join(parts))
    assert ends == sorted(set(ends))
    near = [min(abs(end - 2500 * k) for k in range(1, 8)) for end in ends]
    assert len(ends) == 7
    assert max(near) < 20
    content = b"".join(parts)
    assert content_of(compress(content, EFFORT, ends)) == content


def test_contents_of_several_blocks_are_divided_too():
    content = part(MAX_BLOCK, 6) + part(9000, 6, 1) + part(50_000, 6, 2, 120)
    ends = block_ends(content)
    assert ends == [MAX_BLOCK + 9000]
    assert content_of(compress(content, EFFORT, ends)) == content


@pytest.mark.parametrize("n", [128, 129, 1000, 50_000])
@pytest.mark.parametrize("spread", [1.2, 4.0, 60.0])
def test_numpy_and_compiled_code_divide_alike(n, spread, monkeypatch):
    pytest.importorskip("numba")
    halves = part(n // 3, spread, n), part(n - n // 3, 1 + spread / 2, n + 1, 30)
    content = b"".join(halves)
    found = block_ends(content)
    monkeypatch.setattr(blocks, "MAY_COMPILE", False)
    assert block_ends(content) == found
