"""Words and defaults that pages name: those of the schema and of the solver."""

from __future__ import annotations

import inspect
import json
import re
from ast import literal_eval
from pathlib import Path

import equimesh as em
from equimesh.specs import build
from equimesh_schema import mesh, schwarz
from equimesh_schema.document import keys_of
from equimesh_schema.domains import DOMAINS
from equimesh_schema.monitors import MONITORS
from equimesh_service.spec.mesh import read_spec
from schema.test_document import ARC, DOCUMENTS

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"


def test_words_and_defaults_of_the_page_on_the_interface() -> None:
    spec = (REFERENCE / "http.md").read_text().split("## The spec")[1].split("## POST")[0]
    shown, schwarz_shown = map(json.loads, re.findall(r"```json\n(.*?)```", spec, re.DOTALL)[:2])
    assert shown.keys() == {*keys_of(mesh.MeshSpec)}
    assert build(shown) == build({"monitor": {"u": shown["monitor"]["u"]}})
    assert schwarz_shown == schwarz.Schwarz().to_json()
    assert all(f"`{key}`" in spec for key in ("overlap", "local_steps", "max_exchanges"))
    assert "`groups`" in spec.split("### Blocks")[1]
    rows = re.findall(r"^\| (`.+?`)[^|]* \| (.+) \|$", spec, re.MULTILINE)
    cells = {name: row for names, row in rows for name in re.findall(r"`([\w.]+)`", names)}
    for name, words in (("boundary", mesh.BOUNDARIES), ("initial", mesh.INITIALS), ("cells", mesh.CELLS)):
        assert re.findall(r"`(\w+)`", cells[name])[: len([*words])] == [*words], name
    assert cells.keys() >= {*MONITORS.documents, *DOMAINS.documents}
    for kind in (kind for kind, made in DOMAINS.documents.items() if not made.HAS_BLOCKS):
        keys = read_spec({**DOCUMENTS[kind], "monitor": ARC}).canonical["domain"]
        told = re.findall(r"`(\w+)` \(`?(\[.*?\]|\"?[\w.]+\"?)", cells[kind].split(" | ")[0])
        assert {key: keys[key] for key, _ in told} == {key: json.loads(default) for key, default in told}, kind
        plain = {key for key, value in keys.items() if isinstance(value, float | bool | str | list)}
        assert {key for key, _ in told} == plain - {"kind"}, kind


def test_defaults_that_the_page_on_python_names() -> None:
    page = (REFERENCE / "python.md").read_text()
    found = 0
    for name, arguments in re.findall(
        r"`(Auto|LeastError|Target|ArcLength|Curvature|Rectangle|AnnulusSector)\(([^`]*)\)`", page
    ):
        for key, value in re.findall(r"(\w+)=(\([^)]*\)|[^,()]+)", arguments):
            parameter = inspect.signature(getattr(em, name)).parameters.get(key)
            if parameter is not None and parameter.default is not parameter.empty:
                assert literal_eval(value) == parameter.default, (name, key)
                found += 1
    assert found >= 14
