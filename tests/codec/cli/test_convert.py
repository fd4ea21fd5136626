"""Every command takes scenes of any format; `convert` and `decode` write what the ending says."""

import subprocess
import sys

import numpy as np
import pytest

from evogs_codec import SceneInfo, decode_leaves, read_directory, read_scene, write_ply, write_scene
from evogs_codec._generated import registry
from evogs_codec.render.demo_scene import make_scene
from tests.support.odd_scenes import odd_scene

ENDINGS = ("ply", "compressed.ply", "spz", "splat", "glb")
pytestmark = pytest.mark.filterwarnings("ignore:.*(infinite opacity|no SH above)")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A folder with the demo scene in every format that is written."""
    folder = tmp_path_factory.mktemp("scenes")
    for ending in ENDINGS:
        write_scene(folder / f"x.{ending}", make_scene(300), SceneInfo(antialiased=True))
    return folder


@pytest.mark.parametrize("source", ENDINGS)
@pytest.mark.parametrize("target", ENDINGS)
def test_any_format_is_converted_to_any_other(source, target, scenes, evogs, tmp_path):
    out = tmp_path / f"y.{target}"
    code, said, _ = evogs("convert", scenes / f"x.{source}", out)
    degree = 0 if "splat" in (source, target) else 3
    assert (code, said) == (0, f"{out}: 300 splats, SH degree {degree}\n")
    found, original = read_scene(out).splats, read_scene(scenes / f"x.{source}").splats
    ours, theirs = np.sort(found.means, axis=0), np.sort(original.means, axis=0)
    assert np.abs(ours - theirs).max() < (1 if target == "compressed.ply" else 3e-4)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_stream_says_what_the_format_of_its_scene_says(ending, scenes, evogs, tmp_path):
    out = tmp_path / "x.evogs"
    assert evogs("encode", scenes / f"x.{ending}", out, "--preset", "scene", "--levels", 2)[0] == 0
    info = read_directory(out.read_bytes()).info
    known = ending in ("spz", "glb")  # z is up in the scene, which the ground of an .spz tells
    assert registry.COORDINATE_SYSTEMS[info.coordinate_system] == (
        "RDF" if known else "unspecified"
    )
    assert registry.UP_AXES[info.up_axis] == ("-y" if ending == "glb" else "unspecified")
    assert registry.COLOUR_SPACES[info.colour_space] == (
        "srgb" if ending == "glb" else "unspecified"
    )
    assert info.antialiased == (ending not in ("glb", "splat"))


def test_options_say_more_than_the_file(scenes, evogs, tmp_path):
    words = ["--preset", "scene", "--levels", 2, "--up-axis", "+z", "--colour-space", "linear"]
    assert evogs("encode", scenes / "x.glb", tmp_path / "x.evogs", *words, "--antialiased")[0] == 0
    info = read_directory((tmp_path / "x.evogs").read_bytes()).info
    assert registry.UP_AXES[info.up_axis] == "+z"
    assert registry.COLOUR_SPACES[info.colour_space] == "linear"
    assert registry.COORDINATE_SYSTEMS[info.coordinate_system] == "RDF"
    assert info.antialiased


def test_comments_of_a_ply_reach_the_header_of_the_stream_and_the_ply_of_it(evogs, tmp_path):
    comments = ["Exported from Brush", "Vertical axis: 0 -1 0", "SplatRenderMode: mip"]
    write_ply(tmp_path / "x.ply", make_scene(60), comments)
    assert evogs("encode", tmp_path / "x.ply", tmp_path / "x.evogs", "--levels", 2)[0] == 0
    info = read_directory((tmp_path / "x.evogs").read_bytes()).info
    assert (info.antialiased, registry.UP_AXES[info.up_axis]) == (True, "-y")
    assert info.text["source"] == "Exported from Brush"
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "y.ply")[0] == 0
    back = read_scene(tmp_path / "y.ply").info
    assert (back.antialiased, back.up_axis) == (True, info.up_axis)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_stream_is_decoded_to_any_format(ending, made, evogs, tmp_path):
    out = tmp_path / f"x.{ending}"
    assert evogs("decode", made / "scene.evogs", out, "--level", 2)[0] == 0
    expected = tmp_path / "x.ply"
    assert evogs("decode", made / "scene.evogs", expected, "--level", 2)[0] == 0
    found, ply = read_scene(out).splats, read_scene(expected).splats
    assert len(found) == len(ply) > 100
    assert np.abs(np.sort(found.means, axis=0) - np.sort(ply.means, axis=0)).max() < 10


@pytest.mark.parametrize("frame", ["RDF", "RUB", "RFU"])
def test_a_stream_is_turned_from_its_axes_to_those_of_the_format(frame, evogs, tmp_path):
    write_ply(tmp_path / "x.ply", odd_scene(40, 1))
    words = ["--near-lossless", "--levels", 2, "--coordinate-system", frame]
    assert evogs("encode", tmp_path / "x.ply", tmp_path / "x.evogs", *words)[0] == 0
    means = decode_leaves((tmp_path / "x.evogs").read_bytes()).means
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "x.glb")[0] == 0
    x, y, z = means.T
    in_rdf = {"RDF": (x, y, z), "RUB": (x, -y, -z), "RFU": (x, -z, y)}[frame]
    found = read_scene(tmp_path / "x.glb").splats.means
    np.testing.assert_allclose(found, np.stack(in_rdf, axis=1), atol=1e-6)


@pytest.mark.parametrize("ending", ENDINGS)
def test_pictures_are_rendered_of_every_format(ending, scenes, evogs, tmp_path):
    out = tmp_path / "x.png"
    assert evogs("render", scenes / f"x.{ending}", out, "--size", 16)[0] == 0
    assert out.stat().st_size > 100
    code, said, _ = evogs("psnr", scenes / f"x.{ending}", scenes / "x.ply", "--size", 16)
    assert code == 0
    assert float(said.split()[0]) > 20


def test_lift_takes_an_spz(scenes, evogs, tmp_path):
    code, said, _ = evogs("lift", scenes / "x.spz", tmp_path / "x.tree.npz", "--levels", 2)
    assert (code, said.split(": ")[1]) == (0, "300 splats, 2 levels\n")


def test_an_unknown_ending_is_refused_with_the_list_before_the_work(scenes, refused, tmp_path):
    for command, source in (("convert", "x.ply"), ("decode", "absent.evogs")):
        words = ["x.obj", ".compressed.ply, .ply, .spz, .splat, .glb"]
        refused(command, scenes / source, tmp_path / "x.obj", words=words)
    refused("convert", scenes / "x.ply", tmp_path / "x.evogs", words=["evogs encode"])


@pytest.mark.parametrize("ending", ENDINGS[:-1])  # a .glb holds the stream as it is
def test_a_stream_is_converted_as_decode_writes_it(ending, made, evogs, tmp_path):
    for command in ("convert", "decode"):
        out = tmp_path / f"{command}.{ending}"
        assert evogs(command, made / "scene.evogs", out)[0] == 0
    found, expected = (
        read_scene(tmp_path / f"{command}.{ending}").splats for command in ("convert", "decode")
    )
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("command", ["encode", "extract"])
@pytest.mark.parametrize("name", ["x.ply", "x.compressed.ply", "x.spz", "x.sog", "x.gltf"])
def test_a_stream_is_not_written_by_the_name_of_a_scene(command, name, made, refused, tmp_path):
    source = made / ("scene.ply" if command == "encode" else "scene.evogs")
    refused(command, source, tmp_path / name, words=[name, "name an .evogs", "evogs convert"])
    assert list(tmp_path.iterdir()) == []


def test_a_picture_of_another_ending_is_refused_with_the_list(made, refused, tmp_path):
    words = ["x.gif", ".png, .jpg, .jpeg"]
    refused("render", made / "scene.evogs", tmp_path / "x.gif", words=words)


@pytest.mark.parametrize(("ending", "name"), [("spz", ".spz"), ("glb", ".gltf"), ("ply", ".ply")])
def test_a_scene_given_as_a_stream_is_told_what_it_is(ending, name, scenes, refused):
    words = [f"is a {name} scene, not a stream", "evogs encode"]
    refused("info", scenes / f"x.{ending}", words=words)


def test_a_file_that_names_no_maker_is_replaced_with_force_alone(scenes, evogs, refused, tmp_path):
    for ending in ("spz", "splat"):
        words = ["convert", scenes / "x.ply", tmp_path / f"y.{ending}"]
        assert evogs(*words)[0] == 0
        refused(*words, words=["was not made by `evogs convert`", "--force"])
        assert evogs(*words, "--force")[0] == 0
    for ending in ("ply", "compressed.ply", "glb"):
        words = [scenes / "x.spz", tmp_path / f"z.{ending}"]
        assert evogs("convert", *words)[0] == 0
        assert evogs("convert", *words)[0] == 0
        write_scene(tmp_path / f"z.{ending}", make_scene(10))
        refused("convert", *words, words=["was not made by `evogs convert`"])


def test_splats_with_nan_are_dropped_as_asked(evogs, refused, tmp_path):
    scene = odd_scene(20, 0)
    means = scene.means.copy()
    means[3] = np.nan
    arrays = [means, scene.quats, scene.log_scales, scene.opacity_logits, scene.sh]
    write_ply(tmp_path / "x.ply", type(scene)(*arrays))
    words = ["convert", tmp_path / "x.ply", tmp_path / "x.glb"]
    refused(*words, words=["1 of 20 splats have a NaN", "--drop-invalid"])
    assert evogs(*words, "--drop-invalid")[0] == 0
    assert len(read_scene(tmp_path / "x.glb").splats) == 19


@pytest.mark.parametrize("command", ["convert", "encode", "render", "psnr", "lift"])
def test_a_damaged_file_is_refused_in_one_line_by_every_command(command, scenes, refused, tmp_path):
    (tmp_path / "x.spz").write_bytes((scenes / "x.spz").read_bytes()[:200])
    last = scenes / "x.ply" if command == "psnr" else tmp_path / "out"
    refused(command, tmp_path / "x.spz", last, words=[tmp_path / "x.spz", "cut short"])


def test_a_folder_that_is_no_sog_is_refused_in_one_line(refused, tmp_path):
    (tmp_path / "folder").mkdir()
    for command, said in (
        ("convert", "is not a file"),
        ("encode", "no scene is in this folder"),
        ("lift", "is not a file"),
    ):
        refused(command, tmp_path / "folder", tmp_path / "out", words=[said])


def piped(*words, data=b""):
    """A command of its own with bytes on standard input; (exit code, bytes out, text of errors)."""
    command = [sys.executable, "-m", "evogs", *map(str, words)]
    done = subprocess.run(command, input=data, capture_output=True, check=False)
    return done.returncode, done.stdout, done.stderr.decode()


def test_a_dash_is_standard_input_or_output(scenes, made, tmp_path):
    data = (scenes / "x.spz").read_bytes()
    code, out, said = piped("convert", "-", "-", data=data)
    assert code == 0
    assert said.splitlines()[-1].endswith("300 splats, SH degree 3")
    (tmp_path / "x.ply").write_bytes(out)
    expected = read_scene(scenes / "x.spz").splats
    np.testing.assert_array_equal(read_scene(tmp_path / "x.ply").splats.means, expected.means)
    code, out, said = piped("convert", "-", tmp_path / "x.glb", data=data)
    assert (code, len(read_scene(tmp_path / "x.glb").splats)) == (0, 300)
    assert out.decode().startswith(str(tmp_path / "x.glb"))
    stream = (made / "scene.evogs").read_bytes()
    code, out, said = piped("extract", "-", "-", "--level", 2, data=stream)
    assert (code, len(decode_leaves(out))) == (0, 768), said
    code, out, said = piped("decode", "-", "-", data=b"no stream")
    assert (code, out, said.count("\n")) == (1, b"", 1)
    assert said.startswith("evogs: standard input: is not an EvoGS stream")


@pytest.mark.thorough
def test_messages_about_a_dash_say_standard_input_and_no_temporary_path(scenes, made, tmp_path):
    code, out, said = piped("decode", "-", "-", data=(scenes / "x.spz").read_bytes())
    assert (code, out, said.count("\n")) == (1, b"", 1)
    assert "standard input: is a .spz scene" in said
    assert "`evogs encode - OUT.evogs` makes one" in said
    stream = (made / "scene.evogs").read_bytes()
    code, out, said = piped("validate", "-", data=stream)
    assert (code, said) == (0, "")
    assert out.startswith(b"standard input: valid, 3,000 splats")
    code, _, said = piped("validate", "-", data=stream[:-9])
    assert code == 1
    assert said.startswith("evogs: standard input: E_TRUNCATED")
    code, _, said = piped("decode", "-", "-", data=stream)
    assert (code, said) == (0, "standard output: 3,000 splats, SH degree 3\n")
    scene = make_scene(20)
    logits = np.where(np.arange(20) == 3, np.inf, scene.opacity_logits)
    arrays = (scene.means, scene.quats, scene.log_scales, logits, scene.sh)
    write_ply(tmp_path / "x.ply", type(scene)(*arrays))
    code, _, said = piped("convert", "-", "-", data=(tmp_path / "x.ply").read_bytes())
    first, second = said.splitlines()
    assert (code, second) == (0, "standard output: 20 splats, SH degree 3")
    assert first.startswith("evogs: warning: standard input: 1 ")
