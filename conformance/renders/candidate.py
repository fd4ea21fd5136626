"""A renderer under test: one process per image, in a folder of its own, under watch."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from conformance.harness.running.oneshot import last_words, over
from conformance.harness.running.process import Bounds, clean_environment, run
from conformance.harness.running.scratch import read_regular, scratch
from conformance.renders.judging import Numbers, judge, read_golden, read_picture
from conformance.renders.manifest import Image, Suite
from conformance.renders.png import Pixels, PngError

__all__ = ["Renderer", "Result", "ask_all", "judged"]

UNSUPPORTED = 127


@dataclass(frozen=True)
class Renderer:
    """How to run it.

    Attributes:
        command: its words.
        bounds: what a process may use.
        passed: names of environment variables that it gets from ours.
    """

    command: tuple[str, ...]
    bounds: Bounds
    passed: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Result:
    """What came of an image.

    Attributes:
        image: what was asked.
        kind: "pass", "fail", "unsupported", or "no picture": a crash, a limit, not a PNG file.
        says: what is wrong, in a sentence; "" if nothing.
        numbers: how far the picture is from the golden one; None without a picture.
        pixels: the picture, kept where it fails.
        seconds: wall time.
    """

    image: Image
    kind: str
    says: str
    numbers: Numbers | None
    pixels: Pixels | None
    seconds: float

    @property
    def failed(self) -> bool:
        """Whether the renderer is wrong."""
        return self.kind in ("fail", "no picture")


def ask_all(
    suite: Suite, images: Sequence[Image], renderer: Renderer, *, jobs: int = 1
) -> Iterator[Result]:
    """The result of each image, in their order."""
    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(lambda image: ask(suite, image, renderer), images)


def ask(suite: Suite, image: Image, renderer: Renderer) -> Result:
    """Have one image rendered and judge it."""
    with scratch() as folder:
        home = folder / "home"
        home.mkdir()
        # Names say nothing of what is expected.
        stream, camera, target = (
            folder / f"{secrets.token_hex(4)}{ending}" for ending in (".evogs", ".json", ".png")
        )
        stream.write_bytes(suite.stream(image))
        camera.write_text(json.dumps({"cameras": [image.camera]}), encoding="utf-8")
        arguments = ["--in", stream, "--camera", camera, "--level", image.level]
        arguments += ["--background", *image.background, "--out", target]
        arguments += ["--antialiased"] * suite.scenes[image.scene].antialiased
        try:
            ended = run(
                [*renderer.command, *map(str, arguments)],
                home,
                clean_environment(home, renderer.passed),
                renderer.bounds,
                written=[folder],
            )
        except OSError as error:
            wrong = f"the command cannot be started: {error}"
            return Result(image, "no picture", wrong, None, None, 0.0)
        if ended.over:
            _, wrong = over(ended.over, renderer.bounds)
            return Result(image, "no picture", wrong, None, None, ended.seconds)
        if ended.status == UNSUPPORTED:
            return Result(image, "unsupported", "", None, None, ended.seconds)
        if ended.status != 0:
            wrong = f"exit status {ended.status}{last_words(ended.stderr)}"
            return Result(image, "no picture", wrong, None, None, ended.seconds)
        picture = read_regular(target, renderer.bounds.written)
        if picture is None:
            return Result(image, "no picture", "no file", None, None, ended.seconds)
        try:
            pixels = read_picture(picture, image)
        except PngError as error:
            wrong = f"the file is not as asked: {error}"
            return Result(image, "no picture", wrong, None, None, ended.seconds)
    return judged(suite, image, pixels, ended.seconds)


def judged(suite: Suite, image: Image, pixels: Pixels, seconds: float = 0.0) -> Result:
    """The result of a picture."""
    numbers = judge(image, read_golden(suite, image), pixels)
    if numbers.failures:
        return Result(image, "fail", "; ".join(numbers.failures), numbers, pixels, seconds)
    return Result(image, "pass", "", numbers, None, seconds)
