"""Interleaved rANS with static tables, for comparison with the frames of the format.

A block holds the lists of a packet: one string of bits with the model, tables and raw bits of each,
the states, and the words that refill them. The lanes of a list are runs of it, decoded in step: the
neighbour of an integer is in its own lane, and the lanes do not wait for each other.

Letters: n integers of a list, T tokens, K tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from evogs_codec.splats import I32, I64
from tools.bench.entropy.contexts import (
    CLASS_OF,
    CONTEXTS,
    MAX_TABLES,
    MAX_TOKENS,
    N_CLASSES,
    SPLITS,
    TABLE_BITS,
    Model,
    classes_of,
    magnitudes_of,
)
from tools.bench.entropy.rans_kernels import (
    LEAST,
    MANTISSA,
    N_LANES,
    decode_known,
    decode_neighbour,
    decode_plain,
    encode_list,
    join_raw,
    read_model,
    write_bits,
)

__all__ = ["decode", "encode"]

Known: TypeAlias = Callable[[int, str, list[I32]], I32]  # list, context, lists before
TOTAL = 1 << TABLE_BITS
BASES = [split.bases(MAX_TOKENS) for split in SPLITS]


def encode(
    lists: Sequence[I32], models: Sequence[Model], known: Sequence[Mapping[str, I32]]
) -> bytes:
    """The block of lists, none of them empty."""
    bits, at = np.zeros(sum(4 * len(z) + 4096 for z in lists) + 8, np.uint8), 0
    words = np.empty(sum(len(z) for z in lists), np.uint16)
    jobs = []
    for z, model, magnitudes in zip(lists, models, known, strict=True):
        frequencies = np.stack([_frequencies(row) for row in model.counts])
        at = write_bits(bits, at, *_described(model, frequencies))
        tokens, n_raw = model.split.tokens(z)
        at = write_bits(bits, at, z >> model.split.low & (1 << n_raw) - 1, n_raw)
        classes = classes_of(magnitudes_of(model.context, model.split, tokens, magnitudes))
        jobs.append((tokens, model.table_of[classes], frequencies))
    states, n_words = np.full(N_LANES, LEAST, np.int64), 0
    for tokens, tables, frequencies in reversed(jobs):
        starts = np.cumsum(frequencies, 1) - frequencies
        n_words = encode_list(tokens, tables, frequencies, starts, states, words, n_words)
    n_bytes = -(-at // 8)
    return b"".join(
        (
            np.array([n_bytes], np.uint32).tobytes(),
            bits[:n_bytes].tobytes(),
            states.astype(np.uint32).tobytes(),
            words[:n_words][::-1].tobytes(),
        )
    )


def decode(block: bytes, sizes: Sequence[int], known: Known) -> list[I32]:
    """The lists of a block; `known` is asked for the magnitudes that a context needs."""
    n_bytes = int.from_bytes(block[:4], "little")
    padded = block[4 : 4 + n_bytes] + bytes(24 - n_bytes % 8)
    bits, bits64 = np.frombuffer(padded, np.uint8), np.frombuffer(padded, np.uint64)
    states = np.frombuffer(block, np.uint32, N_LANES, 4 + n_bytes).copy()
    # One word more, since a lane looks at the next word before it knows whether it needs it.
    words = np.frombuffer(block[4 + n_bytes + 4 * N_LANES :] + bytes(2), np.uint16)
    model, table_of = np.empty(3, np.int64), np.empty(N_CLASSES, np.uint8)
    lookup = np.empty(MAX_TABLES * TOTAL, np.uint32)
    out: list[I32] = []
    at = word = 0
    for k, n in enumerate(sizes):
        at = read_model(bits, at, model, table_of, lookup)
        split, context, n_tokens = SPLITS[model[0]], CONTEXTS[model[1]], int(model[2])
        bases, n_raw = BASES[model[0]]
        z = np.empty(n, np.int32)
        if context == "none":
            word = decode_plain(words, word, states, lookup, z)
        elif context == "neighbour":
            tables = table_of[classes_of(bases[:n_tokens])]
            word = decode_neighbour(words, word, states, lookup, tables, z)
        else:
            magnitudes = known(k, context, out)
            word = decode_known(words, word, states, lookup, CLASS_OF, table_of, magnitudes, z)
        if n_tokens > 1 << split.direct:
            at = join_raw(bits64, at, bases, n_raw, split.low, z)
        out.append(z)
    return out


def _described(model: Model, frequencies: I64) -> tuple[I64, I64]:
    """Values, and bits of each, that say how a list is coded; the inverse of `read_model`."""
    n_tables, n_tokens = frequencies.shape
    fields = [(SPLITS.index(model.split), 3), (CONTEXTS.index(model.context), 3)]
    fields += [(n_tables - 1, 3), (n_tokens - 1, 8)]
    fields += [(int(np.count_nonzero(model.table_of <= k)) - 1, 5) for k in range(n_tables - 1)]
    for row in frequencies.tolist():
        greatest = row.index(max(row))
        fields.append((greatest, 8))
        for frequency in row[:greatest] + row[greatest + 1 :]:
            length = frequency.bit_length()
            kept = max(min(MANTISSA, length - 1), 0)
            fields += [
                (length, 4),
                (frequency >> max(length - 1 - kept, 0) & (1 << kept) - 1, kept),
            ]
    values, n_bits = np.array(fields, np.int64).T
    return values, n_bits


def _frequencies(counts: I64) -> I64:
    """(T,) of sum TOTAL, those not 0 where a token occurs, all but the greatest in few bits."""
    n, greatest = int(counts.sum()), int(counts.argmax())
    room = TOTAL
    while True:
        wanted = np.where(counts > 0, np.maximum(np.rint(counts * room / n), 1), 0).astype(np.int64)
        shift = np.maximum(np.frexp(wanted)[1] - 1 - MANTISSA, 0)
        found: I64 = wanted + (1 << shift >> 1) >> shift << shift
        found[greatest] = 0
        found[greatest] = TOTAL - found.sum()
        if found[greatest] == found.max():
            return found
        room -= TOTAL >> 4
