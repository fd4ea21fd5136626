"""As much of JSON Schema as our schemas use."""

import re

TYPES: dict[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
    "null": type(None),
}
KNOWN = {
    *("$schema", "$defs", "$ref", "title", "description", "type", "enum", "const", "pattern"),
    *("minimum", "maximum", "required", "properties", "additionalProperties", "items", "anyOf"),
    *("minItems", "uniqueItems"),
}


def errors(value, schema, root=None, at="$"):
    """What is wrong with a value, one line each."""
    root = schema if root is None else root
    unknown = set(schema) - KNOWN
    assert not unknown, f"{at}: the schema uses {unknown}"
    if "$ref" in schema:
        target = root
        for part in schema["$ref"].removeprefix("#/").split("/"):
            target = target[part]
        return errors(value, target, root, at)
    if "anyOf" in schema:
        found = [errors(value, choice, root, at) for choice in schema["anyOf"]]
        return [] if any(not some for some in found) else min(found, key=len)
    names = schema.get("type", [])
    names = [names] if isinstance(names, str) else names
    if names and not any(_is(value, name) for name in names):
        return [f"{at}: {value!r} is not {' or '.join(names)}"]
    wrong = []
    if "enum" in schema and value not in schema["enum"]:
        wrong.append(f"{at}: {value!r} is not one of {schema['enum']}")
    if "const" in schema and value != schema["const"]:
        wrong.append(f"{at}: {value!r} is not {schema['const']!r}")
    if isinstance(value, str) and not re.search(schema.get("pattern", ""), value):
        wrong.append(f"{at}: {value!r} does not match {schema['pattern']}")
    if isinstance(value, int) and not isinstance(value, bool):
        low, high = schema.get("minimum", value), schema.get("maximum", value)
        wrong += [] if low <= value <= high else [f"{at}: {value} is out of range"]
    if isinstance(value, dict):
        wrong += [f"{at}: no {key}" for key in schema.get("required", []) if key not in value]
        parts, rest = schema.get("properties", {}), schema.get("additionalProperties", {})
        for key, item in value.items():
            if key not in parts and rest is False:
                wrong.append(f"{at}: unknown key {key}")
            else:
                wrong += errors(item, parts.get(key, rest or {}), root, f"{at}.{key}")
    if isinstance(value, list):
        if len(value) < schema.get("minItems", 0):
            wrong.append(f"{at}: {len(value)} items")
        if schema.get("uniqueItems") and len({repr(item) for item in value}) < len(value):
            wrong.append(f"{at}: items repeat")
        for number, item in enumerate(value):
            wrong += errors(item, schema.get("items", {}), root, f"{at}[{number}]")
    return wrong


def _is(value, name):
    if isinstance(value, bool) and name != "boolean":
        return False
    return isinstance(value, TYPES[name])
