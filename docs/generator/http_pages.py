"""The pages of the HTTP reference, from the OpenAPI document: one for each tag, and one for all schemas."""

from __future__ import annotations

import json
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any

from generator.schemas import PAGE, escaped, keys_table, type_of

FOLDER = "reference/operations"
_METHODS = ("get", "post", "put", "patch", "delete", "head")


def http_pages(document: dict[str, Any]) -> dict[str, str]:
    """The Markdown of each page by its name on the site; the first one is the list of all operations."""
    pages = {f"{FOLDER}/index.md": _index(document)}
    for tag in document["tags"]:
        lines = [f"# {tag['name'].capitalize()}", "", tag["description"], ""]
        for method, path, operation in _operations(document, tag["name"]):
            lines += _operation(method, path, operation)
        pages[f"{FOLDER}/{tag['name']}.md"] = "\n".join(lines)
    return pages | {f"{FOLDER}/{PAGE}": _schemas(document)}


def _operations(document: dict[str, Any], tag: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Method, path and description of the operations of a tag; HEAD is listed under the GET that it belongs to."""
    for path, methods in document["paths"].items():
        for method in _METHODS:
            if method in methods and tag in methods[method]["tags"] and not (method == "head" and "get" in methods):
                both = method == "get" and "head" in methods
                yield ("GET, HEAD" if both else method.upper()), path, methods[method]


def _index(document: dict[str, Any]) -> str:
    lines = [
        "# Operations of the HTTP interface",
        "",
        "Made from the OpenAPI document of the service, which `/openapi.json` answers.",
        "The [guide](../http.md) says how the operations work together. `/docs` of a service lets you try each one.",
        "",
    ]
    for tag in document["tags"]:
        lines += [f"## [{tag['name'].capitalize()}]({tag['name']}.md)", "", tag["description"], ""]
        lines += ["| operation | request |", "|---|---|"]
        for method, path, operation in _operations(document, tag["name"]):
            link = f"{tag['name']}.md#{_slug(operation['summary'])}"
            lines.append(f"| [{escaped(operation['summary'])}]({link}) | `{method} {path}` |")
        lines.append("")
    return "\n".join([*lines, f"- [Schemas]({PAGE}): every object of a body or an answer, with its keys", ""])


def _slug(heading: str) -> str:
    """The anchor of a heading, as the pages have it."""
    return "".join(c for c in heading.lower() if c.isalnum() or c in " -_").replace(" ", "-")


def _operation(method: str, path: str, operation: dict[str, Any]) -> list[str]:
    lines = [f"## {operation['summary']}", "", f"`{method} {path}`", "", operation.get("description", ""), ""]
    scopes = sorted({scope for way in operation.get("security", []) for scopes in way.values() for scope in scopes})
    if scopes:
        lines += [f"Where keys exist, it needs one with the scope `{'` or `'.join(scopes)}`.", ""]
    lines += _parameters(operation.get("parameters", []))
    lines += _body(operation.get("requestBody"))
    return lines + _answers(operation["responses"])


def _parameters(parameters: list[dict[str, Any]]) -> list[str]:
    if not parameters:
        return []
    lines = ["### Parameters", "", "| name | in | type | default | |", "|---|---|---|---|---|"]
    for parameter in parameters:
        schema = parameter["schema"]
        default = "required" if parameter.get("required") else ""
        if schema.get("default") is not None:
            default = f"`{json.dumps(schema['default'])}`"
        text = parameter.get("description", "")
        example = schema.get("example", parameter.get("example"))
        text += f" Example: `{example}`." if example is not None else ""
        lines.append(f"| `{parameter['name']}` | {parameter['in']} | {type_of(schema)} | {default} | {escaped(text)} |")
    return [*lines, ""]


def _body(body: dict[str, Any] | None) -> list[str]:
    if body is None:
        return []
    lines = ["### Body", "", "Required." if body.get("required") else "Optional.", ""]
    for media_type, content in body["content"].items():
        schema = content.get("schema", {})
        lines += [f"`{media_type}`: {type_of(schema)}", ""]
        lines += keys_table(schema)
        for name, example in content.get("examples", {}).items():
            lines += [f"{escaped(example.get('summary', name))}:", "", *_code(example["value"])]
        if "example" in content:
            lines += ["For example:", "", *_code(content["example"])]
    return lines


def _answers(responses: dict[str, Any]) -> list[str]:
    lines = ["### Answers", "", "| status | meaning | content |", "|---|---|---|"]
    examples: list[str] = []
    for status, response in sorted(responses.items()):
        described = response["description"]
        text = HTTPStatus(int(status)).phrase + "." if described == "Successful Response" else described
        headers = [
            f"`{name}`: {value.get('description', '')}".rstrip(": ")
            for name, value in response.get("headers", {}).items()
        ]
        cell = escaped(" ".join([text, *headers]))
        lines.append(f"| {status} | {cell} | {_contents(response.get('content', {}))} |")
        for content in response.get("content", {}).values():
            values = [content["example"]] if "example" in content else []
            values += [example["value"] for example in content.get("examples", {}).values()]
            for value in values:
                examples += [f"An answer {status}:", "", *_code(value)]
    return [*lines, "", *examples]


def _contents(content: dict[str, Any]) -> str:
    """The media types of an answer; problems have one schema, which the table does not repeat."""
    found = []
    for media_type, described in content.items():
        schema = described.get("schema")
        found.append(f"`{media_type}`" + (f" {type_of(schema)}" if schema and "json" in media_type else ""))
    return ", ".join(found)


def _code(value: Any) -> list[str]:
    text = value if isinstance(value, str) else json.dumps(value, indent=2, ensure_ascii=False)
    language = "text" if isinstance(value, str) else "json"
    return [f"```{language}", text, "```", ""]


def _schemas(document: dict[str, Any]) -> str:
    lines = ["# Schemas", "", "Every object of a body or an answer. Keys without a default may be absent.", ""]
    for name, schema in sorted(document["components"]["schemas"].items()):
        lines += [f"## {name}", "", escaped(schema.get("description", "")), ""]
        table = keys_table(schema)
        lines += table or [f"Type: {type_of(schema)}.", ""]
    return "\n".join(lines)
