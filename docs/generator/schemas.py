"""JSON schemas of the OpenAPI document as Markdown: a type in a few words, and a table of keys."""

from __future__ import annotations

import json
import re
from typing import Any

PAGE = "schemas.md"
_PREFIX = "#/components/schemas/"
_SPECIAL = re.compile(r"([\\*_\[\]<>|$])")
# Longer patterns help no reader.
_MAX_PATTERN = 40
_WORDS = {"string": "text", "number": "number", "integer": "integer", "boolean": "true or false", "null": "null"}
_LIMITS = {
    "minimum": "at least {}",
    "exclusiveMinimum": "over {}",
    "maximum": "at most {}",
    "minLength": "at least {} characters",
    "maxLength": "at most {} characters",
    "minItems": "at least {} items",
    "maxItems": "at most {} items",
    "maxProperties": "at most {} keys",
    "format": "{}",
}


def escaped(text: str) -> str:
    """Text for a cell of a table: on one line, and without meaning for Markdown but for code in backticks."""
    parts = " ".join(text.split()).split("`")
    for k, part in enumerate(parts):
        parts[k] = part.replace("|", r"\|") if k % 2 else _SPECIAL.sub(r"\\\1", part)
    return "`".join(parts)


def type_of(schema: dict[str, Any]) -> str:
    """What a value is, in Markdown: ``text``, ``list of number``, a link to a schema, or several with "or"."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix(_PREFIX)
        return f"[{name}]({PAGE}#{name.lower()})"
    for key in ("anyOf", "oneOf"):
        if key in schema and "enum" not in schema:
            return " or ".join(dict.fromkeys(type_of(option) for option in schema[key]))
    if "enum" in schema:
        return " or ".join(_json(value) for value in schema["enum"])
    if "const" in schema:
        return _json(schema["const"])
    if schema.get("type") == "array":
        return _list(schema) + _limits(schema)
    if schema.get("type") == "object":
        values = schema.get("additionalProperties")
        return f"object of {type_of(values)}" if isinstance(values, dict) and values else "object"
    return _WORDS.get(str(schema.get("type")), "any value") + _limits(schema)


def keys_table(schema: dict[str, Any]) -> list[str]:
    """The lines of a table of the keys of an object; none for another schema."""
    properties = schema.get("properties", {})
    if not properties:
        return []
    required = schema.get("required", [])
    lines = ["| key | type | default | |", "|---|---|---|---|"]
    for name, value in properties.items():
        default = "required" if name in required else _json(value["default"]) if "default" in value else ""
        lines.append(f"| `{name}` | {type_of(value)} | {default} | {escaped(value.get('description', ''))} |")
    return [*lines, ""]


def _list(schema: dict[str, Any]) -> str:
    if "prefixItems" in schema:
        return f"\\[{', '.join(map(type_of, schema['prefixItems']))}\\]"
    return f"list of {type_of(schema.get('items', {}))}"


def _limits(schema: dict[str, Any]) -> str:
    found = [text.format(schema[key]) for key, text in _LIMITS.items() if key in schema]
    pattern = schema.get("pattern", "")
    if pattern and len(pattern) <= _MAX_PATTERN and "`" not in pattern:
        found.append(f"`{pattern}`".replace("|", r"\|"))
    return f" ({', '.join(found)})" if found else ""


def _json(value: Any) -> str:
    return "`" + json.dumps(value, ensure_ascii=False) + "`"
