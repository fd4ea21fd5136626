"""A `.ply` scene against SPZ version 4: size, accuracy, time; and memory of whole runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gsply
import numpy as np

from evogs_codec import (
    PRESETS,
    EvolutionTree,
    FixedSteps,
    Settings,
    SplatParams,
    decode,
    encode,
    lift_with_order,
    read_directory,
    read_ply,
    with_palette,
    write_ply,
)
from evogs_codec.cli.commands import main
from evogs_codec.editing.byte_stats import bytes_by_group
from evogs_codec.lifting.lift import Lifted
from tools.bench.measure import (
    Code,
    errors,
    leaves_in_stream_order,
    peak_memory,
    take_turns,
    take_turns_apart,
)
from tools.bench.peers import from_gsply, write_spz

__all__ = ["TABLES"]

Rows = list[dict[str, object]]
SH_ABOVE_0 = ("sh 1", "sh 2", "sh 3", "picks")
TURNS = 41  # of fewer, the median of the peer moves by a fifth
# The steps at which leaves coded on their own have the errors that preset `scene` gives the leaves
# of a tree: see the errors in the table.
FLAT = Settings(
    FixedSteps((1.18e-4, 0.0027, 0.0624, 0.125, 0.036, 0.118, 0.118, 0.118), relative=True)
)


def size(splats: SplatParams, folder: Path) -> Rows:
    """Bytes per splat and errors: all levels, the leaves alone, SPZ version 4."""
    lifted, splats = _lifted(splats, folder)
    tree = with_palette(lifted, splats) or lifted.tree
    flat = EvolutionTree.of_splats(lifted.tree.leaves())
    flat = with_palette(Lifted(flat, lifted.leaf_of), splats) or flat
    rows: Rows = []
    for name, some, settings, file in (
        ("evogs, 5 levels", tree, PRESETS["scene"], "scene.evogs"),
        ("evogs, the leaves alone", flat, FLAT, "leaves.evogs"),
    ):
        data = encode(some, settings)
        (folder / file).write_bytes(data)
        groups = bytes_by_group(read_directory(data), memoryview(data))
        sh = sum(part.n_bytes for key, part in groups.items() if key in SH_ABOVE_0)
        decoded = decode(data).leaves(sh_degree=splats.sh_degree)
        rows.append(_size_row(name, len(data), sh, decoded, leaves_in_stream_order(some)))
    spz = write_spz(splats, folder / "scene.spz")
    decoded = from_gsply(gsply.read_spz(spz), splats)
    sh_bytes = _spz_sh_bytes(spz)
    rows.append(_size_row("SPZ 4 (no levels)", spz.stat().st_size, sh_bytes, decoded, splats))
    base = rows[1]["bytes"]
    for row in rows:
        row["to leaves alone"] = f"{int(str(row['bytes'])) / int(str(base)):.3f}"
    return rows


def _size_row(
    name: str, n_bytes: int, sh_bytes: float, decoded: SplatParams, original: SplatParams
) -> dict[str, object]:
    n = len(original)
    found = errors(decoded, original)
    return {
        "stream": name,
        "bytes": n_bytes,
        "bytes a splat": f"{n_bytes / n:.2f}",
        "without SH 1+": f"{(n_bytes - sh_bytes) / n:.2f}",
        **{key: f"{value:.3g}" for key, value in found.items()},
    }


def groups(splats: SplatParams, folder: Path) -> Rows:
    """Bytes per splat and group, and what is stored above the order-0 entropy of the planes."""
    data = memoryview((folder / "scene.evogs").read_bytes())
    found = bytes_by_group(read_directory(data), data)
    return [
        {
            "part": name,
            "bytes a splat": f"{part.n_bytes / len(splats):.3f}",
            "order-0 entropy": f"{part.entropy / len(splats):.3f}",
            "over": f"{100 * (part.n_bytes / part.entropy - 1):+.1f} %" if part.entropy else "",
        }
        for name, part in found.items()
        if part.n_bytes
    ]


def decoding(splats: SplatParams, folder: Path) -> Rows:
    """Time of decoding to float arrays against a copy of them and against SPZ version 4.

    Each in a process of its own, then all in one, where glibc keeps more of the memory that others
    free: gsply has 5,450 page faults alone and 480 to 990 after our decoder has run.
    """
    write_spz(splats, folder / "scene.spz")
    scene, leaves = (
        "from pathlib import Path\nfrom evogs_codec import decode_leaves\n"
        f"data = Path({str(folder / name)!r}).read_bytes()"
        for name in ("scene.evogs", "leaves.evogs")
    )
    copied, peer = "numpy.copy of the same bytes", "SPZ 4, gsply (numba)"
    contenders = {
        copied: Code(f"{scene}\narrays = decode_leaves(data).channels()", "arrays.copy()"),
        peer: Code("import gsply", f"gsply.read_spz({str(folder / 'scene.spz')!r})"),
        "evogs decode, the leaves alone": Code(leaves, "decode_leaves(data)"),
        "evogs decode": Code(scene, "decode_leaves(data)"),
        "evogs decode --verify": Code(scene, "decode_leaves(data, verify=True)"),
    }
    apart = take_turns_apart(contenders, TURNS)
    together = take_turns({name: code.runner() for name, code in contenders.items()}, TURNS)
    return [
        {
            "what": name,
            "ms": f"{1000 * apart[name]:.1f}",
            "to a copy": f"{apart[name] / apart[copied]:.1f}",
            "to SPZ 4": f"{apart[name] / apart[peer]:.2f}",
            "in one process, ms": f"{1000 * together[name]:.1f}",
            "there to a copy": f"{together[name] / together[copied]:.1f}",
            "there to SPZ 4": f"{together[name] / together[peer]:.2f}",
        }
        for name in contenders
    ]


def memory(splats: SplatParams, folder: Path) -> Rows:
    """Peak memory of encoding (lifting included) and of decoding, in processes of their own."""
    ply = folder / "scene.ply"
    if not ply.exists():
        write_ply(ply, splats)
    base, _ = peak_memory("import evogs_codec.cli.commands, evogs_codec.decoding.compiled.channels")
    rows: Rows = []
    output = splats.channels().nbytes
    for name, code in (
        (
            "encode with lifting",
            "from evogs_codec.cli.commands import main\n"
            f"main(['encode', {str(ply)!r}, {str(folder / 'again.evogs')!r}])",
        ),
        (
            "decode",
            "from pathlib import Path\nimport evogs_codec.cli.commands\n"
            "from evogs_codec import decode_leaves\n"
            f"decode_leaves(Path({str(folder / 'scene.evogs')!r}).read_bytes())",
        ),
    ):
        peak, seconds = peak_memory(code)
        rows.append(
            {
                "what": name,
                "seconds": f"{seconds:.1f}",
                "peak MiB": f"{peak / 2**20:.0f}",
                "above imports, to the output": f"{(peak - base) / output:.2f}",
            }
        )
    return rows


def default_stream(splats: SplatParams, folder: Path) -> Rows:
    """Time of decoding the stream that `evogs encode` writes, against SPZ version 4.

    Each in a process of its own, wall time and that of all its threads on processors, and the peak
    of one that decodes once.
    """
    stream = folder / "again.evogs"  # of `memory`
    if not stream.exists():
        write_ply(folder / "scene.ply", splats)
        main(["encode", str(folder / "scene.ply"), str(stream)])
    spz = write_spz(splats, folder / "scene.spz")
    scene = (
        "from pathlib import Path\nfrom evogs_codec import decode, decode_leaves\n"
        "import evogs_codec.decoding.compiled.channels\n"
        f"data = Path({str(stream)!r}).read_bytes()"
    )
    peer = "SPZ 4, gsply (numba)"
    contenders = {
        peer: Code("import gsply", f"gsply.read_spz({str(spz)!r})"),
        "evogs decode(data).leaves()": Code(scene, "decode(data).leaves()"),
        "evogs decode_leaves(data)": Code(scene, "decode_leaves(data)"),
    }
    wall = take_turns_apart(contenders, TURNS)
    processor = take_turns_apart(contenders, TURNS, "process_time")
    return [
        {
            "what": name,
            "wall ms": f"{1000 * wall[name]:.1f}",
            "to SPZ 4": f"{wall[name] / wall[peer]:.2f}",
            "processor ms": f"{1000 * processor[name]:.1f}",
            "processor, to SPZ 4": f"{processor[name] / processor[peer]:.2f}",
            "peak MiB": f"{peak_memory(code.before + chr(10) + code.timed)[0] / 2**20:.0f}",
        }
        for name, code in contenders.items()
    ]


TABLES: dict[str, tuple[str, Callable[[SplatParams, Path], Rows]]] = {
    "size": ("Size and accuracy", size),
    "groups": ("Bytes per group, five levels", groups),
    "decoding": ("Time of decoding", decoding),
    "memory": ("Time and memory of whole runs", memory),
    "default_stream": ("Time of decoding the default stream", default_stream),
}


def _lifted(splats: SplatParams, folder: Path) -> tuple[Lifted, SplatParams]:
    """The scene lifted as a reader of its `.ply` has it, and as that one has it."""
    ply = folder / "scene.ply"
    write_ply(ply, splats)
    splats = read_ply(ply)
    return lift_with_order(splats, 5), splats


def _spz_sh_bytes(path: Path) -> int:
    """Compressed bytes of the last stream, SH 1+, from the table of contents of the file."""
    head = path.read_bytes()[:4096]
    n_streams, at = head[15], int.from_bytes(head[16:20], "little")
    sizes = np.frombuffer(head[at : at + 16 * n_streams], "<u8").reshape(n_streams, 2)
    return int(sizes[5, 0]) if n_streams > 5 else 0
