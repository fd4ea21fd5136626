"""Keep the spec, its CSV files and the codec's tables the same: `python -m tools.spec_tables`.

Writes the tables between the `<!-- table NAME -->` and `<!-- end NAME -->` marks of
`spec/evogs.md` from the declarations of `evogs_codec.format.layout` and from `spec/*.csv`, the
worked examples (`tools/example.py`, `tools/example_2.py`) there and as `spec/example.evogs` and
`spec/example-2.evogs`, and the modules of
`evogs_codec/_generated/` from the CSV files. `--check` writes nothing and fails if anything would
change.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SPEC = ROOT / "spec"


def rows(name: str) -> list[dict[str, str]]:
    """The rows of `spec/NAME.csv`."""
    with (SPEC / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def faults_module() -> str:
    """Text of `evogs_codec/_generated/faults.py`."""
    lines = [
        '"""Fault codes of spec 9. Made by `tools/spec_tables.py` from `spec/faults.csv`."""',
        "",
        "from __future__ import annotations",
        "",
        "from enum import Enum",
        "",
        "",
        "class Fault(Enum):",
        '    """A fault code; the value is (section of the spec, meaning)."""',
        "",
    ]
    for row in rows("faults"):
        if "," in row["meaning"] or None in row:
            raise ValueError(f"faults.csv: {row['code']}: the meaning holds a comma")
        line = f'    {row["code"]} = ("{row["section"]}", "{row["meaning"]}")'
        if len(line) > 100:
            line = (
                f'    {row["code"]} = (\n        "{row["section"]}",\n'
                f'        "{row["meaning"]}",\n    )'
            )
        lines.append(line)
    lines += [
        "",
        "    @property",
        "    def section(self) -> str:",
        '        """Section of `spec/evogs.md` with the rule."""',
        "        return self.value[0]",
    ]
    return "\n".join(lines) + "\n"


def limits_module() -> str:
    """Text of `evogs_codec/_generated/limits.py`."""
    lines = [
        '"""Limits by tier of spec 8.2. Made by `tools/spec_tables.py` from `spec/limits.csv`."""',
        "",
        "from __future__ import annotations",
        "",
        "# name: limit of tier 1, 2, 3",
        "LIMITS: dict[str, tuple[int, int, int]] = {",
    ]
    lines += [
        f'    "{row["name"]}": ({row["tier_1"]}, {row["tier_2"]}, {row["tier_3"]}),'
        for row in rows("limits")
    ]
    return "\n".join([*lines, "}"]) + "\n"


REGISTRIES = {
    "coordinate_system": "COORDINATE_SYSTEMS",
    "up_axis": "UP_AXES",
    "unit": "UNITS",
    "colour_space": "COLOUR_SPACES",
}


def registry_module() -> str:
    """Text of `evogs_codec/_generated/registry.py`."""
    lines = [
        '"""Registered names of spec 8.4. Made by `tools/spec_tables.py` from'
        ' `spec/registry.csv`."""',
        "",
        "from __future__ import annotations",
        "",
        "# The number of a name is its place.",
    ]
    for registry, constant in REGISTRIES.items():
        names = [r["name"] for r in rows("registry") if r["registry"] == registry]
        lines.append(f"{constant} = ({', '.join(json.dumps(name) for name in names)})")
    keys = [r["value"] for r in rows("registry") if r["registry"] == "metadata"]
    for by_the_encoder in ("generator", "psnr", "camera", "cameras", "crs", "transform"):
        keys.remove(by_the_encoder)
    lines += [
        "",
        "# Metadata keys that a person gives.",
        "TEXT_OPTIONS = (",
        *(f"    {json.dumps(key)}," for key in keys),
        ")",
        "",
        "",
        "def name(names: tuple[str, ...], number: int) -> str:",
        '    """The name of a number; an unknown one reads as 0 (spec 5.1)."""',
        "    return names[number] if number < len(names) else names[0]",
    ]
    return "\n".join(lines) + "\n"


def markdown(header: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cells) + " |" for cells in body]
    return "\n".join(lines)


def spec_tables() -> dict[str, str]:
    """Name of a mark in the spec: the table that belongs there."""
    from evogs_codec.format import layout  # after faults.py and limits.py exist
    from tools import example, example_2

    tables = {
        name: markdown(
            ["Offset", "Field", "Type", "Meaning"],
            [[str(o), f"`{f}`", t, doc] for o, f, t, doc in layout.describe(struct)]
            + [[str(layout.size_of(struct)), "", "", "*end*"]],
        )
        for name, struct in layout.STRUCTURES.items()
    }
    tables["faults"] = markdown(
        ["Code", "Section", "Meaning"],
        [[f"`{r['code']}`", r["section"], r["meaning"]] for r in rows("faults")],
    )
    tables["limits"] = markdown(
        ["Limit", "Tier 1", "Tier 2", "Tier 3", "Counts"],
        [
            [f"`{r['name']}`", r["tier_1"], r["tier_2"], r["tier_3"], r["counts"]]
            for r in rows("limits")
        ],
    )
    for registry in dict.fromkeys(r["registry"] for r in rows("registry")):
        tables[f"registry {registry}"] = markdown(
            ["Value", "Name", "Meaning"],
            [
                [f"`{r['value']}`", r["name"], r["meaning"]]
                for r in rows("registry")
                if r["registry"] == registry
            ],
        )
    tables["example"] = example.annex(example.stream())
    tables["example2"] = example_2.annex(example_2.stream())
    return tables


def fill(text: str, tables: dict[str, str]) -> str:
    """`text` with each marked table replaced."""
    for name, table in tables.items():
        begin, end = f"<!-- table {name} -->", f"<!-- end {name} -->"
        pattern = re.compile(re.escape(begin) + r".*?" + re.escape(end), re.DOTALL)
        found = list(pattern.finditer(text))
        if len(found) != 1:
            raise ValueError(f"spec/evogs.md must have the mark {begin} once")
        text = f"{text[: found[0].start()]}{begin}\n{table}\n{end}{text[found[0].end() :]}"
    return text


def main() -> int:
    """Write or check; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    check = parser.parse_args().check
    stale = []

    def put(path: Path, content: str | bytes) -> None:
        data = content.encode("utf-8") if isinstance(content, str) else content
        if path.exists() and path.read_bytes() == data:
            return
        stale.append(path.relative_to(ROOT))
        if not check:
            path.write_bytes(data)

    put(ROOT / "evogs_codec" / "_generated" / "faults.py", faults_module())
    put(ROOT / "evogs_codec" / "_generated" / "limits.py", limits_module())
    put(ROOT / "evogs_codec" / "_generated" / "registry.py", registry_module())
    from tools import example, example_2

    put(SPEC / "example.evogs", example.stream())
    put(SPEC / "example-2.evogs", example_2.stream())
    spec = SPEC / "evogs.md"
    put(spec, fill(spec.read_text(encoding="utf-8"), spec_tables()))
    for path in stale:
        print(f"{'stale' if check else 'wrote'} {path}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
