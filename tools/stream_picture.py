"""The moving picture of the README: a stream arrives, and every frame is what is decoded so far.

`make picture` makes the stream from the scene that ships with the project. Bytes arrive at a
constant rate; a frame is fed to `Decoder` up to its byte, rendered, and labelled.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from evogs_codec import Decoder, read_ply
from evogs_codec.io.files import FileKind, check_target, write_atomic
from evogs_codec.render import Camera, load_cameras, psnr, render
from evogs_codec.render.labels import text_line

__all__ = ["frames", "main"]

Real = npt.NDArray[np.floating[Any]]
GIF = FileKind("GIF", (b"GIF8",))
WHITE = (1.0, 1.0, 1.0)
GAP, BAR = 6, 8  # pixels: around the label, and the height of the bar of bytes
SHOWN, HELD = 240, 3000  # milliseconds of a frame, and of the last one
COLOURS = 256  # of the palette: more make a larger file


def main(argv: Sequence[str] | None = None) -> None:
    """Write the GIF."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.stream_picture", description="Show a stream as it arrives, as a GIF."
    )
    parser.add_argument("input", type=Path, metavar="IN.evogs")
    parser.add_argument("output", type=Path, metavar="OUT.gif")
    parser.add_argument("--camera", type=Path, required=True, metavar="FILE.json")
    parser.add_argument("--reference", type=Path, required=True, metavar="SCENE.ply")
    parser.add_argument("--frames", type=int, default=24, metavar="N", help="default: 24")
    parser.add_argument("--width", type=int, default=560, metavar="PIXELS", help="default: 560")
    args = parser.parse_args(argv)
    sources = [args.input, args.camera, args.reference]
    check_target(args.output, GIF, command=parser.prog, sources=sources, force=False)
    camera = load_cameras(args.camera)[0]
    camera = camera.resized(args.width, round(args.width * camera.height / camera.width))
    target = render(read_ply(args.reference), camera, WHITE)
    images = list(frames(args.input.read_bytes(), camera, target, args.frames))
    data = as_gif(images)
    write_atomic(args.output, data)
    print(f"{args.output}: {len(images)} frames, {len(data):,} bytes")


def frames(data: bytes, camera: Camera, target: Real, n: int) -> Iterator[Real]:
    """`n` pictures (H, W, 3) of what the first k / n of the bytes decode to, k = 1..n."""
    decoder, fed = Decoder(), 0
    for end in (len(data) * k // n for k in range(1, n + 1)):
        decoder.feed(data[fed:end])
        fed = end
        splats = decoder.leaves()
        view = np.clip(render(splats, camera, WHITE), 0, 1)
        quality = f"{psnr(view, target):.1f} dB"
        text = f"{end:>{len(f'{len(data):,}')},} bytes  {len(splats):>7,} splats  {quality}"
        yield np.concatenate([view, _caption(text, end / len(data), view.shape[1])])


def _caption(text: str, part: float, width: int) -> Real:
    """A bar of the bytes that are there, and a line of text."""
    line = text_line(text)
    scale = max(1, (width - 2 * GAP) // line.shape[1])
    line = text_line(text, scale=scale)[:, : width - GAP]
    strip = np.ones((BAR + line.shape[0] + 2 * GAP, width, 3), np.float32)
    strip[:BAR] = 0.85
    strip[:BAR, : round(part * width)] = (0.15, 0.4, 0.75)
    strip[BAR + GAP : -GAP, GAP : GAP + line.shape[1]] = line
    return strip


def as_gif(images: Sequence[Real]) -> bytes:
    """An endless GIF whose frames have one palette, so that only what changes takes bytes."""
    pixels = [Image.fromarray(np.rint(255 * image).astype(np.uint8)) for image in images]
    every = Image.fromarray(np.concatenate([np.asarray(image)[::2, ::2] for image in pixels]))
    palette = every.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, kmeans=2)
    flat = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in pixels]
    out = io.BytesIO()
    times = [SHOWN] * (len(flat) - 1) + [HELD]
    flat[0].save(
        out, "GIF", save_all=True, append_images=flat[1:], duration=times, loop=0, optimize=True
    )
    return out.getvalue()


if __name__ == "__main__":
    main()
