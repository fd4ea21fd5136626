"""The compiled loops beside numpy, on streams that use every coding."""

import random
from contextlib import contextmanager

import numpy as np
import pytest

from evogs_codec.decoding.compiled import dispatch
from evogs_codec.encoding.write import write
from evogs_codec.format import frames, pack
from evogs_codec.format.planes import MAX_STORED, Coding, ycocg
from tests.support.verdicts import verdict

ALWAYS, NEVER = 0, 1 << 62  # slots from which on the compiled loops are used
CODINGS = [
    Coding(low, high, is_delta)
    for low in range(9)
    for high in range(3)
    for is_delta in (False, True)
    if low or high
]


@contextmanager
def compiled_from(n_slots):
    """Use the compiled loops from so many slots on."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatch, "MIN_COMPILED", n_slots)
        yield


def both_verdicts(data):
    """[of numpy, of the compiled loops]: dump, or fault code and offset."""
    found = []
    for n_slots in (NEVER, ALWAYS):
        with compiled_from(n_slots):
            found.append(verdict(data))
    return found


def written_at_random(tree, seed):
    """A stream of the tree whose codings and flags are not the best ones; frames store planes."""

    def any_coding(z, *, is_delta=False):
        chance = random.Random(f"{seed} {is_delta} {z.tobytes()!r}")  # threads ask in any order
        bits = int(z.max()).bit_length() if z.size else 0
        able = [c for c in CODINGS if c.bits >= bits and c.delta == is_delta]
        return (chance.choice(able) if bits else Coding(0, 0)), chance.random()

    def any_turn(values, sh):
        rows = values[sh]
        small = rows.size > 0 and int(np.abs(rows).max()) < MAX_STORED // 8
        if not small or random.Random(f"{seed} {rows.tobytes()!r}").random() < 0.3:
            return values, False
        turned = values.copy()
        turned[sh] = ycocg(rows)
        return turned, True

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pack, "choose_coding", any_coding)
        patch.setattr(pack, "decorrelate", any_turn)
        patch.setattr(frames, "compress", lambda plane, *_: frames.store(plane))
        return write(tree, digests=False)
