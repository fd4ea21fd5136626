"""The text of EVOGS_gaussian_splatting_compression: its schema, its examples and the writer agree.

The validator of Khronos runs where `npm ci` in tools/web installed it.
"""

import json
import os
import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from evogs_codec import (
    encode_scene,
    read_gltf_stream,
    write_gltf_stream,
    write_scene,
)
from evogs_codec.io.interchange.gltf_stream import EXTENSION, KHR
from evogs_codec.render.demo_scene import make_scene
from tests.support.odd_scenes import odd_scene

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "spec" / EXTENSION
TEXT = (FOLDER / "README.md").read_text(encoding="utf-8")
(SCHEMA,) = (FOLDER / "schema").iterdir()
EXAMPLES = ("example.glb", "example.gltf", "example-fallback.glb")
VALIDATOR = Path(
    os.environ.get("EVOGS_GLTF_VALIDATOR", ROOT / "tools/web/node_modules/gltf-validator")
)
VALIDATE = """
const [validator, ...files] = process.argv.slice(1);
const {validateBytes} = require(validator), {readFileSync} = require('fs');
const {dirname, join} = require('path');
Promise.all(files.map(file => validateBytes(new Uint8Array(readFileSync(file)), {
  externalResourceFunction: uri =>
    Promise.resolve(new Uint8Array(readFileSync(join(dirname(file), decodeURIComponent(uri))))),
}))).then(reports => console.log(JSON.stringify(reports.map(report => report.issues))));
"""


def json_of(path):
    data = path.read_bytes()
    if data[:4] == b"glTF":
        data = data[20 : 20 + struct.unpack_from("<I", data, 12)[0]]
    return json.loads(data)


def extension_of(root):
    splatting = root["meshes"][0]["primitives"][0]["extensions"][KHR]
    return splatting["extensions"][EXTENSION]


def faults(schema, value):
    """What of an object breaks the part of JSON Schema that ours uses."""
    found = [f"{name} is missing" for name in schema["required"] if name not in value]
    for name, rules in schema["properties"].items():
        if name not in value or not rules:
            continue
        known = {"type", "const", "minimum", "maximum", "description", "allOf"}
        assert set(rules) <= known, "the test does not know a word of the schema"
        if "allOf" in rules:  # an index, by the schema of glTF
            assert rules["allOf"] == [{"$ref": "glTFid.schema.json"}]
            rules = {"type": "integer", "minimum": 0}
        number = value[name]
        if type(number) is not int:
            found.append(f"{name} is no integer")
        elif number < rules.get("minimum", number) or number > rules.get("maximum", number):
            found.append(f"{name} is out of range")
        elif number != rules.get("const", number):
            found.append(f"{name} is another number")
    return found


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_keep_the_schema_and_rules_of_the_text(name):
    root, schema = json_of(FOLDER / "examples" / name), json.loads(SCHEMA.read_bytes())
    said = extension_of(root)
    assert faults(schema, said) == []
    assert root["extensionsUsed"] == [KHR, EXTENSION]
    assert ("extensionsRequired" in root) == ("fallbackLevel" not in said)
    view = root["bufferViews"][said["bufferView"]]
    assert said["bufferView"] == len(root["bufferViews"]) - 1
    assert view["byteLength"] == 519
    assert {"byteStride", "target", "extensions"} & set(view) == set()
    attributes = root["meshes"][0]["primitives"][0]["attributes"]
    has_bytes = ["bufferView" in root["accessors"][number] for number in attributes.values()]
    assert all(has_bytes) if "fallbackLevel" in said else not any(has_bytes)


def test_the_schema_refuses_what_the_text_does_not_allow():
    schema, right = json.loads(SCHEMA.read_bytes()), {"bufferView": 0, "version": 1, "levels": 5}
    assert faults(schema, right) == []
    for wrong in (
        {"version": 1, "levels": 5},
        {"bufferView": -1, "version": 1, "levels": 5},
        {"bufferView": 0, "version": 2, "levels": 5},
        {"bufferView": 0, "version": 1, "levels": 65},
        {"bufferView": 0, "version": 1, "levels": 2.0},
        right | {"fallbackLevel": 64},
    ):
        assert faults(schema, wrong) != [], wrong


def test_the_example_in_the_text_keeps_the_schema():
    (block,) = re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL)
    assert faults(json.loads(SCHEMA.read_bytes()), extension_of(json.loads(block))) == []
    properties = json.loads(SCHEMA.read_bytes())["properties"]
    rows = re.findall(r"^\| `(\w+)` \| integer \|", TEXT, re.MULTILINE)
    assert rows == [name for name, rules in properties.items() if rules]


def test_the_examples_hold_the_stream_of_annex_a_and_the_writer_makes_them(tmp_path):
    stream = (ROOT / "spec" / "example.evogs").read_bytes()
    assert (FOLDER / "examples" / "example.evogs").read_bytes() == stream
    shutil.copy(ROOT / "spec" / "example.evogs", tmp_path)
    for name in EXAMPLES:
        assert read_gltf_stream(FOLDER / "examples" / name) == stream  # type: ignore[comparison-overlap]
        write_gltf_stream(
            tmp_path / name,
            tmp_path / "example.evogs",
            fallback="fallback" in name,
            made_by="evogs convert",
        )
        assert (tmp_path / name).read_bytes() == (FOLDER / "examples" / name).read_bytes()


def validated(files):
    """What the validator says of each file."""
    if not (VALIDATOR / "index.js").is_file() or shutil.which("node") is None:
        pytest.skip(f"{VALIDATOR} or node is not there: `npm ci` in tools/web installs it")
    command = ["node", "-e", VALIDATE, str(VALIDATOR), *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def issues():
    """What the validator says of each example."""
    found = validated([FOLDER / "examples" / name for name in EXAMPLES])
    return dict(zip(EXAMPLES, found, strict=True))


@pytest.mark.parametrize("name", ["example.glb", "example.gltf"])
def test_the_validator_of_khronos_finds_neither_errors_nor_warnings(name, issues):
    found = issues[name]
    assert (found["numErrors"], found["numWarnings"]) == (0, 0)
    codes = sorted(message["code"] for message in found["messages"])
    assert codes == ["UNSUPPORTED_EXTENSION", "UNSUPPORTED_EXTENSION", "UNUSED_OBJECT"]


def test_of_a_fallback_the_validator_finds_the_names_of_khr_attributes_alone(issues):
    found = issues["example-fallback.glb"]
    wrong = [message for message in found["messages"] if message["severity"] < 2]
    assert {message["code"] for message in wrong} == {"MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    assert all(f"/attributes/{KHR}:" in message["pointer"] for message in wrong)
    assert (found["numErrors"], found["numWarnings"]) == (4, 0)


def underscored(source, out):
    """A copy of a `.glb` whose attributes of KHR have names that the validator knows as custom."""
    data = source.read_bytes()
    n_json = struct.unpack_from("<I", data, 12)[0]
    text = data[20 : 20 + n_json].replace(f'"{KHR}:'.encode(), b'"_').rstrip()
    text += b" " * (-len(text) % 4)
    rest = data[20 + n_json :]
    head = b"glTF" + struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    out.write_bytes(head + text + rest)
    return out


@pytest.mark.parametrize("degree", [0, 3])
def test_of_splats_in_attributes_it_objects_to_nothing_but_names(degree, tmp_path):
    write_scene(tmp_path / "plain.glb", odd_scene(degree=degree))
    stream = encode_scene(make_scene(200), preset="scene", levels=2, cameras=[])
    write_gltf_stream(tmp_path / "fallback.glb", stream, fallback=True)
    files = [tmp_path / "plain.glb", tmp_path / "fallback.glb"]
    files.append(FOLDER / "examples" / "example-fallback.glb")
    for found in validated(files):
        wrong = [message for message in found["messages"] if message["severity"] < 2]
        assert {message["code"] for message in wrong} == {"MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    for found in validated([underscored(file, tmp_path / f"_{file.name}") for file in files]):
        assert (found["numErrors"], found["numWarnings"]) == (0, 0)
