"""The coders that `tools.bench.entropy` compares: blocks of rANS, lists of a stream, models."""

import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec import PRESETS, EvolutionTree, lift
from evogs_codec.planes import entropy
from tools.bench.entropy.contexts import CONTEXTS, SPLITS, choose_model
from tools.scene import make_scene

bench = pytest.importorskip(
    "tools.bench.entropy.tables", reason="numba is not installed: no kernels"
)
from tools.bench.entropy import parts, rans  # noqa: E402
from tools.bench.entropy.costs import Sample  # noqa: E402
from tools.bench.entropy.javascript import IN_JAVASCRIPT  # noqa: E402


@pytest.fixture(scope="module")
def sample() -> Sample:
    splats = make_scene().take(np.arange(2000))
    return Sample.of("small", lift(splats, 3), PRESETS["scene"])


@pytest.mark.parametrize("split", SPLITS)
def test_tokens_and_raw_bits_say_an_integer(split):
    z = np.concatenate([np.arange(5000), 2 ** np.arange(24), 2 ** np.arange(24) - 1]).astype(
        np.int32
    )
    tokens, n_raw = split.tokens(z)
    base, bits = split.bases(int(tokens.max()) + 1)
    raw = z >> split.low & (1 << n_raw) - 1
    assert np.array_equal(bits[tokens], n_raw)
    assert np.array_equal(base[tokens] + (raw << split.low), z)


@given(
    st.lists(st.lists(st.integers(0, 2**24 - 1), min_size=1, max_size=60), min_size=1, max_size=4),
    st.sampled_from(["none", "neighbour", "given"]),
)
def test_a_block_of_rans_gives_back_its_lists(values, kind):
    lists = [np.array(row, np.int32) for row in values]
    known = [{"parent": z // 3} for z in lists] if kind == "given" else [{} for _ in lists]
    contexts = {"none": (), "neighbour": ("neighbour",), "given": ("parent",)}[kind]
    models = [choose_model(z, some, contexts) for z, some in zip(lists, known, strict=True)]
    block = rans.encode(lists, models, known)
    found = rans.decode(block, [len(z) for z in lists], lambda k, context, _: known[k][context])
    assert all(np.array_equal(a, b) for a, b in zip(found, lists, strict=True))


@given(st.lists(st.integers(0, 2**24 - 1), min_size=1, max_size=300), st.integers(1, 9))
def test_parts_give_back_their_list(values, divisor):
    z = np.array(values, np.int32)
    known = {"parent": z // divisor}
    found = parts.decode(parts.encode([z], [known]), lambda k, context, _: known[context])
    assert np.array_equal(found[0], z)


def test_a_list_that_its_context_explains_is_in_parts():
    z = np.random.default_rng(1).integers(0, 2, 10_000).astype(np.int32)
    parted = parts.encode([z * 7], [{"parent": 9 * z}])
    assert parted.lists[0].context == "parent"
    assert parted.n_bytes < 200


def test_a_block_of_rans_is_near_the_bits_of_its_model():
    z = np.random.default_rng(1).geometric(0.2, 50_000).astype(np.int32)
    model = choose_model(z, {}, ())
    n_bits = 8 * len(rans.encode([z], [model], [{}]))
    assert entropy(z) < n_bits < 1.003 * model.bits + 8 * 40


def test_a_context_that_says_all_costs_next_to_nothing():
    z = np.random.default_rng(1).integers(0, 2, 10_000).astype(np.int32)
    model = choose_model(z, {"parent": 9 * z}, CONTEXTS)
    assert model.context == "parent"
    assert model.bits < 200


def test_lists_of_a_stream_are_all_that_its_packets_hold(sample):
    for packet in sample.packets:
        stored = [
            n
            for c, n in zip(packet.header.codings, packet.header.lengths, strict=True)
            if c.n_planes
        ]
        assert [len(one.values) for one in packet.lists] == stored


def test_every_coder_gives_back_the_lists_of_a_stream(sample):
    rows = bench.decoding([sample])  # checks the lists before it takes times
    assert rows[0]["coder"] == bench.FORMAT
    assert all(float(str(row["small"])) > 0 for row in rows)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_javascript_gives_back_the_lists_of_a_stream(sample):
    rows = bench.javascript([sample])  # the program compares its coders
    assert set(IN_JAVASCRIPT) <= {row["coder"] for row in rows}


def test_a_table_has_a_column_for_each_stream(sample):
    for measure in (bench.sizes, bench.contexts, bench.groups):
        assert all(list(row)[1:] == ["small"] for row in measure([sample]))


def test_the_ideal_coders_are_in_order(sample):
    assert (
        sample.total("adaptive, two") <= sample.total("adaptive") <= sample.total("adaptive none")
    )
    assert sample.total("static") <= sample.total("static none")
    assert sample.total("planes") < len(sample.data)


def test_the_parent_of_a_record_is_known_to_its_children(sample):
    psi = [one for packet in sample.packets for one in packet.lists if "parent" in one.given]
    assert any(one.given["parent"].any() for one in psi)


def test_splats_without_a_tree_have_no_parents():
    splats = make_scene().take(np.arange(300))
    flat = Sample.of("flat", EvolutionTree.of_splats(splats), PRESETS["scene"])
    assert all("parent" not in one.given for packet in flat.packets for one in packet.lists)
