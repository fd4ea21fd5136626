"""SH that splats share: found, kept exactly, coded as a palette, chosen where it pays."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conformance.decoders import oracle
from evogs_codec import PRESETS, EvolutionTree, choose_cut, decode, encode, extract, read_directory
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.packet_order import packet_order
from evogs_codec.encoding.palette_parts import palette_packets
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.format.pack import pack_entries
from evogs_codec.io.tree_npz import write_tree
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import shared_sh, with_palette
from evogs_codec.model.components import PALETTE, PICKS
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.palette import Palette
from evogs_codec.model.tree import Step
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tests.support.shared_scenes import shared_scene, shared_tree


@pytest.fixture(scope="module")
def scene():
    splats = shared_scene()
    return splats, *shared_tree(splats)


# --- finding -------------------------------------------------------------------------------------


def test_every_splat_has_its_own_sh_in_the_palette(scene):
    splats, *_ = scene
    found = shared_sh(splats)
    assert found is not None
    palette, picks = found
    assert palette.entries.shape == (24, 59)
    assert palette.degree == 2
    np.testing.assert_array_equal(palette.sh_of(picks), splats.sh[:, 1:].reshape(len(splats), -1).T)
    assert np.any(picks == 0)


def test_zeros_of_either_sign_are_one_and_need_no_entry():
    splats = shared_scene(n_vectors=1)
    sh = splats.sh.copy()
    sh[::2, 1:] = -0.0
    found = shared_sh(replace(splats, sh=sh))
    assert found is not None
    palette, picks = found
    assert palette.entries.shape == (24, 0)
    assert not picks.any()


@pytest.mark.parametrize("splats", [make_scene(500), shared_scene(200, 190)], ids=["own", "few"])
def test_splats_that_do_not_share_have_no_palette(splats):
    assert shared_sh(splats) is None
    assert with_palette(lift_with_order(splats, 2), splats) is None


def test_no_bands_no_palette():
    splats = make_scene(50)
    assert shared_sh(replace(splats, sh=splats.sh[:, :1])) is None
    assert shared_sh(splats.take(np.zeros(0, np.int64))) is None


# --- trees ---------------------------------------------------------------------------------------


def test_the_leaves_of_a_tree_with_a_palette_have_their_sh_exactly(scene):
    splats, lifted, tree = scene
    leaves = tree.leaves()
    np.testing.assert_array_equal(leaves.sh[:, 1:], splats.take(lifted.leaf_of).sh[:, 1:])
    np.testing.assert_array_equal(leaves.means, lifted.tree.leaves().means)
    assert tree.shown_degree == 2
    assert tree.components.of_tiles == (0, 4)


def test_coarse_splats_show_sh_near_their_own(scene):
    """Nearer than none, and than that of a leaf of theirs; few bits a pick, so near is all."""
    _, lifted, tree = scene
    final = [
        tree.palette.sh_of(tree_picks(tree))[:, : tree.leaves(k).sh.shape[0]] for k in range(3)
    ]
    for level, most in enumerate([0.95, 0.85, 0.5]):
        shown, right = tree.leaves(level).sh[:, 1:], lifted.tree.leaves(level).sh[:, 1:]
        own = final[level].T.reshape(right.shape)
        off = np.square(shown - right).sum()
        assert off < most * np.square(right).sum()
        assert off < np.square(own - right).sum()


def tree_picks(tree):
    """Of the slots in the end."""
    *_, state = tree.states()
    return state.picks


def test_arranging_moves_picks_with_their_splats(scene):
    _, _, tree = scene
    for level in range(tree.n_levels):
        rows = [
            np.concatenate([part.channels() for part in cut], axis=1)
            for cut in ([t.leaves(level) for t in arrange(tree, 3)], [tree.leaves(level)])
        ]
        arranged, plain = (x[:, np.lexsort(x)] for x in rows)
        np.testing.assert_array_equal(arranged, plain)


def test_picks_are_checked():
    palette = Palette(1, np.ones((9, 2), np.float32))
    step = Step.of_adds(0, np.zeros((14, 2), np.float32))
    with pytest.raises(ValueError, match="1 picks of 2 new slots"):
        EvolutionTree(0, (replace(step, picks=np.array([1], np.int32)),), palette=palette)
    (*_, state) = EvolutionTree(0, (step,), palette=palette).states()
    assert state.picks.tolist() == [0, 0]  # adds without picks have none
    with pytest.raises(ValueError, match=r"picks must be in 0\.\.2"):
        EvolutionTree(0, (replace(step, picks=np.array([1, 3], np.int32)),), palette=palette)
    picks = np.array([1, 2], np.int32)
    with pytest.raises(ValueError, match="2 changed picks of 0 slots"):
        EvolutionTree(0, (replace(step, picks=picks, changed_picks=picks),), palette=palette)
    first = replace(step, picks=picks)
    refined = Step.of_refines(1, np.array([0, 1]), np.zeros((14, 2)))
    grown = replace(refined, changed_picks=picks, adds=np.zeros((14, 1), np.float32))
    with pytest.raises(ValueError, match="step 1: picks change, and new slots have none"):
        EvolutionTree(0, (first, grown), palette=palette)
    with pytest.raises(ValueError, match=r"step 1: picks must be in 0\.\.2"):
        EvolutionTree(0, (first, replace(refined, changed_picks=picks + 1)), palette=palette)


def test_a_tree_of_one_level_has_no_coarse_entries():
    splats = shared_scene(300)
    _, tree = shared_tree(splats, 1)
    assert tree.palette.n_coarse == 0
    np.testing.assert_array_equal(
        np.sort(tree.leaves().sh[:, 1:].reshape(300, -1), axis=0),
        np.sort(splats.sh[:, 1:].reshape(300, -1), axis=0),
    )


def test_a_file_of_a_tree_does_not_lose_a_palette_in_silence(scene, tmp_path):
    with pytest.raises(ValueError, match="no palette"):
        write_tree(tmp_path / "a.tree.npz", scene[2])
    assert not list(tmp_path.iterdir())


# --- streams -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("preset", "n_tiles"),
    [
        ("scene", 3),
        ("near-lossless", 1),
        pytest.param("scene", 1, marks=pytest.mark.thorough),
        pytest.param("near-lossless", 3, marks=pytest.mark.thorough),
        pytest.param("paper", 1, marks=pytest.mark.thorough),
        pytest.param("paper", 3, marks=pytest.mark.thorough),
    ],
)
def test_a_stream_has_the_sh_of_every_level(scene, preset, n_tiles):
    """The oracle decodes what was written, and errors are those of the steps."""
    _, _, tree = scene
    data = encode(tree, replace(PRESETS[preset], zstd_level=1), n_tiles=n_tiles)
    directory = read_directory(data)
    assert directory.has_palette
    assert directory.sh_degree == 2
    decoded = decode(data, verify=True)
    assert oracle.decode(data, check_digests=True).dump() == decoded.dump()
    step = directory.quantisers[0][5].step * 2.0 ** -directory.grid_exponents[4]
    leaves = np.concatenate([t.leaves().sh[:, 1:] for t in arrange(tree, n_tiles)])
    assert np.abs(decoded.leaves().sh[:, 1:] - leaves).max() <= 0.501 * step


@given(st.integers(0, 2**32 - 1))
def test_entries_that_round_to_the_same_become_one(seed):
    rng = np.random.default_rng(seed)
    vectors = rng.integers(-2, 3, (9, 40)).astype(np.float32) * np.float32(0.3)
    tree = of_adds(vectors, rng.integers(0, 41, 60), rng)
    palette = tree.palette
    assert palette is not None
    settings = PRESETS["scene"].finer(float(rng.choice([0.1, 0.3, 1, 10])))
    coded = quantise(arrange(tree, 1), 1, settings)
    entries, decoded = coded.entries, coded.palette()
    assert entries is not None
    assert decoded is not None
    assert entries.any(axis=0).all(), "no entry is 0"
    assert np.unique(entries, axis=1).shape == entries.shape
    step = coded.quantisers[0][5].step * 2.0 ** -coded.grid_exponents[4]
    own = arrange(tree, 1)[0].steps[0].picks
    want = palette.sh_of(own)
    assert np.abs(decoded.sh_of(coded.tiles[0].steps[0].picks) - want).max() <= 0.501 * step


def test_entries_in_order_take_fewer_bytes():
    rng = np.random.default_rng(0)
    tree = of_adds(rng.normal(0, 0.2, (9, 5000)).astype(np.float32), rng.permutation(5000) + 1, rng)
    entries = quantise(arrange(tree, 1), 1, PRESETS["scene"].finer(4)).entries
    assert entries is not None
    shuffled = encode_entries(entries[:, rng.permutation(entries.shape[1])])
    assert len(encode_entries(entries)) < 0.85 * len(shuffled)


def of_adds(entries, picks, rng, n_coarse=0):
    """A tree of one level with these picks."""
    adds = Step.of_adds(0, rng.normal(size=(14, len(picks))).astype(np.float32))
    palette = Palette(1, entries, n_coarse)
    return EvolutionTree(0, (replace(adds, picks=picks.astype(np.int32)),), palette=palette)


def test_entries_that_nothing_picks_are_left_out_and_coarse_ones_come_first():
    rng = np.random.default_rng(0)
    entries = np.arange(1, 91, dtype=np.float32).reshape(9, 10)
    tree = of_adds(entries, np.array([9, 2, 9, 4, 1, 0]), rng, n_coarse=3)
    coded = quantise(arrange(tree, 1), 1, PRESETS["near-lossless"])
    palette = coded.palette()
    assert palette is not None
    np.testing.assert_allclose(palette.entries, entries[:, [0, 1, 3, 8]], atol=1e-3)


@pytest.mark.parametrize("n_tiles", [1, 3])
def test_entries_come_with_the_level_that_first_picks_them(scene, n_tiles):
    _, _, tree = scene
    data = encode(tree, PRESETS["scene"], n_tiles=n_tiles)
    directory = read_directory(data)
    rows = directory.packets[directory.palette_packets]
    assert rows["level"].tolist() == sorted(set(rows["level"].tolist()))
    assert rows["level"][-1] == tree.n_levels - 1
    for level in range(tree.n_levels):
        cut = choose_cut(directory, level=level)
        smaller = extract(data, cut)
        found = read_directory(smaller)
        assert found.n_entries == rows["n_adds"][rows["level"] <= level].sum()
        assert oracle.decode(smaller).dump() == decode(data, cut).dump()
    assert rows["n_adds"][0] < rows["n_adds"].sum()


def encode_entries(entries):
    return pack_entries(entries, zstd_level=19)


def test_a_palette_that_is_nearly_free_keeps_the_bound_of_amplification():
    """1,000 entries whose difference is 1: fewer bytes than R-5.6-7 allows, unless padded."""
    entries = np.zeros((9, 1000), np.int32)
    entries[0] = np.arange(1, 1001)
    assert 16 * len(encode_entries(entries)) >= 1000


def test_packets_of_the_palette_come_with_the_first_picks_of_their_level(scene):
    _, _, tree = scene
    coded = quantise(arrange(tree, 2), tree.n_levels, PRESETS["scene"])
    palette = palette_packets(coded)
    sizes = dict.fromkeys(palette, 5000)
    for number, tile in enumerate(coded.tiles):
        for k in range(len(tile.steps)):
            sizes |= {PacketId(number, 0, k): 1000, PacketId(number, PICKS, k): 200}
    order = packet_order(coded, sizes)
    assert sorted(order) == sorted(sizes)
    assert order[0].component == 0
    for place, level in zip(palette, coded.palette_levels, strict=True):
        rest = order[order.index(place) + 1 :]
        first = next(p for p in rest if p.component == PICKS)
        assert coded.tiles[first.tile].steps[first.step].level == level


def test_coarse_levels_have_hints_of_their_picks(scene):
    _, _, tree = scene
    coded = quantise(arrange(tree, 1), tree.n_levels, PRESETS["scene"])
    errors = [step.error[1] for step in coded.tiles[0].steps]
    gains = [step.gain[1] for step in coded.tiles[0].steps]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > errors[-1] == 0
    assert min(gains) >= 0
    assert sum(gains) > 0


def test_a_step_without_picks_takes_no_bytes():
    splats = shared_scene(300, 1)
    lifted = lift_with_order(splats, 4)
    assert with_palette(lifted, splats) is None, "bands without numbers need no palette"
    steps = [
        replace(s, psi=s.psi[:14], adds=s.adds[:14], picks=np.zeros(s.n_new, np.int32))
        for s in lifted.tree.steps
    ]
    palette = Palette(2, np.zeros((24, 0), np.float32))
    data = encode(EvolutionTree(0, tuple(steps), palette=palette), PRESETS["scene"])
    rows = read_directory(data).packets
    assert not rows["size"][rows["component"] == PICKS].any()
    assert not np.any(rows["component"] == PALETTE)
    assert not decode(data).leaves(sh_degree=2).sh[:, 1:].any()


# --- targets -------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_psnr_is_met_with_entries_as_coarse_as_pictures_allow(scene):
    _, _, tree = scene
    views = Views(tree.leaves(), cameras_around(tree.leaves(), "z", 96)[::4])
    steps, sizes = [], []
    for decibels in (38, 50):
        data = TargetEncoder(tree, PRESETS["scene"], views).at_psnr(decibels)
        found = views.psnr(decode(data).leaves(sh_degree=2))
        assert found == pytest.approx(decibels, abs=0.2)
        directory = read_directory(data)
        steps.append(directory.quantisers[0][5].step * 2.0 ** -directory.grid_exponents[4])
        sizes.append(len(data))
    assert steps[0] > 2 * steps[1]
    assert sizes[0] < sizes[1]


@pytest.mark.thorough
def test_errors_of_sh_are_kept(scene):
    _, _, tree = scene
    data = TargetEncoder(tree, PRESETS["scene"]).within({"sh": 0.001})
    leaves = np.concatenate([t.leaves().sh for t in arrange(tree, 1)])
    assert np.abs(decode(data).leaves(sh_degree=2).sh - leaves).max() <= 0.001


@pytest.mark.thorough
def test_polishing_leaves_the_palette_alone(scene):
    _, _, tree = scene
    cameras = cameras_around(tree.leaves(), "z", 96)
    views = Views(tree.leaves(), cameras[::4], others=cameras[1::4])
    data = TargetEncoder(tree, PRESETS["scene"], views, polish=40).at_psnr(38)
    assert views.psnr(decode(data).leaves(sh_degree=2)) == pytest.approx(38, abs=0.2)
    assert oracle.decode(data, check_digests=True).dump() == decode(data).dump()
