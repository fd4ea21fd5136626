"""What is installed, and what the commands say about what is not."""

import json
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from conformance.harness import cli as harness
from conformance.renders import cli as renders

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
INSTALLED = {"evogs", "evogs_codec", "conformance", "reference_trainer"}


def test_tools_are_not_installed():
    setuptools = PROJECT["tool"]["setuptools"]
    found = {name.removesuffix("*") for name in setuptools["packages"]["find"]["include"]}
    assert found | set(setuptools["py-modules"]) == INSTALLED


@pytest.mark.thorough
def test_vectors_and_goldens_are_not_installed():
    setuptools = pytest.importorskip("setuptools", reason="only builds need it")
    find = PROJECT["tool"]["setuptools"]["packages"]["find"]
    packages = setuptools.find_namespace_packages(str(ROOT), **find)
    assert "conformance.harness.judging" in packages
    assert not [p for p in packages if "vectors" in p or "goldens" in p or "renders." in p]
    data = PROJECT["tool"]["setuptools"]["package-data"]["conformance"]
    assert not [p for p in data if p.startswith(("*", "vectors", "renders"))]


def test_the_description_at_an_index_links_to_nothing_that_is_not_there():
    text = (ROOT / PROJECT["project"]["readme"]).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]*)\)", text)
    assert not [link for link in links if not link.startswith("https:")]
    assert "pip install" in text


def test_licences_of_all_that_is_in_the_wheel_are_in_the_wheel():
    project = PROJECT["project"]
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in project["license-files"]}
    page = texts["evogs_codec/cli/viewer/page/LICENSES.txt"]
    assert "three" in page
    assert "spark" in page
    table = texts["LICENSES.md"].split("## ")[0]
    for licence in project["license"].split(" AND "):
        named = licence in table or licence in page or f"({licence})" in page
        assert named, licence


def test_every_dependency_has_a_row_in_the_page_on_licences():
    text = (ROOT / "LICENSES.md").read_text(encoding="utf-8").lower()
    extras = PROJECT["project"]["optional-dependencies"]
    names = [re.split(r"[^\w-]", spec)[0] for spec in PROJECT["project"]["dependencies"]]
    for extra in ("render", "cluster", "completion", "stores", "interchange"):
        names += [re.split(r"[^\w-]", spec)[0] for spec in extras[extra]]
    assert len(names) > 10
    for name in names:
        assert name in text, name


def test_the_version_is_the_same_wherever_it_is_written():
    version = PROJECT["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in citation
    for page in ("README.md", "SECURITY.md"):
        assert f"The package is {version}" in (ROOT / page).read_text(encoding="utf-8")


def test_every_extra_that_people_install_is_in_the_page_of_the_package():
    text = (ROOT / "docs" / "package.md").read_text(encoding="utf-8")
    for extra in PROJECT["project"]["optional-dependencies"].keys() - {"all"}:
        assert f"`{extra}`" in text, extra


def is_of_lego(name):
    """Pictures that may not be sold, so that no package has them."""
    parts = Path(name)
    is_picture = parts.suffix in (".png", ".jpg")
    return name == "docs/figures/cameras.jpg" or (
        is_picture and parts.parts[:1] == ("docs",) and parts.parts[1].startswith("paper")
    )


@pytest.mark.thorough
def test_wheel_and_source_distribution_are_whole(tmp_path):
    """Without isolation: setuptools of this environment, and no network."""
    pytest.importorskip("build", reason="it builds both")
    pytest.importorskip("setuptools", "77", reason="the build needs it")
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("this is no checkout")
    copy = tmp_path / "checkout"
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, copy / name)
    command = [sys.executable, "-m", "build", "--no-isolation", "-o", str(tmp_path), str(copy)]
    subprocess.run(command, capture_output=True, check=True, timeout=280)
    (source,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    hidden = {name for name in listed.stdout.splitlines() if name.startswith(".")}
    missing = set(listed.stdout.splitlines()) - packed - hidden
    of_lego = {name for name in missing if is_of_lego(name)}  # CC-BY-NC
    assert len(of_lego) > 10
    missing -= of_lego
    assert not [name for name in missing if not Path(name).name.startswith(".")]
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        installed = archive.namelist()
    for name in PROJECT["project"]["license-files"]:
        assert any(one.endswith(f"licenses/{name}") for one in installed), name
    assert "evogs_codec/cli/viewer/page/renderer.js" in installed
    tops = {name.split("/")[0] for name in installed if "dist-info" not in name}
    assert tops == {"evogs.py", *(INSTALLED - {"evogs"})}
    assert not [name for name in installed if name.startswith("conformance/vectors")]


def test_entry_points_are_of_installed_packages():
    project = PROJECT["project"]
    groups = [project["scripts"], *project["entry-points"].values()]
    assert {value.split(".")[0].split(":")[0] for g in groups for value in g.values()} <= INSTALLED


def test_the_bench_command_names_the_program_that_replaces_it(refused):
    refused("bench", words=["python -m tools.bench"])
    refused("bench", "paper", "--data", "x", words=["python -m tools.bench.paper"])


def test_a_command_that_cannot_be_loaded_leaves_the_others(monkeypatch, evogs):
    missing = "No module named 'tools.gone'"
    gone = EntryPoint("gone", "tools.gone:register", "evogs.commands")
    monkeypatch.setattr("evogs_codec.cli.commands.entry_points", lambda **_: [gone])
    code, out, err = evogs("--help")
    assert (code, "extract" in out) == (0, True)
    assert err == f"evogs: no command gone, install its package again: {missing}\n"


def test_a_command_of_the_codec_imports_no_other_package(monkeypatch, evogs):
    def entries(**_):
        raise AssertionError("looked for commands of other packages")

    monkeypatch.setattr("evogs_codec.cli.commands.entry_points", entries)
    code, out, err = evogs("info", ROOT / "spec" / "example.evogs", "--json")
    assert (code, json.loads(out)["tier"], err) == (0, 1, "")


def test_missing_vectors_are_said_to_be_in_a_checkout(tmp_path, capsys):
    command = ["run", "--decoder", "true", "--vectors", str(tmp_path)]
    assert harness.main(command) == 3
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "CHECKOUT" in line)
    assert str(tmp_path) in line
    assert "--vectors CHECKOUT/conformance/vectors" in line


def test_missing_goldens_are_said_to_be_in_a_checkout(tmp_path, capsys):
    assert renders.main(["run", "--renderer", "true", "--suite", str(tmp_path)]) == 3
    (line,) = capsys.readouterr().out.splitlines()
    assert "--suite CHECKOUT/conformance/renders" in line
