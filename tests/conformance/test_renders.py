"""Golden renders: right renderers pass, wrong ones fail, and the run says which and why."""

import dataclasses
import io
import json
import shlex
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow

from conformance.harness.manifest import SuiteError
from conformance.renders.candidate import Result, judged
from conformance.renders.cli import main
from conformance.renders.fingerprints import likenesses, of_results, read_fingerprints
from conformance.renders.generate import MAX_DOUBTFUL, check, make_all
from conformance.renders.judging import judge, read_golden
from conformance.renders.manifest import FOLDER, load
from conformance.renders.mutants import RIGHT, WRONG
from conformance.renders.png import PngError, decode_png, encode_png
from conformance.renders.reference import to_pixels
from conformance.renders.rendering import picture
from conformance.renders.scenes import SCENES
from conformance.renders.trial import PAGE, between, scene_table, table
from evogs_codec import Cut, decode, read_directory
from evogs_codec.render import Camera, Options, render

SUITE = load()
KNOWN = {one.name: one for one in read_fingerprints(SUITE)}
BY_ID = {image.id: image for image in SUITE.images}


def reference(image):
    """What the fast renderer makes of an image."""
    data = SUITE.stream(image)
    cut = Cut.of_level(read_directory(data), image.level)
    options = Options(antialiased=SUITE.scenes[image.scene].antialiased)
    splats = decode(data, cut).leaves()
    return render(splats, Camera(**image.camera), image.background, options=options)


# --- the suite ------------------------------------------------------------------------------------


def test_there_are_twelve_scenes_with_three_cameras_and_all_their_levels():
    assert len(SUITE.scenes) >= 12
    for scene in SUITE.scenes.values():
        views = {(image.view, image.level) for image in SUITE.images if image.scene == scene.id}
        assert len({view for view, _ in views}) == 3
        assert len(views) == 3 * scene.n_levels
    files = [path for path in FOLDER.rglob("*") if path.suffix[:3] != ".py"]
    assert sum(path.stat().st_size for path in files) < 2.5e6


@pytest.mark.thorough
@pytest.mark.parametrize("scene", ["ties", "kinds", "near", "sh-2"])
def test_streams_goldens_and_entries_are_what_the_recipes_make(scene):
    assert not check(FOLDER, tuple(s for s in SCENES if s.id == scene))


@pytest.mark.thorough
def test_a_file_that_the_recipes_do_not_make_is_noticed(tmp_path):
    scenes = tuple(s for s in SCENES if s.id == "sh-1")
    for name, data in make_all(scenes).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    golden = tmp_path / "goldens" / "sh-1.top.L0.png"
    right = decode_png(golden.read_bytes(), width=96, height=72)
    other = np.where(right > 128, right - 1, right)
    for pixels, different in ((other, []), (other // 2 + 64, ["goldens/sh-1.top.L0.png"])):
        golden.write_bytes(encode_png(pixels.astype(np.uint8)))
        assert check(tmp_path, scenes) == different
    (tmp_path / "streams" / "sh-1.evogs").write_bytes(SUITE.stream(BY_ID["sh-2.top.L0"]))
    manifest = tmp_path / "renders.json"
    manifest.write_text(manifest.read_text().replace('"max_over": 3', '"max_over": 4'))
    golden.unlink()
    assert check(tmp_path, scenes) == [
        "goldens/sh-1.top.L0.png",
        "renders.json",
        "streams/sh-1.evogs",
    ]


def test_no_file_is_there_that_the_manifest_does_not_name():
    named = {image.golden for image in SUITE.images}
    named |= {scene.file for scene in SUITE.scenes.values()}
    there = [*FOLDER.glob("goldens/*"), *FOLDER.glob("streams/*")]
    assert {path.relative_to(FOLDER).as_posix() for path in there} == named


def test_few_pixels_are_doubtful_and_the_manifest_counts_them():
    for image in SUITE.images:
        stable = read_golden(SUITE, image).stable
        assert np.count_nonzero(~stable) == image.n_doubtful <= MAX_DOUBTFUL * stable.size


def test_a_changed_file_of_the_suite_is_noticed(tmp_path):
    for path in ("renders.json", "streams", "goldens"):
        (tmp_path / path).symlink_to(FOLDER / path)
    assert load(tmp_path).images == SUITE.images
    (tmp_path / "renders.json").unlink()
    text = (FOLDER / "renders.json").read_text().replace(SUITE.images[0].sha256, "0" * 64)
    (tmp_path / "renders.json").write_text(text)
    with pytest.raises(SuiteError, match="not the file of the manifest"):
        load(tmp_path)


# --- right and wrong renderers --------------------------------------------------------------------


@pytest.mark.parametrize("step", [5, pytest.param(1, marks=pytest.mark.thorough)])
def test_the_fast_renderer_passes_every_image_with_the_margin_that_is_stated(step):
    for image in SUITE.images[::step]:
        drawn = reference(image)
        for dtype in (np.uint8, np.uint16):
            numbers = judge(image, read_golden(SUITE, image), to_pixels(drawn, dtype))
            assert not numbers.failures, image.id
            assert numbers.n_over == 0
            assert numbers.error < 1e-4
        assert 10 * image.measured <= image.thresholds.max_error


@pytest.mark.thorough
@pytest.mark.parametrize("rendering", RIGHT, ids=lambda r: r.name)
def test_other_right_renderers_pass(rendering):
    for image in SUITE.images[::4]:
        result = judged(SUITE, image, picture(rendering, SUITE, image))
        assert not result.failed, (image.id, result.says)


@pytest.mark.thorough
@pytest.mark.parametrize("rendering", WRONG, ids=lambda r: r.name)
def test_a_wrong_renderer_fails_as_its_fingerprint_says(rendering):
    psnr = KNOWN[rendering.name].psnr
    assert psnr, "no image fails"
    # The image that fails by the least: if that still does, so do the others.
    image = BY_ID[max(psnr, key=lambda id_: (psnr[id_], id_))]
    result = judged(SUITE, image, picture(rendering, SUITE, image))
    assert result.numbers is not None
    assert result.numbers.failures
    assert result.numbers.psnr == pytest.approx(psnr[image.id], abs=0.05)


def test_fingerprints_and_the_table_of_the_documentation_are_of_these_renderers():
    assert [(r.name, r.says) for r in WRONG] == [(one.name, one.says) for one in KNOWN.values()]
    text = PAGE.read_text(encoding="utf-8")
    assert between(text, "wrong renderers") == table(SUITE, list(KNOWN.values()))
    assert between(text, "scenes") == scene_table(SUITE)


@pytest.mark.parametrize("name", ["xyzw", "no-dilation", "sh-opposite", "half-pixel", "at-near"])
def test_a_mistake_is_named(name):
    (rendering,) = (r for r in WRONG if r.name == name)
    ids = sorted(KNOWN[name].psnr)[:4]
    results = [judged(SUITE, BY_ID[i], picture(rendering, SUITE, BY_ID[i])) for i in ids]
    assert any(rendering.says in says for says in likenesses(results, list(KNOWN.values())))
    # A renderer that is wrong in another way is not said to be this one.
    other = [dataclasses.replace(KNOWN[name], psnr={i: KNOWN[name].psnr[i] - 1 for i in ids})]
    assert not likenesses(results, other)


def test_a_right_renderer_resembles_no_wrong_one():
    image = SUITE.images[0]
    result = Result(image, "pass", "", None, None, 0.0)
    assert not of_results("", "", [result]).psnr
    assert not likenesses([result], list(KNOWN.values()))


# --- judging --------------------------------------------------------------------------------------


def test_an_error_counts_beyond_rounding_and_at_stable_pixels_only():
    image = next(image for image in SUITE.images if image.n_doubtful > 10)
    golden = read_golden(SUITE, image)
    right = to_pixels(golden.image)
    y, x = np.argwhere(golden.stable & (right.max(2) < 200))[:4].T

    def error(n, steps):
        wrong = right.copy()
        wrong[y[:n], x[:n]] += steps
        return judge(image, golden, wrong)

    assert error(4, 2).failures == ()  # one step of error, one of rounding
    assert error(4, 2).error == pytest.approx(1 / 255)
    assert error(3, 20).failures == ()
    assert error(4, 3).n_over == 4
    assert "4 stable pixels are off" in error(4, 3).failures[0]
    unstable = right.copy()
    unstable[~golden.stable] ^= 255
    numbers = judge(image, golden, unstable)
    assert numbers.failures == ()
    assert numbers.n_doubtful_over == image.n_doubtful
    assert numbers.psnr == np.inf


def test_the_quality_of_a_level_is_judged():
    image = BY_ID["lifted.front.L0"]
    golden = read_golden(SUITE, image)
    found = judge(image, golden, to_pixels(golden.image)).level_psnr
    assert found is not None
    assert found == pytest.approx(image.level_psnr, abs=1e-3)
    other = dataclasses.replace(image, level_psnr=found + 0.6)
    (failure,) = judge(other, golden, to_pixels(golden.image)).failures
    assert failure.startswith("against the finest level")


# --- PNG ------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32), st.sampled_from([3, 4]), st.sampled_from([np.uint8, np.uint16]))
def test_a_png_file_has_the_pixels_that_were_written(seed, channels, dtype):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 9, 2)
    steps = rng.integers(0, 300, (height, width, channels)) * 20
    pixels = np.cumsum(steps, axis=1).astype(dtype)
    data = encode_png(pixels)
    back = decode_png(data, width=width, height=height)
    assert back.dtype == dtype
    assert np.array_equal(back, pixels)
    if dtype == np.uint8:
        assert np.array_equal(np.asarray(Pillow.open(io.BytesIO(data))), pixels)


@pytest.mark.parametrize("channels", [3, 4])
def test_files_of_another_writer_are_read(channels):
    y, x, c = np.mgrid[:40, :50, :channels]
    noise = np.random.default_rng(1).integers(0, 9, y.shape)
    pixels = (3 * x + 2 * y + x * y // 20 * (1 + c) + noise).astype(np.uint8)
    file = io.BytesIO()
    Pillow.fromarray(pixels).save(file, "png")
    assert np.array_equal(decode_png(file.getvalue(), width=50, height=40), pixels)


def test_every_filter_is_undone():
    pixels = np.random.default_rng(2).integers(0, 256, (1, 7, 3), np.uint8).repeat(6, 0)
    pixels = (pixels + np.arange(6, dtype=np.uint8)[:, None, None] ** 2).astype(np.uint8)
    padded = np.zeros((7, 8, 3), int)
    padded[1:, 1:] = pixels
    a, b, c = padded[1:, :-1], padded[:-1, 1:], padded[:-1, :-1]
    p = a + b - c
    far = np.stack([abs(p - a), abs(p - b), abs(p - c)])
    paeth = np.choose(far.argmin(0), [a, b, c])
    coded = [pixels - guess for guess in (0 * a, a, b, (a + b) // 2, paeth)]
    lines = [bytes([y % 5]) + (coded[y % 5][y] & 255).astype(np.uint8).tobytes() for y in range(6)]
    file = io.BytesIO()
    Pillow.fromarray(pixels).save(file, "png")
    data = _with_pixels(file.getvalue(), b"".join(lines))
    assert np.array_equal(decode_png(data, width=7, height=6), pixels)


def _with_pixels(data, raw):
    """A PNG file with other filtered lines."""
    body = zlib.compress(raw)
    start = data.index(b"IDAT")
    chunk = len(body).to_bytes(4, "big") + b"IDAT" + body
    chunk += zlib.crc32(b"IDAT" + body).to_bytes(4, "big")
    return data[: start - 4] + chunk + data[data.index(b"IEND") - 4 :]


def test_what_is_not_the_file_that_was_asked_for_is_refused():
    good = encode_png(np.zeros((4, 6, 3), np.uint8))
    bad = {
        "signature": b"GIF89a" + good,
        "6 x 4 pixels": good,
        "cut short|within": good[:-3],
        "CRC": good[:20] + b"\1" + good[21:],
        "IEND": good[:-12],
        "unpack": _with_pixels(good, bytes(4 * 19 + 1)),
        "unpack to": _with_pixels(good, bytes(10)),
        "filter 9": _with_pixels(good, b"\x09" + bytes(4 * 19 - 1)),
    }
    for words, data in bad.items():
        height = 5 if words == "6 x 4 pixels" else 4
        with pytest.raises(PngError, match=words):
            decode_png(data, width=6, height=height)
    grey = io.BytesIO()
    Pillow.fromarray(np.zeros((4, 6), np.uint8)).save(grey, "png")
    with pytest.raises(PngError, match="colour type 0"):
        decode_png(grey.getvalue(), width=6, height=4)


# --- runs -----------------------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path, capsys):
    """Run a program as a renderer; returns (exit code, text, report as JSON, pictures)."""

    def start(program, *arguments):
        file = tmp_path / "renderer.py"
        file.write_text(program)
        command = shlex.join([sys.executable, str(file)])
        paths = ["--json", str(tmp_path / "r.json"), "--html", str(tmp_path / "r.html")]
        folder = tmp_path / "pictures"
        code = main(["run", "--renderer", command, "--report", str(folder), *paths, *arguments])
        report = json.loads((tmp_path / "r.json").read_text())
        assert report["exit"] == code
        assert "<title>" in (tmp_path / "r.html").read_text()
        return code, capsys.readouterr().out, report, sorted(folder.glob("*.png"))

    return start


COPY = f"""
import shutil, sys
shutil.copy({str(FOLDER / "goldens" / "kinds.top.L3.png")!r}, sys.argv[sys.argv.index("--out") + 1])
"""


def test_a_right_picture_passes_and_a_wrong_one_is_shown_beside_the_golden(run):
    code, text, report, pictures = run(COPY, "--id", "kinds.top.L3")
    assert (code, pictures) == (0, [])
    assert "all 1 pictures of this selection are right" in text
    assert not report["complete"]
    code, text, report, pictures = run(COPY, "--id", "kinds.top.L[23]")
    assert code == 1
    assert "FAIL kinds.top.L2" in text
    assert [path.name for path in pictures] == ["kinds.top.L2.png"]
    assert decode_png(pictures[0].read_bytes(), width=3 * (3 * 96 + 8), height=3 * 72).any()
    assert {r["id"]: r["kind"] for r in report["results"]} == {
        "kinds.top.L3": "pass",
        "kinds.top.L2": "fail",
    }


@pytest.mark.parametrize(
    ("program", "id_", "code", "words"),
    [
        ("raise SystemExit(127)", "antialiased.top.L0", 3, "INCOMPLETE"),
        ("raise SystemExit(127)", "sh-1.top.L0", 3, "INCOMPLETE"),
        ("raise SystemExit(1)", "sh-1.top.L0", 1, "exit status 1"),
        ("raise ValueError('a reason')", "sh-1.top.L0", 1, "a reason"),
        ("pass", "sh-1.top.L0", 1, "no file"),
        (COPY, "off-screen.tall.L0", 1, "96 x 72 pixels, not 72 x 96"),
        ("pass", "no such image", 3, "nothing was asked"),
    ],
)
def test_a_renderer_without_pictures_does_not_pass(run, program, id_, code, words):
    found, text, _, _ = run(program, "--id", id_)
    assert found == code
    assert words in text


@pytest.mark.thorough
def test_a_renderer_that_hangs_is_stopped(run):
    code, text, _, _ = run("import time; time.sleep(60)", "--id", "sh-1.top.L0", "--timeout", "0.5")
    assert code == 1
    assert "time limit" in text


def test_the_antialiased_mode_may_be_left_out(run):
    program = "import sys\nif '--antialiased' in sys.argv: raise SystemExit(127)\n" + COPY
    code, text, _, _ = run(program, "--id", "kinds.top.L3", "--id", "antialiased.*")
    assert code == 0
    assert "3 that need the antialiased mode left out" in text


def test_the_reference_renderer_works_as_a_command(tmp_path):
    image = BY_ID["antialiased.top.L0"]
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"cameras": [image.camera]}))
    out = tmp_path / "out.png"
    command = [sys.executable, "-m", "conformance.renders", "reference", "--antialiased"]
    command += ["--in", str(FOLDER / SUITE.scenes[image.scene].file), "--camera", str(camera)]
    command += ["--level", "0", "--background", *map(str, image.background), "--out", str(out)]
    subprocess.run(command, check=True, cwd=Path(__file__).parents[2])
    pixels = decode_png(out.read_bytes(), width=96, height=72)
    assert pixels.dtype == np.uint16
    assert not judged(SUITE, image, pixels).failed


def test_judging_needs_neither_numba_nor_the_codec():
    program = (
        "import sys\n"
        "for name in ('numba', 'evogs_codec', 'scipy', 'zstandard'): sys.modules[name] = None\n"
        "from conformance.renders.cli import main\n"
        "raise SystemExit(main(['run', '--renderer', 'false', '--id', 'sh-1.top.L0']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False,
        cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, "")
    assert "exit status 1" in done.stdout
