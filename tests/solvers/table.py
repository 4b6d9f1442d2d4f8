"""The table of consumers in the docs: made of the records of a run, and stored with them. `python -m solvers.table`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from solvers import records
from solvers.records import Record

STORED = Path(__file__).with_name("consumers.json")
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "use-in-your-solver.md"
BEGIN, END = "<!-- consumers: begin -->", "<!-- consumers: end -->"
MESHES = ("square quads", "square triangles", "annulus quads", "annulus triangles")
# The format whose files have another suffix than its name.
SUFFIXES = {"mesh": "medit", "foam.zip": "foam"}
HEAD = ("consumer", "version", "format", "mesh", "sides", *MESHES)


def table(found: list[Record]) -> str:
    """The rows of Markdown: the errors of each consumer on our mesh and on the uniform one.

    A row has all formats of a consumer whose numbers are the same.
    """
    ways: dict[tuple[str, str], dict[str, Record]] = {}
    for record in found:
        ways.setdefault((record.consumer, record.format), {})[record.mesh] = record
    formats: dict[tuple[str, ...], list[str]] = {}
    for (consumer, format), by_mesh in sorted(ways.items(), key=lambda item: (item[0][0].lower(), item[0][1])):
        any_one = next(iter(by_mesh.values()))
        read, tags = (all(getattr(r, name) for r in by_mesh.values()) for name in ("read", "tags"))
        name = format if format == "adaptor" else f"`{SUFFIXES.get(format, format)}`"
        yes = tuple("yes" if right else "no" for right in (read, tags))
        errors = (_errors(by_mesh.get(mesh)) for mesh in MESHES)
        formats.setdefault((consumer, any_one.version, *yes, *errors), []).append(name)
    rows = [HEAD, ("---",) * len(HEAD)]
    rows += [(*row[:2], ", ".join(names), *row[2:]) for row, names in formats.items()]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _errors(record: Record | None) -> str:
    if record is None:
        return ""
    if record.error is None:
        return "read"
    uniform = "" if record.uniform_error is None else f" / {record.uniform_error:.2e}"
    return f"{record.error:.2e}{uniform}"


def stored() -> list[Record]:
    """The records of the last run whose table is in the docs."""
    return [Record(**fields) for fields in json.loads(STORED.read_text())]


def in_page(text: str) -> str:
    """The table between the markers of the page."""
    return text.partition(BEGIN)[2].partition(END)[0].strip()


def main() -> None:
    """Store the records of the last run, and write their table into the docs."""
    found = records.read_all()
    STORED.write_text("[\n" + ",\n".join(json.dumps(asdict(record)) for record in found) + "\n]\n")
    text = PAGE.read_text()
    head, tail = text.partition(BEGIN)[0], text.partition(END)[2]
    PAGE.write_text(f"{head}{BEGIN}\n\n{table(found)}\n\n{END}{tail}")


if __name__ == "__main__":
    main()
