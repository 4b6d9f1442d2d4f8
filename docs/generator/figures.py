"""A Sphinx extension that makes pictures move: the problems of the gallery, computed in the reader's browser.

Pages without JavaScript keep their pictures. The script is a file and no module, so that pages work from a folder.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from equimesh_schema.browser.scripts import FOLDER, script
from generator.places import ROOT

_PAGES = ("index", "gallery")
_GALLERY = ROOT / "service" / "equimesh_service" / "workbench" / "gallery.json"
_BEGIN = ROOT / "docs" / "style" / "moving.js"
_SCRIPT, _SHEET = "moving.js", "figure.css"


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the script and its sheet to the pages with pictures that move."""
    app.connect("html-page-context", _add_files)
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _add_files(app: Sphinx, page: str, *_: object) -> None:
    if page in _PAGES:
        app.add_js_file(_SCRIPT)
        app.add_css_file(_SHEET)


def _write(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        static = Path(app.outdir) / "_static"
        (static / _SHEET).write_text((FOLDER / _SHEET).read_text(encoding="utf-8"), encoding="utf-8")
        (static / _SCRIPT).write_text(moving_script(), encoding="utf-8")


def moving_script() -> str:
    """The figure, the problems on grids, and where they stand on the pages."""
    problems = json.loads(_GALLERY.read_text(encoding="utf-8"))["problems"]
    on_grids = [problem for problem in problems if "grid" in problem["spec"]]
    data = f"const PROBLEMS = {json.dumps(on_grids, separators=(',', ':'))};"
    return f'(() => {{\n"use strict";\n{script()}\n{data}\n{_BEGIN.read_text(encoding="utf-8")}}})();\n'
