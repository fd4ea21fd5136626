"""All wrong renderers on all images: their fingerprints and their table in the documentation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from conformance.renders.candidate import Result, judged
from conformance.renders.fingerprints import Fingerprint, as_json, of_results, read_fingerprints
from conformance.renders.manifest import FOLDER, Suite
from conformance.renders.mutants import RIGHT, WRONG
from conformance.renders.rendering import Rendering, picture

__all__ = ["between", "results_of", "scene_table", "table", "try_all"]

PAGE = FOLDER.parents[1] / "docs" / "render-conformance.md"


def try_all(
    suite: Suite, names: Sequence[str] = (), *, folder: Path = FOLDER, page: Path = PAGE
) -> Iterator[str]:
    """Write fingerprints and table; yields a line per renderer that is not judged as it should.

    Args:
        suite: the images.
        names: only these renderers, the fingerprints of the others are kept; none: all.
        folder: of the fingerprints.
        page: with the table.
    """
    kept = {one.name: one for one in read_fingerprints(suite, folder) if names}
    for rendering in RIGHT:
        if names and rendering.name not in names:
            continue
        for result in results_of(rendering, suite):
            if result.failed:
                yield f"{rendering.name} {rendering.says}, but {result.image.id}: {result.says}"
    found = []
    for rendering in WRONG:
        if rendering.name in kept and rendering.name not in names:
            found.append(kept[rendering.name])
            continue
        found.append(of_results(rendering.name, rendering.says, results_of(rendering, suite)))
        if not found[-1].psnr:
            yield f"{rendering.name} passes: {rendering.says}"
    (folder / "fingerprints.json").write_text(as_json(suite, found), encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    for part, made in (("scenes", scene_table(suite)), ("wrong renderers", table(suite, found))):
        old = f"<!-- {part} -->\n{between(text, part)}<!-- end"
        text = text.replace(old, f"<!-- {part} -->\n{made}<!-- end")
    page.write_text(text, encoding="utf-8")


def results_of(rendering: Rendering, suite: Suite) -> list[Result]:
    """What is said of its pictures."""
    return [judged(suite, image, picture(rendering, suite, image)) for image in suite.images]


def between(text: str, part: str) -> str:
    """What stands between the two marks of a part of the page."""
    return text.split(f"<!-- {part} -->\n")[1].split(f"<!-- end of {part} -->\n")[0]


def scene_table(suite: Suite) -> str:
    """A row per scene: images, splats, what is doubtful, how close two right renderers are."""
    lines = ["| | images | splats | doubtful pixels | fast renderer and oracle differ by | tests |"]
    lines.append("|---|---|---|---|---|---|")
    for scene in suite.scenes.values():
        images = [image for image in suite.images if image.scene == scene.id]
        pixels = images[0].camera["width"] * images[0].camera["height"]
        doubtful = max(image.n_doubtful for image in images) / pixels
        lines.append(
            f"| {scene.id} | {len(images)} | {max(image.n_splats for image in images)}"
            f" | {f'{doubtful:.2%}' if doubtful else 'none'}"
            f" | {max(image.measured for image in images):.0e} | {scene.tests} |"
        )
    return "\n".join(lines) + "\n"


def table(suite: Suite, known: Sequence[Fingerprint]) -> str:
    """A row per wrong renderer: what it does, how many images it fails, and of which scenes."""
    lines = [f"| | a renderer in which | fails, of {len(suite.images)} | in |", "|---|---|---|---|"]
    scene_of = {image.id: image.scene for image in suite.images}
    for one in known:
        scenes = {scene_of[id_] for id_ in one.psnr}
        where = ", ".join(s for s in suite.scenes if s in scenes)
        if len(scenes) > 5:
            where = f"{len(scenes)} scenes"
        lines.append(f"| {one.name} | {one.says} | {len(one.psnr)} | {where} |")
    return "\n".join(lines) + "\n"
